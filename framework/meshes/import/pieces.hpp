#pragma once
#include "meshes/import/import_mesh.hpp"

namespace weft {

/// A connected part of a mesh that is a surface (cut_open, orient_faces).
struct MeshPiece {
  std::vector<int> faces;
  double area = 0.0;  ///< m^2
  int vertices = 0;
  int euler = 0;                        ///< V - E + F: 1 is a disc
  std::vector<std::vector<int>> loops;  ///< open boundaries along the faces' direction, the longest first
  std::vector<double> loop_lengths;     ///< m

  int handles() const { return (2 - euler - static_cast<int>(loops.size())) / 2; }
};

/// The pieces, the largest area first.
std::vector<MeshPiece> pieces_of(const ImportMesh& mesh);

/// Lists the pieces. @param only keep this one alone, from 1; 0: all. @throws ConfigError if there is no such piece.
void choose_piece(ImportMesh& mesh, int only, Findings& findings);

/// Fills holes of at most `edges` edges, none of them a piece's longest boundary. Lists the openings that stay.
void fill_holes(ImportMesh& mesh, int edges, Findings& findings);

}  // namespace weft
