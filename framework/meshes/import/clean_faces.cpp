#include "meshes/import/clean_faces.hpp"

#include <algorithm>
#include <map>

#include "weft/error.hpp"

namespace weft {
namespace {

// Height over longest edge below which a face has no usable direction: ten times what make_garment() refuses.
constexpr double kFlattestFace = 1e-5;

/// The corner opposite the longest edge of a face whose vertices lie on a line; -1 of any other face.
int corner_on_line(const ImportMesh& mesh, std::size_t f) {
  const auto& t = mesh.faces[f];
  double longest = 0.0;
  int opposite = 0;
  for (int k = 0; k < 3; ++k) {
    const double length =
        (mesh.at(t[static_cast<std::size_t>((k + 1) % 3)]) - mesh.at(t[static_cast<std::size_t>((k + 2) % 3)]))
            .squaredNorm();
    if (length > longest) {
      longest = length;
      opposite = k;
    }
  }
  return mesh.area_vector(static_cast<int>(f)).norm() <= kFlattestFace * longest ? opposite : -1;
}

/// Cuts the faces at the edge a b, except `not_this`, at vertex c.
void cut_at(ImportMesh& mesh, int a, int b, int c, std::size_t not_this, int texture) {
  const std::size_t count = mesh.faces.size();
  for (std::size_t g = 0; g < count; ++g) {
    if (g == not_this) continue;
    for (std::size_t k = 0; k < 3; ++k) {
      const int p = mesh.faces[g][k], q = mesh.faces[g][(k + 1) % 3];
      if ((p != a || q != b) && (p != b || q != a)) continue;
      auto second = mesh.faces[g];
      auto second_texture = mesh.face_texture[g];
      const bool textured = second_texture[k] >= 0;
      mesh.faces[g][(k + 1) % 3] = c;
      mesh.face_texture[g][(k + 1) % 3] = textured ? texture : -1;
      second[k] = c;
      second_texture[k] = textured ? texture : -1;
      mesh.faces.push_back(second);
      mesh.face_texture.push_back(second_texture);
      mesh.face_number.push_back(mesh.face_number[g]);
      break;
    }
  }
}

std::int64_t remove_faces_on_lines(ImportMesh& mesh, std::vector<Place>& places) {
  std::int64_t removed = 0;
  for (int round = 0; round < 20; ++round) {
    std::vector<std::size_t> flat;
    for (std::size_t f = 0; f < mesh.faces.size(); ++f) {
      if (corner_on_line(mesh, f) >= 0) flat.push_back(f);
    }
    if (flat.empty()) return removed;
    if (round == 19) {
      throw ConfigError(mesh.source + ": " + mesh.face_text(static_cast<int>(flat.front())) +
                        " has its vertices on a line, and so have its neighbours: remove the faces around it");
    }
    // One at a time where they may touch: a face that an earlier cut has changed waits for the next round.
    std::vector<bool> keep(mesh.faces.size(), true);
    std::vector<bool> touched(mesh.positions.size(), false);
    for (const std::size_t f : flat) {
      const auto t = mesh.faces[f];
      if (std::any_of(t.begin(), t.end(), [&](int v) { return touched[static_cast<std::size_t>(v)]; })) continue;
      const auto k = static_cast<std::size_t>(corner_on_line(mesh, f));
      cut_at(mesh, t[(k + 1) % 3], t[(k + 2) % 3], t[k], f, mesh.face_texture[f][k]);
      keep.resize(mesh.faces.size(), true);
      keep[f] = false;
      for (const int v : t) touched[static_cast<std::size_t>(v)] = true;
      if (places.size() < kMostPlaces) places.push_back({mesh.face_text(static_cast<int>(f)), mesh.at(t[k])});
      ++removed;
    }
    mesh.keep_faces(keep);
  }
  return removed;
}

}  // namespace

void clean_faces(ImportMesh& mesh, Findings& findings) {
  std::vector<Place> twice_places, repeated_places, line_places;
  std::int64_t twice = 0, repeated = 0, back = 0;
  std::vector<bool> keep(mesh.faces.size(), true);
  std::map<std::array<int, 3>, std::size_t> known;
  for (std::size_t f = 0; f < mesh.faces.size(); ++f) {
    const auto& t = mesh.faces[f];
    if (t[0] == t[1] || t[1] == t[2] || t[2] == t[0]) {
      keep[f] = false;
      ++twice;
      if (twice_places.size() < kMostPlaces)
        twice_places.push_back({mesh.face_text(static_cast<int>(f)), mesh.at(t[0])});
      continue;
    }
    auto sorted = t;
    std::sort(sorted.begin(), sorted.end());
    const auto [entry, fresh] = known.emplace(sorted, f);
    if (fresh) continue;
    keep[f] = false;
    ++repeated;
    const auto& other = mesh.faces[entry->second];
    std::size_t k = 0;
    while (other[k] != t[0]) ++k;
    if (other[(k + 1) % 3] != t[1]) ++back;
    if (repeated_places.size() < kMostPlaces)
      repeated_places.push_back({mesh.face_text(static_cast<int>(f)), mesh.centre(static_cast<int>(f))});
  }
  mesh.keep_faces(keep);
  const std::int64_t on_line = remove_faces_on_lines(mesh, line_places);
  const std::int64_t unused = mesh.drop_unused();
  if (mesh.faces.empty()) throw ConfigError(mesh.source + ": no face has an area");

  const auto add = [&](std::int64_t count, const std::string& text, const std::vector<Place>& places) {
    if (count == 0) return;
    findings.push_back({"faces", FindingKind::mended, count,
                        counted(count, "face") + ' ' + text + " removed: " + places_text(places, count), places});
  };
  add(twice, "that name a vertex twice", twice_places);
  add(repeated,
      "that repeat another one" + (back > 0 ? " (" + std::to_string(back) + " of them seen from the back)" : ""),
      repeated_places);
  add(on_line, "whose vertices lie on a line", line_places);
  if (twice + repeated + on_line == 0) {
    findings.push_back({"faces", FindingKind::fact, 0, "no face is repeated or degenerate"});
  }
  if (unused > 0) {
    findings.push_back(
        {"faces", FindingKind::mended, unused, counted(unused, "vertex", "vertices") + " in no face removed"});
  }
}

}  // namespace weft
