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
  faces.resize(garment.face_count());
  for (std::size_t f = 0; f < faces.size(); ++f)
    for (int i = 0; i < 3; ++i) faces[f][i] = garment.faces(f, i);
  form_ = garment.form;
  lay_out(garment);
  measure_faces();
  join_faces();
  find_components();
  list_faces_of_vertices();
  part.resize(faces.size());
  for (std::size_t f = 0; f < faces.size(); ++f) {
    const auto &p = place[faces[f][0]], &q = place[faces[f][1]], &r = place[faces[f][2]];
    const bool down = frames && (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0]) < 0.0;
    part[f] = 2 * component[faces[f][0]] + (down ? 1 : 0);
  }
}

/// Every face in its rest frame, with what lies across its edges.
void Topology::lay_out(const Garment& garment) {
  const auto shape = std::make_shared<const RestShape>(garment);
  if (garment.has_frames()) {
    frames = shape;
    drawn_ = garment.positions;
  }
  place.resize(vertices);
  for (std::int32_t i = 0; i < vertices; ++i) {
    if (frames)
      place[i] = {garment.positions(i, 0), garment.positions(i, 1), garment.positions(i, 2)};
    else
      place[i] = {garment.rest(i, 0), garment.rest(i, 1), 0.0};
  }
  corner.resize(faces.size());
  beyond.resize(faces.size());
  neighbour.resize(faces.size());
  free_edge.resize(faces.size());
  for (std::size_t f = 0; f < faces.size(); ++f) {
    const auto face = static_cast<Index>(f);
    for (int i = 0; i < 3; ++i) {
      const Vec2 at = shape->corner(face, i);
      corner[f][i] = {at.x(), at.y()};
      neighbour[f][i] = static_cast<std::int32_t>(shape->neighbour(face, i));
      free_edge[f][i] = !shape->bends(face, i);
      if (neighbour[f][i] < 0) continue;
      const Vec2 across = shape->place_across(face, i);
      beyond[f][i] = {across.x(), across.y()};
    }
  }
}

bool Topology::is_of(const Garment& garment) const {
  if (garment.vertex_count() != vertices || garment.face_count() != static_cast<Index>(faces.size())) return false;
  for (std::size_t f = 0; f < faces.size(); ++f)
    for (int i = 0; i < 3; ++i)
      if (faces[f][i] != garment.faces(static_cast<Index>(f), i)) return false;
  const Edges &seams = form_.seams, &other = garment.form.seams;
  if (seams.rows() != other.rows() || seams != other) return false;
  if (garment.has_frames() != (frames != nullptr)) return false;
  // The places of frames are those that the garment was drawn with.
  if (frames) return form_.frames == garment.form.frames && drawn_ == garment.positions;
  for (std::int32_t i = 0; i < vertices; ++i)
    if (place[i][0] != garment.rest(i, 0) || place[i][1] != garment.rest(i, 1)) return false;
  return true;
}

void Topology::measure_faces() {
  area.resize(faces.size());
  vertex_area.assign(vertices, 0.0);
  min_height = std::numeric_limits<double>::infinity();
  for (std::size_t f = 0; f < faces.size(); ++f) {
    const auto &p = corner[f][0], &q = corner[f][1], &r = corner[f][2];
    area[f] = 0.5 * std::abs((q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0]));
    double longest = 0.0;
    for (int i = 0; i < 3; ++i) {
      longest = std::max(longest, rest_length(static_cast<std::int32_t>(f), i));
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
  std::vector<const Half*> first_side;
  for (std::size_t k = 0; k < halves.size();) {
    edges.push_back({halves[k].a, halves[k].b});
    first_side.push_back(&halves[k]);
    if (k + 1 < halves.size() && halves[k + 1].a == halves[k].a && halves[k + 1].b == halves[k].b) {
      const Half &s = halves[k], &t = halves[k + 1];
      opposite[s.face][s.corner] = faces[t.face][t.corner];
      opposite[t.face][t.corner] = faces[s.face][s.corner];
      k += 2;
    } else {
      k += 1;
    }
  }
  for (const Half* side : first_side) mean_edge += rest_length(side->face, side->corner);
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

double Topology::rest_length(std::int32_t face, int i) const {
  const auto &a = corner[face][(i + 1) % 3], &b = corner[face][(i + 2) % 3];
  return std::hypot(a[0] - b[0], a[1] - b[1]);
}

}  // namespace weft::cloth
