#pragma once
#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "sdk/disjoint_sets.hpp"
#include "weft/mesh.hpp"
#include "weft/types.hpp"

/// A garment on its way from somebody's file to one that weft can fold. Each pass of the import takes the mesh, changes
/// it and says what it found (import.hpp has their order).
namespace weft {

/// A vertex, edge or face that a finding is about.
struct Place {
  std::string element;  ///< such as "vertex 309": numbers count from 1, as in an OBJ
  Vec3 at;              ///< m, in the frame of the imported garment
};

enum class FindingKind {
  fact,    ///< what the file holds; nothing had to be done
  mended,  ///< the mesh was changed
  warning  ///< the user should look at it
};

struct Finding {
  std::string pass;
  FindingKind kind = FindingKind::fact;
  std::int64_t count = 0;  ///< of the elements that it is about
  std::string text;
  std::vector<Place> places = {};  ///< the first of them
};
using Findings = std::vector<Finding>;

/// Triangles, and which vertex and face of the file each one was.
struct ImportMesh {
  using Triangle = std::array<int, 3>;

  std::string source;
  std::vector<Vec3> positions;  ///< in the file's units until the pass `units`, then m
  std::vector<Triangle> faces;
  std::vector<Vec2> texture;           ///< as in the file
  std::vector<Triangle> face_texture;  ///< of each corner, into `texture`; -1: none
  std::vector<int> vertex_number;      ///< number in the file, from 1; 0: new
  std::vector<int> face_number;        ///< likewise
  std::vector<int> vertex_of;          ///< [vertices of the file] its vertex now; -1: gone

  const Vec3& at(int v) const { return positions[static_cast<std::size_t>(v)]; }
  int vertex_count() const { return static_cast<int>(positions.size()); }
  std::string vertex_text(int v) const;  ///< "vertex 309"
  std::string face_text(int f) const;    ///< "face 12"
  Place place(int v) const { return {vertex_text(v), at(v)}; }
  Vec3 centre(int f) const;
  /// Twice the area times the unit normal.
  Vec3 area_vector(int f) const;
  double largest_extent() const;
  double median_edge() const;

  /// Merges and removes vertices. @param to [vertices] the new index of each; -1 removes it, faces must not use it.
  void renumber(const std::vector<int>& to);
  void keep_faces(const std::vector<bool>& keep);
  /// Removes vertices that no face uses. @return how many.
  int drop_unused();
};

/// One side of a face: its vertices in ascending order, and its corner k, so that the side runs from corner k to k + 1.
struct MeshSide {
  int first, second;
  int face, corner;
  bool upwards;  ///< runs from first to second
};
/// The sides of all faces, those of one edge beside each other.
std::vector<MeshSide> mesh_sides(const std::vector<ImportMesh::Triangle>& faces);

/// Calls visit(begin, end) for the sides of each edge.
template <class Visit>
void for_each_edge(const std::vector<MeshSide>& sides, Visit&& visit) {
  for (std::size_t i = 0; i < sides.size();) {
    std::size_t end = i + 1;
    while (end < sides.size() && sides[end].first == sides[i].first && sides[end].second == sides[i].second) ++end;
    visit(sides.data() + i, sides.data() + end);
    i = end;
  }
}

/// Positions and faces; no rest shape.
Mesh to_mesh(const ImportMesh& mesh);

/// "1 vertex", "3 vertices": the plural is given where it is no +s.
std::string counted(std::int64_t count, const std::string& word, const std::string& plural = "");
/// A length for people: "0.25 mm", "12 mm", "0.7 m".
std::string length_text(double metres);
/// "vertex 3, vertex 5 and 12 more".
std::string places_text(const std::vector<Place>& places, std::int64_t count);
/// As many places of a finding are kept.
constexpr std::size_t kMostPlaces = 200;

}  // namespace weft
