#include "meshes/mesher.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <numbers>
#include <numeric>

#include "meshes/delaunay.hpp"
#include "meshes/plane.hpp"

namespace weft {
namespace {

constexpr double kMaxVertices = 200000.0;

double distance_to_segment(const Vec2& p, const Vec2& a, const Vec2& b, Vec2* nearest_point = nullptr) {
  const Vec2 d = b - a;
  const double length2 = d.squaredNorm();
  const double t = length2 > 0.0 ? std::clamp((p - a).dot(d) / length2, 0.0, 1.0) : 0.0;
  const Vec2 q = a + t * d;
  if (nearest_point != nullptr) *nearest_point = q;
  return (p - q).norm();
}

bool inside(const std::vector<Vec2>& polygon, const Vec2& p) {
  bool in = false;
  for (std::size_t i = 0, j = polygon.size() - 1; i < polygon.size(); j = i++) {
    const Vec2& a = polygon[i];
    const Vec2& b = polygon[j];
    if ((a.y() > p.y()) != (b.y() > p.y()) && p.x() < (b.x() - a.x()) * (p.y() - a.y()) / (b.y() - a.y()) + a.x()) {
      in = !in;
    }
  }
  return in;
}

/// Uniform grid for neighbour queries while points are placed.
class PointGrid {
 public:
  PointGrid(const Vec2& low, const Vec2& high, double cell) : low_(low), cell_(cell) {
    columns_ = static_cast<std::int64_t>((high.x() - low.x()) / cell) + 1;
    rows_ = static_cast<std::int64_t>((high.y() - low.y()) / cell) + 1;
    cells_.resize(static_cast<std::size_t>(columns_ * rows_));
  }
  void add(const Vec2& p) { cells_[cell_of(p)].push_back(p); }
  /// Whether a point is nearer than `radius` (<= the cell size).
  bool near(const Vec2& p, double radius) const {
    const std::int64_t cx = column(p);
    const std::int64_t cy = row(p);
    for (std::int64_t y = std::max<std::int64_t>(0, cy - 1); y <= std::min(rows_ - 1, cy + 1); ++y) {
      for (std::int64_t x = std::max<std::int64_t>(0, cx - 1); x <= std::min(columns_ - 1, cx + 1); ++x) {
        for (const Vec2& q : cells_[static_cast<std::size_t>(y * columns_ + x)]) {
          if ((p - q).squaredNorm() < radius * radius) return true;
        }
      }
    }
    return false;
  }

 private:
  std::int64_t column(const Vec2& p) const {
    return std::clamp<std::int64_t>(static_cast<std::int64_t>((p.x() - low_.x()) / cell_), 0, columns_ - 1);
  }
  std::int64_t row(const Vec2& p) const {
    return std::clamp<std::int64_t>(static_cast<std::int64_t>((p.y() - low_.y()) / cell_), 0, rows_ - 1);
  }
  std::size_t cell_of(const Vec2& p) const { return static_cast<std::size_t>(row(p) * columns_ + column(p)); }

  Vec2 low_;
  double cell_;
  std::int64_t columns_ = 0, rows_ = 0;
  std::vector<std::vector<Vec2>> cells_;
};

using Triangle = std::array<int, 3>;
using Edge = std::array<int, 2>;

double min_angle(const Vec2& a, const Vec2& b, const Vec2& c) {
  const auto angle = [](const Vec2& p, const Vec2& q, const Vec2& r) {
    return std::atan2(std::abs(cross(q - p, r - p)), (q - p).dot(r - p));
  };
  return std::min({angle(a, b, c), angle(b, c, a), angle(c, a, b)});
}

/// The mesh while it is being relaxed: boundary points first (fixed, in order), then the free ones.
class Mesher {
 public:
  Mesher(const Outline& outline, const MeshSize& size) : size_(size) {
    place_boundary(outline);
    fill();
    relax();
    polish();
    triangulate();
    check();
  }

  const std::vector<Vec2>& points() const { return points_; }
  const std::vector<Triangle>& triangles() const { return triangles_; }
  const std::map<std::string, int>& names() const { return names_; }

 private:
  /// Splits each run between two corners into pieces of about the target length there.
  void place_boundary(const Outline& outline) {
    const auto& all = outline.points;
    const std::size_t n = all.size();
    std::size_t first = 0;
    while (!all[first].corner) ++first;
    for (std::size_t step = 0; step < n;) {
      const std::size_t from = (first + step) % n;
      std::vector<Vec2> run{all[from].at};
      do {
        ++step;
        run.push_back(all[(first + step) % n].at);
      } while (!all[(first + step) % n].corner);
      if (!all[from].name.empty()) names_[all[from].name] = static_cast<int>(points_.size());
      split_run(run);
    }
    fixed_ = points_.size();
    boundary_ = points_;
  }

