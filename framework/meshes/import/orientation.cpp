#include "meshes/import/orientation.hpp"

#include <utility>

#include "weft/error.hpp"

namespace weft {
namespace {

void turn(ImportMesh& mesh, std::size_t f) {
  std::swap(mesh.faces[f][1], mesh.faces[f][2]);
  std::swap(mesh.face_texture[f][1], mesh.face_texture[f][2]);
}

}  // namespace

void turn_faces(ImportMesh& mesh) {
  for (std::size_t f = 0; f < mesh.faces.size(); ++f) turn(mesh, f);
}

void orient_faces(ImportMesh& mesh, Findings& findings) {
  struct Neighbour {
    int face;
    bool same;  // the neighbour looks to the same side as it stands
    int first, second;
  };
  std::vector<std::vector<Neighbour>> neighbours(mesh.faces.size());
  for_each_edge(mesh_sides(mesh.faces), [&](const MeshSide* begin, const MeshSide* end) {
    if (end - begin != 2) return;
    const bool same = begin[0].upwards != begin[1].upwards;
    neighbours[static_cast<std::size_t>(begin[0].face)].push_back({begin[1].face, same, begin->first, begin->second});
    neighbours[static_cast<std::size_t>(begin[1].face)].push_back({begin[0].face, same, begin->first, begin->second});
  });
  std::vector<int> side(mesh.faces.size(), 0);  // 1: as it stands, -1: to be turned
  std::int64_t turned = 0;
  std::vector<Place> places;
  for (std::size_t start = 0; start < mesh.faces.size(); ++start) {
    if (side[start] != 0) continue;
    std::vector<std::size_t> piece{start};
    side[start] = 1;
    std::size_t standing = 0;
    for (std::size_t i = 0; i < piece.size(); ++i) {
      standing += side[piece[i]] > 0 ? 1 : 0;
      for (const Neighbour& n : neighbours[piece[i]]) {
        const int wanted = n.same ? side[piece[i]] : -side[piece[i]];
        int& known = side[static_cast<std::size_t>(n.face)];
        if (known == 0) {
          known = wanted;
          piece.push_back(static_cast<std::size_t>(n.face));
        } else if (known != wanted) {
          throw ConfigError(mesh.source + ": the surface has one side only (a Moebius strip): " +
                            mesh.face_text(static_cast<int>(piece[i])) + " and " + mesh.face_text(n.face) +
                            " cannot look to the same side at their edge " + mesh.vertex_text(n.first) + " to " +
                            mesh.vertex_text(n.second) + "; cut it open");
        }
      }
    }
    const int minority = 2 * standing >= piece.size() ? -1 : 1;
    for (const std::size_t f : piece) {
      if (side[f] != minority) continue;
      turn(mesh, f);
      ++turned;
      if (places.size() < kMostPlaces) {
        places.push_back({mesh.face_text(static_cast<int>(f)), mesh.centre(static_cast<int>(f))});
      }
    }
  }
  if (turned == 0) {
    findings.push_back({"orientation", FindingKind::fact, 0, "all neighbours look to the same side"});
  } else {
    findings.push_back(
        {"orientation", FindingKind::mended, turned,
         counted(turned, "face") + " turned to look to the side of their neighbours: " + places_text(places, turned),
         places});
  }
}

}  // namespace weft
