#include "weft/rest_shape.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <tuple>

namespace weft {
namespace {

// A pair of primitives whose shortest way crosses more faces than this is not near by any measure of a contact.
constexpr int kDeepest = 6;
// A direction counts as square to a face when its part in the face is less than this (6 degrees).
constexpr double kSquare = 0.1;

double cross2(const Vec2& a, const Vec2& b) { return a.x() * b.y() - a.y() * b.x(); }

double point_to_segment(const Vec2& p, const Vec2& a, const Vec2& b) {
  const Vec2 e = b - a;
  const double t = std::clamp((p - a).dot(e) / std::max(e.squaredNorm(), 1e-300), 0.0, 1.0);
  return (p - a - t * e).norm();
}
double segment_to_segment(const Vec2& a, const Vec2& b, const Vec2& c, const Vec2& d) {
  return std::min(
      {point_to_segment(a, c, d), point_to_segment(b, c, d), point_to_segment(c, a, b), point_to_segment(d, a, b)});
}

}  // namespace

/// From a primitive that lies at a fixed place of an unfolded plane.
struct RestShape::Search {
  std::array<int, 4> v;
  bool edges;
  std::array<Vec2, 2> from;  // the vertex twice, or the first edge
  double best;
};

RestShape::RestShape(const Garment& garment)
    : faces_(garment.faces), rest_(garment.rest), frames_(garment.form.frames) {
  struct Half {
    int first, second;
    Index face;
    int corner;
  };
  std::vector<Half> halves;
  halves.reserve(3 * faces_.rows());
  for (Index f = 0; f < faces_.rows(); ++f) {
    for (int k = 0; k < 3; ++k) {
      const auto [a, b] = std::minmax(faces_(f, (k + 1) % 3), faces_(f, (k + 2) % 3));
      halves.push_back({a, b, f, k});
    }
  }
  std::sort(halves.begin(), halves.end(), [](const Half& l, const Half& r) {
    return std::tie(l.first, l.second, l.face) < std::tie(r.first, r.second, r.face);
  });
  across_.resize(halves.size());
  const Edges& seams = garment.form.seams;
  Index seam = 0;  // both lists are sorted
  for (std::size_t i = 0; i + 1 < halves.size(); ++i) {
    const Half &s = halves[i], &t = halves[i + 1];
    if (s.first != t.first || s.second != t.second) continue;
    while (seam < seams.rows() && std::tie(seams(seam, 0), seams(seam, 1)) < std::tie(s.first, s.second)) ++seam;
    const bool sewn = seam < seams.rows() && seams(seam, 0) == s.first && seams(seam, 1) == s.second;
    across_[3 * s.face + s.corner] = {t.face, t.corner, !sewn};
    across_[3 * t.face + t.corner] = {s.face, s.corner, !sewn};
  }
  if (is_chart()) return;
  clear_.assign(garment.vertex_count(), std::numeric_limits<double>::infinity());
  faces_of_.resize(clear_.size());
  for (Index f = 0; f < faces_.rows(); ++f) {
    for (int k = 0; k < 3; ++k) {
      const auto v = static_cast<std::size_t>(faces_(f, k));
      clear_[v] = std::min(clear_[v], 2.0 * area(f) / (corner(f, (k + 1) % 3) - corner(f, (k + 2) % 3)).norm());
      faces_of_[v].push_back(f);
    }
  }
}

double RestShape::area(Index face) const {
  const Vec2 p = corner(face, 0);
  return 0.5 * std::abs(cross2(corner(face, 1) - p, corner(face, 2) - p));
}

int RestShape::corner_of(Index face, int vertex) const {
  for (int k = 0; k < 3; ++k)
    if (faces_(face, k) == vertex) return k;
  return -1;
}

/// The corners of the neighbour across edge k, in the plane where this face has its corners at `place`.
RestShape::Triangle RestShape::unfolded(Index face, int k, const Triangle& place) const {
  const Side& side = across_[3 * face + k];
  const Index g = side.face;
  // The neighbour runs their common edge the other way.
  const int a = (side.corner + 1) % 3, b = (side.corner + 2) % 3;
  const Vec2 &pa = place[(k + 2) % 3], &pb = place[(k + 1) % 3];
  const Vec2 ga = corner(g, a), e = corner(g, b) - ga, o = corner(g, side.corner) - ga;
  const Vec2 along = pb - pa;
  const double part = o.dot(e) / e.squaredNorm(), height = cross2(e, o) / e.norm();
  const Vec2 normal = Vec2(-along.y(), along.x()) / along.norm();
  Triangle result;
  result[a] = pa;
  result[b] = pb;
  result[side.corner] = pa + part * along + height * normal;
  return result;
}

Vec2 RestShape::place_across(Index face, int k) const {
  const Side& side = across_[3 * face + k];
  if (is_chart()) return rest_.row(faces_(side.face, side.corner)).transpose();
  return unfolded(face, k, {corner(face, 0), corner(face, 1), corner(face, 2)})[side.corner];
}

double RestShape::edge_length(Index face, int k) const {
  const double own = (corner(face, (k + 1) % 3) - corner(face, (k + 2) % 3)).norm();
  const Side& side = across_[3 * face + k];
  if (is_chart() || side.face < 0) return own;
  return 0.5 * (own + (corner(side.face, (side.corner + 1) % 3) - corner(side.face, (side.corner + 2) % 3)).norm());
}

void RestShape::search(Search& s, Index face, const Triangle& place, Index from, int depth) const {
  const auto at = [&](int vertex) { return place[corner_of(face, vertex)]; };
  const int first = s.edges ? 2 : 1;
  bool holds = true;
  for (int k = first; k < 4; ++k) holds = holds && corner_of(face, s.v[k]) >= 0;
  if (holds) {
    if (s.edges)
      s.best = std::min(s.best, segment_to_segment(s.from[0], s.from[1], at(s.v[2]), at(s.v[3])));
    else
      for (int k = 1; k < 4; ++k)
        s.best = std::min(s.best, point_to_segment(s.from[0], at(s.v[k]), at(s.v[k % 3 + 1])));
  }
  if (depth == kDeepest) return;
  for (int k = 0; k < 3; ++k) {
    const Index next = neighbour(face, k);
    if (next < 0 || next == from) continue;
    const Vec2 &a = place[(k + 1) % 3], &b = place[(k + 2) % 3];
    if (segment_to_segment(s.from[0], s.from[1], a, b) < s.best)
      search(s, next, unfolded(face, k, place), face, depth + 1);
  }
}

double RestShape::distance(const std::array<int, 4>& v, bool edges, double most) const {
  // No way from a vertex to a primitive without it is shorter than the least height of the faces there.
  double clear = std::numeric_limits<double>::infinity();
  for (const int i : v) clear = std::min(clear, clear_[i]);
  if (clear >= most) return most;
  Search s{v, edges, {}, most};
  for (const Index f : faces_of_[v[0]]) {
    if (edges && corner_of(f, v[1]) < 0) continue;
    const Triangle place{corner(f, 0), corner(f, 1), corner(f, 2)};
    s.from[0] = place[corner_of(f, v[0])];
    s.from[1] = edges ? place[corner_of(f, v[1])] : s.from[0];
    search(s, f, place, -1, 0);
  }
  return s.best;
}

Grain usual_grain(const Positions& positions) {
  const Eigen::RowVector3d size = positions.colwise().maxCoeff() - positions.colwise().minCoeff();
  return {true, size.z() < 0.5 * size.head<2>().maxCoeff() ? Vec3(0.0, 1.0, 0.0) : Vec3(0.0, 0.0, 1.0)};
}

RestFrames frames_of_shape(const Positions& positions, const Faces& faces, const Grain& grain, double scale) {
  RestFrames frames(faces.rows(), 4);
  for (Index f = 0; f < faces.rows(); ++f) {
    const Eigen::Vector3d p = positions.row(faces(f, 0));
    const Eigen::Vector3d q = Eigen::Vector3d(positions.row(faces(f, 1))) - p;
    const Eigen::Vector3d r = Eigen::Vector3d(positions.row(faces(f, 2))) - p;
    const Eigen::Vector3d normal = q.cross(r).normalized();
    Eigen::Vector3d along = Eigen::Vector3d::Zero();
    for (const Eigen::Vector3d& wanted : {Eigen::Vector3d(grain.direction).normalized(),
                                          Eigen::Vector3d::UnitY().eval(), Eigen::Vector3d::UnitX().eval()}) {
      along = wanted - wanted.dot(normal) * normal;
      if (along.norm() > kSquare) break;
    }
    along.normalize();
    // (warp, weft, normal) are right-handed.
    const Eigen::Vector3d warp = grain.is_weft ? along.cross(normal).eval() : along, weft = normal.cross(warp);
    frames.row(f) << q.dot(warp), q.dot(weft), r.dot(warp), r.dot(weft);
  }
  return scale * frames;
}

double median_strain(const Garment& garment) {
  const RestShape shape(garment);
  std::vector<double> strains;
  for (Index f = 0; f < shape.face_count(); ++f) {
    for (int k = 0; k < 3; ++k) {
      if (shape.neighbour(f, k) > f) continue;  // each edge once
      const double drawn =
          (garment.positions.row(garment.faces(f, (k + 1) % 3)) - garment.positions.row(garment.faces(f, (k + 2) % 3)))
              .norm();
      strains.push_back(std::abs(drawn / shape.edge_length(f, k) - 1.0));
    }
  }
  const auto middle = strains.begin() + static_cast<std::ptrdiff_t>(strains.size() / 2);
  std::nth_element(strains.begin(), middle, strains.end());
  return *middle;
}

}  // namespace weft