  void split_run(const std::vector<Vec2>& run) {
    // Integrates ds / size along the run on a fine ladder, then inverts it at equal steps.
    std::vector<Vec2> ladder;
    std::vector<double> sum{0.0};
    for (std::size_t i = 0; i + 1 < run.size(); ++i) {
      const double length = (run[i + 1] - run[i]).norm();
      const double h = std::min({size_.at(run[i]), size_.at(run[i + 1]), smallest()});
      const int pieces = std::max(1, static_cast<int>(std::ceil(8.0 * length / h)));
      for (int k = 0; k < pieces; ++k) {
        const Vec2 p = run[i] + (run[i + 1] - run[i]) * (static_cast<double>(k) / pieces);
        const Vec2 q = run[i] + (run[i + 1] - run[i]) * (static_cast<double>(k + 1) / pieces);
        ladder.push_back(p);
        sum.push_back(sum.back() + (q - p).norm() / size_.at((p + q) / 2.0));
      }
    }
    ladder.push_back(run.back());
    const int count = std::max(1, static_cast<int>(std::lround(sum.back())));
    std::size_t j = 0;
    for (int k = 0; k < count; ++k) {
      const double target = sum.back() * k / count;
      while (j + 1 < sum.size() - 1 && sum[j + 1] <= target) ++j;
      const double t = (target - sum[j]) / (sum[j + 1] - sum[j]);
      points_.push_back(ladder[j] + t * (ladder[j + 1] - ladder[j]));
    }
  }

  const Vec2& at(int i) const { return points_[static_cast<std::size_t>(i)]; }

  double smallest() const { return size_.fine_edge_m > 0.0 ? std::min(size_.edge_m, size_.fine_edge_m) : size_.edge_m; }

  double boundary_distance(const Vec2& p, Vec2* nearest_point = nullptr) const {
    double best = std::numeric_limits<double>::infinity();
    for (std::size_t i = 0; i < boundary_.size(); ++i) {
      Vec2 q;
      const double d = distance_to_segment(p, boundary_[i], boundary_[(i + 1) % boundary_.size()], &q);
      if (d < best) {
        best = d;
        if (nearest_point != nullptr) *nearest_point = q;
      }
    }
    return best;
  }

  /// First guess: the points of a triangular lattice of the finest size, except those too near to an earlier one.
  void fill() {
    Vec2 low = boundary_[0];
    Vec2 high = boundary_[0];
    for (const Vec2& p : boundary_) {
      low = low.cwiseMin(p);
      high = high.cwiseMax(p);
    }
    PointGrid grid(low, high, size_.edge_m);
    for (const Vec2& p : boundary_) grid.add(p);
    const double h = smallest();
    const double row_height = h * std::sqrt(3.0) / 2.0;
    for (std::int64_t row = 1; low.y() + static_cast<double>(row) * row_height < high.y(); ++row) {
      const double offset = row % 2 == 0 ? 0.0 : 0.5;
      for (std::int64_t column = 0;; ++column) {
        const Vec2 p(low.x() + (static_cast<double>(column) + offset + size_.lattice_shift.x()) * h,
                     low.y() + (static_cast<double>(row) + size_.lattice_shift.y()) * row_height);
        if (p.x() > high.x()) break;
        const double wanted = size_.at(p);
        if (grid.near(p, std::min(0.9 * wanted, size_.edge_m))) continue;
        if (!inside(boundary_, p) || boundary_distance(p) < 0.55 * wanted) continue;
        points_.push_back(p);
        grid.add(p);
      }
    }
  }

  /// Delaunay triangles inside the outline, and their edges.
  void triangulate() {
    triangles_.clear();
    for (const Triangle& t : delaunay(points_)) {
      const bool all_fixed = static_cast<std::size_t>(std::max({t[0], t[1], t[2]})) < fixed_;
      if (all_fixed && !inside(boundary_, (at(t[0]) + at(t[1]) + at(t[2])) / 3.0)) continue;
      // Its vertices are on one straight side, and off the line only by the grid's rounding.
      if (all_fixed && min_angle(at(t[0]), at(t[1]), at(t[2])) < 1e-3) continue;
      triangles_.push_back(t);
    }
    edges_.clear();
    for (const Triangle& t : triangles_) {
      for (std::size_t k = 0; k < 3; ++k) {
        edges_.push_back({std::min(t[k], t[(k + 1) % 3]), std::max(t[k], t[(k + 1) % 3])});
      }
    }
    std::sort(edges_.begin(), edges_.end());
    edges_.erase(std::unique(edges_.begin(), edges_.end()), edges_.end());
  }

