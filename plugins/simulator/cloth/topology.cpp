#include "topology.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <tuple>

namespace weft::cloth {

namespace {

/// One side of an edge. Sorted by the two ends, the sides of an edge come to lie next to each other.
struct Half {
  std::int32_t a, b, face, corner;
};

}  // namespace

Topology::Topology(const Garment& garment) {
  vertices = static_cast<std::int32_t>(garment.vertex_count());
  rest.resize(vertices);
  for (std::int32_t i = 0; i < vertices; ++i) rest[i] = {garment.rest(i, 0), garment.rest(i, 1)};
  faces.resize(garment.face_count());
  for (std::size_t f = 0; f < faces.size(); ++f)
    for (int i = 0; i < 3; ++i) faces[f][i] = garment.faces(f, i);
  measure_faces();
  join_faces();
  find_components();
  list_faces_of_vertices();
}

bool Topology::is_of(const Garment& garment) const {
  if (garment.vertex_count() != vertices || garment.face_count() != static_cast<Index>(faces.size())) return false;
  for (std::int32_t i = 0; i < vertices; ++i)
    if (rest[i][0] != garment.rest(i, 0) || rest[i][1] != garment.rest(i, 1)) return false;
  for (std::size_t f = 0; f < faces.size(); ++f)
    for (int i = 0; i < 3; ++i)
      if (faces[f][i] != garment.faces(static_cast<Index>(f), i)) return false;
  return true;
}

void Topology::measure_faces() {
  area.resize(faces.size());
  vertex_area.assign(vertices, 0.0);
  min_height = std::numeric_limits<double>::infinity();
  for (std::size_t f = 0; f < faces.size(); ++f) {
    const auto& p = rest[faces[f][0]];
    const auto& q = rest[faces[f][1]];
    const auto& r = rest[faces[f][2]];
    area[f] = 0.5 * std::abs((q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0]));
    double longest = 0.0;
    for (int i = 0; i < 3; ++i) {
      longest = std::max(longest, rest_length(faces[f][(i + 1) % 3], faces[f][(i + 2) % 3]));
      vertex_area[faces[f][i]] += area[f] / 3.0;
    }
    max_edge = std::max(max_edge, longest);
    min_height = std::min(min_height, 2.0 * area[f] / longest);
  }
}

/// Edges, and what lies across them.
void Topology::join_faces() {
  std::vector<Half> halves;
  halves.reserve(3 * faces.size());
  for (std::int32_t f = 0; f < static_cast<std::int32_t>(faces.size()); ++f)
    for (int i = 0; i < 3; ++i) {
      const std::int32_t a = faces[f][(i + 1) % 3], b = faces[f][(i + 2) % 3];
      halves.push_back({std::min(a, b), std::max(a, b), f, i});
    }
  std::sort(halves.begin(), halves.end(),
            [](const Half& x, const Half& y) { return std::tie(x.a, x.b, x.face) < std::tie(y.a, y.b, y.face); });
  opposite.assign(faces.size(), {-1, -1, -1});
  for (std::size_t k = 0; k < halves.size();) {
    edges.push_back({halves[k].a, halves[k].b});
    if (k + 1 < halves.size() && halves[k + 1].a == halves[k].a && halves[k + 1].b == halves[k].b) {
      const Half &s = halves[k], &t = halves[k + 1];
      opposite[s.face][s.corner] = faces[t.face][t.corner];
      opposite[t.face][t.corner] = faces[s.face][s.corner];
      k += 2;
    } else {
      k += 1;
    }
  }
  for (const auto& [a, b] : edges) mean_edge += rest_length(a, b);
  mean_edge /= static_cast<double>(edges.size());
}

void Topology::find_components() {
  component.assign(vertices, -1);
  std::vector<std::vector<std::int32_t>> near(vertices);
  for (const auto& edge : edges) {
    near[edge[0]].push_back(edge[1]);
    near[edge[1]].push_back(edge[0]);
  }
  std::vector<std::int32_t> stack;
  for (std::int32_t i = 0, count = 0; i < vertices; ++i) {
    if (component[i] >= 0) continue;
    stack.push_back(i);
    component[i] = count;
    while (!stack.empty()) {
      const std::int32_t at = stack.back();
      stack.pop_back();
      for (const std::int32_t next_vertex : near[at]) {
        if (component[next_vertex] >= 0) continue;
        component[next_vertex] = count;
        stack.push_back(next_vertex);
      }
    }
    ++count;
  }
}

void Topology::list_faces_of_vertices() {
  face_of_vertex_start.assign(vertices + 1, 0);
  for (const auto& face : faces)
    for (const auto v : face) ++face_of_vertex_start[v + 1];
  for (std::int32_t i = 0; i < vertices; ++i) face_of_vertex_start[i + 1] += face_of_vertex_start[i];
  face_of_vertex.resize(3 * faces.size());
  auto next = face_of_vertex_start;
  for (std::int32_t f = 0; f < static_cast<std::int32_t>(faces.size()); ++f)
    for (const auto v : faces[f]) face_of_vertex[next[v]++] = f;
}

double Topology::rest_length(std::int32_t a, std::int32_t b) const {
  return std::hypot(rest[a][0] - rest[b][0], rest[a][1] - rest[b][1]);
}

}  // namespace weft::cloth
