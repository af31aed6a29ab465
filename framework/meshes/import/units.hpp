#pragma once
#include <optional>

#include "meshes/import/import_mesh.hpp"

namespace weft {

/// What is known of a file's frame. Without a value it is guessed.
struct FileFrame {
  std::optional<std::string> units = {};  ///< m, cm, mm or in
  std::optional<std::string> up = {};     ///< x, y or z; -x, -y, -z: the other way
  std::string reason = {};                ///< who gave them, such as "--units"
};

/// Turns the mesh into metres with z up. A guess takes the first of m, cm, mm and inches that makes the largest extent
/// that of a garment (0.3 to 2.5 m), and says which others would. The up axis of a flat mesh is the thin one. Of a worn
/// garment it is the axis that its openings look along, if they agree; otherwise y, as most programs write it.
/// @throws ConfigError when no unit fits, or for a unit or axis that is none.
void to_metres_z_up(ImportMesh& mesh, const FileFrame& known, Findings& findings);

}  // namespace weft