  /// Persson and Strang's truss: edges below the target length push. Every few steps crowded points are removed and
  /// gaps are filled.
  void relax() {
    constexpr int kSteps = 160;
    constexpr int kControlUntil = 100;
    for (int step = 0; step < kSteps; ++step) {
      triangulate();
      if (step > 0 && step % 10 == 0 && step <= kControlUntil && control_density()) triangulate();
      std::vector<double> wanted(edges_.size());
      double sum_length2 = 0.0;
      double sum_wanted2 = 0.0;
      for (std::size_t e = 0; e < edges_.size(); ++e) {
        const Vec2& a = at(edges_[e][0]);
        const Vec2& b = at(edges_[e][1]);
        wanted[e] = size_.at((a + b) / 2.0);
        sum_length2 += (a - b).squaredNorm();
        sum_wanted2 += wanted[e] * wanted[e];
      }
      const double scale = 1.2 * std::sqrt(sum_length2 / sum_wanted2);
      std::vector<Vec2> force(points_.size(), Vec2::Zero());
      std::vector<bool> at_boundary(points_.size(), false);
      for (std::size_t e = 0; e < edges_.size(); ++e) {
        const auto a = static_cast<std::size_t>(edges_[e][0]);
        const auto b = static_cast<std::size_t>(edges_[e][1]);
        const Vec2 d = points_[a] - points_[b];
        const double length = d.norm();
        const double push = std::max(0.0, wanted[e] * scale - length);
        force[a] += d * (push / length);
        force[b] -= d * (push / length);
        if (a < fixed_ || b < fixed_) at_boundary[a] = at_boundary[b] = true;
      }
      for (std::size_t i = fixed_; i < points_.size(); ++i) {
        const double h = size_.at(points_[i]);
        Vec2 move = 0.2 * force[i];
        const double length = move.norm();
        if (length > 0.2 * h) move *= 0.2 * h / length;
        const Vec2 to = points_[i] + move;
        // A point next to the boundary keeps its distance: the boundary points are fixed and cannot give way.
        if (at_boundary[i] && (!inside(boundary_, to) || boundary_distance(to) < 0.4 * h)) continue;
        points_[i] = to;
      }
    }
  }

  bool control_density() {
    std::vector<bool> removed(points_.size(), false);
    std::vector<bool> touched(points_.size(), false);
    std::vector<Vec2> added;
    for (const Edge& edge : edges_) {
      const auto a = static_cast<std::size_t>(edge[0]);
      const auto b = static_cast<std::size_t>(edge[1]);
      if (touched[a] || touched[b]) continue;
      const double ratio = (points_[a] - points_[b]).norm() / size_.at((points_[a] + points_[b]) / 2.0);
      if (ratio < 0.65 && b >= fixed_) {
        removed[b] = true;
        touched[a] = touched[b] = true;
      } else if (ratio > 1.5 && !(a < fixed_ && b < fixed_)) {
        added.push_back((points_[a] + points_[b]) / 2.0);
        touched[a] = touched[b] = true;
      }
    }
    if (added.empty() && std::find(removed.begin(), removed.end(), true) == removed.end()) return false;
    std::vector<Vec2> kept;
    for (std::size_t i = 0; i < points_.size(); ++i) {
      if (!removed[i]) kept.push_back(points_[i]);
    }
    kept.insert(kept.end(), added.begin(), added.end());
    points_ = std::move(kept);
    return true;
  }

  /// Raises the smallest angles: each free vertex of a bad star tries positions around it and takes the best.
  void polish() {
    for (int round = 0; round < 30; ++round) {
      triangulate();
      std::vector<std::vector<int>> star(points_.size());
      std::vector<double> worst(points_.size(), std::numbers::pi);
      for (std::size_t t = 0; t < triangles_.size(); ++t) {
        for (const int v : triangles_[t]) star[static_cast<std::size_t>(v)].push_back(static_cast<int>(t));
      }
      bool moved = false;
      for (std::size_t i = fixed_; i < points_.size(); ++i) {
        const double before = star_quality(star[i]);
        if (before > 42.0 * kDegree) continue;
        const Vec2 old = points_[i];
        Vec2 best = old;
        double best_quality = before;
        const double h = size_.at(old);
        for (int ring = 1; ring <= 3; ++ring) {
          for (int k = 0; k < 12; ++k) {
            const double angle = 30.0 * kDegree * k;
            points_[i] = old + 0.03 * ring * ring * h * Vec2(std::cos(angle), std::sin(angle));
            const double quality = star_quality(star[i]);
            if (quality > best_quality + 1e-9) {
              best_quality = quality;
              best = points_[i];
            }
          }
        }
        points_[i] = best;
        moved = moved || best != old;
      }
      if (!moved) break;
    }
  }

