#pragma once
#include <filesystem>
#include <map>
#include <nlohmann/json.hpp>
#include <string>

#include "weft/config.hpp"
#include "weft/types.hpp"

namespace weft {

/// What the page of a garment shows.
struct GarmentPage {
  std::string name;
  std::string mesh_file;  ///< as the garment's YAML names it
  Positions positions;    ///< m
  Faces faces;
  std::map<std::string, Index> vertices;
  std::string head;  ///< the garment's YAML but for its vertices
  /// Of an import: the mesh as it was, and the findings, an array of {pass, kind, count, text, places}.
  Positions positions_before = Positions(0, 3);
  Faces faces_before = Faces(0, 3);
  nlohmann::ordered_json findings = nlohmann::ordered_json::array();
};

/// The YAML of a garment but for `vertices`: name, mesh, rest, layers and seams, as far as they are given.
/// @param garment null: name and mesh alone.
std::string garment_head(const ConfigNode& garment, const std::string& name, const std::string& mesh_file);

/// The template with the garment in it: a click on the page names a vertex.
/// @throws ConfigError if the text is not a template of weft.
std::string garment_page(const std::string& page_template, const GarmentPage& garment);

/// Writes the page. @return why none was written; empty if one was.
std::string write_garment_page(const std::filesystem::path& file, const GarmentPage& garment);

}  // namespace weft
