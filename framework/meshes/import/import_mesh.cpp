#include "meshes/import/import_mesh.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <numeric>
#include <tuple>

namespace weft {
namespace {

std::string numbered(const char* what, int number) {
  return number > 0 ? std::string(what) + ' ' + std::to_string(number) : std::string("a new ") + what;
}

}  // namespace

std::string ImportMesh::vertex_text(int v) const {
  return numbered("vertex", vertex_number[static_cast<std::size_t>(v)]);
}
std::string ImportMesh::face_text(int f) const { return numbered("face", face_number[static_cast<std::size_t>(f)]); }

Vec3 ImportMesh::centre(int f) const {
  const Triangle& t = faces[static_cast<std::size_t>(f)];
  return (at(t[0]) + at(t[1]) + at(t[2])) / 3.0;
}

Vec3 ImportMesh::area_vector(int f) const {
  const Triangle& t = faces[static_cast<std::size_t>(f)];
  return (at(t[1]) - at(t[0])).cross(at(t[2]) - at(t[0]));
}

double ImportMesh::largest_extent() const {
  Vec3 low = positions.front(), high = positions.front();
  for (const Vec3& p : positions) {
    low = low.cwiseMin(p);
    high = high.cwiseMax(p);
  }
  return (high - low).maxCoeff();
}

double ImportMesh::median_edge() const {
  std::vector<double> lengths;
  for_each_edge(mesh_sides(faces), [&](const MeshSide* begin, const MeshSide*) {
    lengths.push_back((at(begin->first) - at(begin->second)).norm());
  });
  if (lengths.empty()) return 0.0;
  const auto middle = lengths.begin() + static_cast<std::ptrdiff_t>(lengths.size() / 2);
  std::nth_element(lengths.begin(), middle, lengths.end());
  return *middle;
}

void ImportMesh::renumber(const std::vector<int>& to) {
  const int count = to.empty() ? 0 : *std::max_element(to.begin(), to.end()) + 1;
  std::vector<Vec3> new_positions(static_cast<std::size_t>(count));
  std::vector<int> new_numbers(static_cast<std::size_t>(count), -1);
  for (std::size_t v = 0; v < to.size(); ++v) {
    if (to[v] < 0) continue;
    const auto i = static_cast<std::size_t>(to[v]);
    if (new_numbers[i] >= 0) continue;  // the first of the merged ones gives position and number
    new_positions[i] = positions[v];
    new_numbers[i] = vertex_number[v];
  }
  positions = std::move(new_positions);
  vertex_number = std::move(new_numbers);
  for (Triangle& face : faces) {
    for (int& v : face) v = to[static_cast<std::size_t>(v)];
  }
  for (int& v : vertex_of) v = v < 0 ? -1 : to[static_cast<std::size_t>(v)];
}

void ImportMesh::keep_faces(const std::vector<bool>& keep) {
  std::size_t count = 0;
  for (std::size_t f = 0; f < faces.size(); ++f) {
    if (!keep[f]) continue;
    faces[count] = faces[f];
    face_texture[count] = face_texture[f];
    face_number[count] = face_number[f];
    ++count;
  }
  faces.resize(count);
  face_texture.resize(count);
  face_number.resize(count);
}

int ImportMesh::drop_unused() {
  std::vector<int> to(positions.size(), -1);
  for (const Triangle& face : faces) {
    for (const int v : face) to[static_cast<std::size_t>(v)] = 0;
  }
  int next = 0;
  for (int& v : to) v = v < 0 ? -1 : next++;
  const int dropped = vertex_count() - next;
  if (dropped > 0) renumber(to);
  return dropped;
}

std::vector<MeshSide> mesh_sides(const std::vector<ImportMesh::Triangle>& faces) {
  std::vector<MeshSide> sides;
  sides.reserve(3 * faces.size());
  for (std::size_t f = 0; f < faces.size(); ++f) {
    for (int k = 0; k < 3; ++k) {
      const int a = faces[f][static_cast<std::size_t>(k)];
      const int b = faces[f][static_cast<std::size_t>((k + 1) % 3)];
      sides.push_back({std::min(a, b), std::max(a, b), static_cast<int>(f), k, a < b});
    }
  }
  std::sort(sides.begin(), sides.end(), [](const MeshSide& l, const MeshSide& r) {
    return std::tie(l.first, l.second, l.face, l.corner) < std::tie(r.first, r.second, r.face, r.corner);
  });
  return sides;
}

Mesh to_mesh(const ImportMesh& mesh) {
  Mesh result;
  result.source = mesh.source;
  result.positions.resize(mesh.positions.size(), 3);
  for (Index v = 0; v < result.positions.rows(); ++v) result.positions.row(v) = mesh.positions[v].transpose();
  result.faces.resize(mesh.faces.size(), 3);
  for (Index f = 0; f < result.faces.rows(); ++f)
    for (Index k = 0; k < 3; ++k) result.faces(f, k) = mesh.faces[f][k];
  return result;
}

std::string counted(std::int64_t count, const std::string& word, const std::string& plural) {
  return std::to_string(count) + ' ' + (count == 1 ? word : plural.empty() ? word + 's' : plural);
}

std::string length_text(double metres) {
  char text[40];
  if (std::abs(metres) < 1e-9) metres = 0.0;  // rounding, no length
  if (std::abs(metres) < 0.1) {
    std::snprintf(text, sizeof text, "%.3g mm", 1e3 * metres);
  } else {
    std::snprintf(text, sizeof text, "%.3g m", metres);
  }
  return text;
}

std::string places_text(const std::vector<Place>& places, std::int64_t count) {
  constexpr std::size_t kShown = 3;
  std::string text;
  for (std::size_t i = 0; i < std::min(kShown, places.size()); ++i) {
    text += (i > 0 ? ", " : "") + places[i].element;
  }
  const auto more = count - static_cast<std::int64_t>(std::min(kShown, places.size()));
  if (more > 0) text += " and " + std::to_string(more) + " more";
  return text;
}

}  // namespace weft