  /// Smallest angle of the triangles; negative if one is inverted.
  double star_quality(const std::vector<int>& star) const {
    double quality = std::numbers::pi;
    for (const int t : star) {
      const Triangle& tri = triangles_[static_cast<std::size_t>(t)];
      if (cross(at(tri[1]) - at(tri[0]), at(tri[2]) - at(tri[0])) <= 0.0) return -1.0;
      quality = std::min(quality, min_angle(at(tri[0]), at(tri[1]), at(tri[2])));
    }
    return quality;
  }

  void check() const {
    for (std::size_t i = 0; i < fixed_; ++i) {
      const int a = static_cast<int>(i);
      const int b = static_cast<int>((i + 1) % fixed_);
      if (!std::binary_search(edges_.begin(), edges_.end(), Edge{std::min(a, b), std::max(a, b)})) {
        const Vec2 p = points_[i];
        throw ConfigError("the outline near (" + std::to_string(p.x()) + ", " + std::to_string(p.y()) +
                          ") is too fine for this edge length: make the edges shorter there");
      }
    }
  }

  MeshSize size_;
  std::vector<Vec2> points_;
  std::size_t fixed_ = 0;
  std::vector<Vec2> boundary_;
  std::vector<Triangle> triangles_;
  std::vector<Edge> edges_;
  std::map<std::string, int> names_;
};

/// Position along a Hilbert curve of order 16 over the unit square.
std::uint64_t hilbert(double x, double y) {
  constexpr std::uint32_t kSide = 1u << 16;
  auto ix = static_cast<std::uint32_t>(std::clamp(x, 0.0, 1.0) * (kSide - 1));
  auto iy = static_cast<std::uint32_t>(std::clamp(y, 0.0, 1.0) * (kSide - 1));
  std::uint64_t d = 0;
  for (std::uint32_t s = kSide / 2; s > 0; s /= 2) {
    const std::uint32_t rx = (ix & s) > 0 ? 1 : 0;
    const std::uint32_t ry = (iy & s) > 0 ? 1 : 0;
    d += std::uint64_t{s} * s * ((3 * rx) ^ ry);
    if (ry == 0) {
      if (rx == 1) {
        ix = kSide - 1 - ix;
        iy = kSide - 1 - iy;
      }
      std::swap(ix, iy);
    }
  }
  return d;
}

/// Indices 0..n-1 of the points in the order of the Hilbert curve.
std::vector<int> curve_order(const std::vector<Vec2>& places) {
  Vec2 low = places[0];
  Vec2 high = places[0];
  for (const Vec2& p : places) {
    low = low.cwiseMin(p);
    high = high.cwiseMax(p);
  }
  const double extent = (high - low).maxCoeff();
  std::vector<std::uint64_t> key;
  for (const Vec2& p : places) key.push_back(hilbert((p.x() - low.x()) / extent, (p.y() - low.y()) / extent));
  std::vector<int> order(places.size());
  std::iota(order.begin(), order.end(), 0);
  std::stable_sort(order.begin(), order.end(), [&key](int a, int b) {
    return key[static_cast<std::size_t>(a)] < key[static_cast<std::size_t>(b)];
  });
  return order;
}

}  // namespace

double MeshSize::at(const Vec2& p) const {
  if (!(fine_edge_m > 0.0) || fine_edge_m >= edge_m || fine_lines.empty()) return edge_m;
  double distance = std::numeric_limits<double>::infinity();
  for (const Line& line : fine_lines) distance = std::min(distance, distance_to_segment(p, line.a, line.b));
  return std::min(edge_m, fine_edge_m + growth * std::max(0.0, distance - fine_band_m));
}

MeshQuality measure_mesh(const RestPositions& rest, const Faces& faces) {
  MeshQuality quality;
  quality.min_angle_deg = 180.0;
  for (Index f = 0; f < faces.rows(); ++f) {
    std::array<Vec2, 3> p;
    for (Index k = 0; k < 3; ++k) p[static_cast<std::size_t>(k)] = rest.row(faces(f, k)).transpose();
    for (std::size_t k = 0; k < 3; ++k) {
      const Vec2 u = p[(k + 1) % 3] - p[k];
      const Vec2 v = p[(k + 2) % 3] - p[k];
      const double angle = std::atan2(std::abs(cross(u, v)), u.dot(v)) / kDegree;
      quality.min_angle_deg = std::min(quality.min_angle_deg, angle);
      quality.max_angle_deg = std::max(quality.max_angle_deg, angle);
    }
    quality.area_m2 += cross(p[1] - p[0], p[2] - p[0]) / 2.0;
  }
  const auto edges = edges_of(faces);
  std::vector<double> lengths;
  for (Index e = 0; e < edges.rows(); ++e) lengths.push_back((rest.row(edges(e, 0)) - rest.row(edges(e, 1))).norm());
  if (lengths.empty()) return quality;
  std::sort(lengths.begin(), lengths.end());
  quality.edge_min_m = lengths.front();
  quality.edge_median_m = lengths[lengths.size() / 2];
  quality.edge_max_m = lengths.back();
  return quality;
}

GeneratedMesh generate_mesh(const Outline& outline, const MeshSize& size) {
  check_outline(outline);
  if (!(size.edge_m > 0.0 && std::isfinite(size.edge_m))) throw ConfigError("edge_m must be greater than 0");
  if (!(size.fine_edge_m >= 0.0 && size.fine_band_m >= 0.0 && size.growth > 0.0))
    throw ConfigError("fine_edge_m and fine_band_m must not be negative, growth must be greater than 0");
  const double finest = size.fine_edge_m > 0.0 ? std::min(size.edge_m, size.fine_edge_m) : size.edge_m;
  const double expected = signed_area(outline) / (0.866 * finest * finest);
  if (!(expected <= kMaxVertices)) {
    throw ConfigError("an edge length of " + std::to_string(finest) + " m needs up to " +
                      std::to_string(static_cast<std::int64_t>(std::min(expected, 1e15))) +
                      " vertices, must be at most " + std::to_string(static_cast<int>(kMaxVertices)));
  }
  const Mesher mesher(outline, size);

  const auto& points = mesher.points();
  const std::vector<int> order = curve_order(points);
  std::vector<int> number(points.size());
  for (std::size_t i = 0; i < order.size(); ++i) number[static_cast<std::size_t>(order[i])] = static_cast<int>(i);

  GeneratedMesh result;
  Mesh& mesh = result.mesh;
  const auto count = static_cast<Index>(points.size());
  mesh.positions.setZero(count, 3);
  mesh.rest.resize(count, 2);
  for (std::size_t i = 0; i < points.size(); ++i) {
    for (Index k = 0; k < 2; ++k) {
      // Whole micrometres, so that the file is short and reads back to the same bits.
      const double value = std::round(points[i][k] * 1e6) / 1e6 + 0.0;
      mesh.rest(number[i], k) = value;
      mesh.positions(number[i], k) = value;
    }
  }
  std::vector<Vec2> centres;
  for (const Triangle& t : mesher.triangles()) {
    Vec2 centre = Vec2::Zero();
    for (const int v : t) centre += points[static_cast<std::size_t>(v)] / 3.0;
    centres.push_back(centre);
  }
  const std::vector<int> face_order = curve_order(centres);
  mesh.faces.resize(static_cast<Index>(face_order.size()), 3);
  for (std::size_t f = 0; f < face_order.size(); ++f) {
    const Triangle& t = mesher.triangles()[static_cast<std::size_t>(face_order[f])];
    std::array<int, 3> v{};
    for (std::size_t k = 0; k < 3; ++k) v[k] = number[static_cast<std::size_t>(t[k])];
    // Smallest index first, so that the file does not depend on the triangulation's first vertex.
    std::rotate(v.begin(), std::min_element(v.begin(), v.end()), v.end());
    for (Index k = 0; k < 3; ++k) mesh.faces(static_cast<Index>(f), k) = v[static_cast<std::size_t>(k)];
  }
  for (const auto& [name, i] : mesher.names()) result.vertices[name] = number[static_cast<std::size_t>(i)];
  result.quality = measure_mesh(mesh.rest, mesh.faces);
  mesh.source = "generated";
  make_garment(mesh, "generated", result.vertices);  // checks the output by the same rules as any input
  return result;
}

}  // namespace weft
