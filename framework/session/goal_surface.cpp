#include "session/goal_surface.hpp"

#include <png.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "sdk/files.hpp"
#include "session/shape_errors.hpp"
#include "weft/error.hpp"

namespace weft {
namespace {

constexpr Index kSamples = 512, kOutlineSamples = 256, kFineSamples = 4096;
constexpr double kSquareMillimetres = 1e6;  // m^2 to mm^2
constexpr double kMostPixels = 1e8;

Vector face_areas(const Positions& positions, const Faces& faces) {
  Vector areas(faces.rows());
  for (Index f = 0; f < faces.rows(); ++f) {
    const Vec3 a = positions.row(faces(f, 0)), b = positions.row(faces(f, 1)), c = positions.row(faces(f, 2));
    areas(f) = 0.5 * (b - a).cross(c - a).norm();
  }
  return areas;
}

/// Edges as faces a, b, b.
Faces faces_of_edges(const Edges& edges) {
  Faces faces(edges.rows(), 3);
  faces << edges, edges.col(1);
  return faces;
}

Vector edge_lengths(const Positions& positions, const Faces& edges) {
  Vector lengths(edges.rows());
  for (Index i = 0; i < edges.rows(); ++i)
    lengths(i) = (positions.row(edges(i, 1)) - positions.row(edges(i, 0))).norm();
  return lengths;
}

Faces faces_of_points(Index points) {
  Faces faces(points, 3);
  for (Index i = 0; i < points; ++i) faces.row(i).setConstant(static_cast<int>(i));
  return faces;
}

/// Even over area or length: the k-th sample lies where the measure of the faces before it is (k + 1/2) / count of all, at
/// the k-th point of an additive recurrence in the face (Roberts 2018, "The unreasonable effectiveness of quasirandom
/// sequences").
Positions even_samples(const Positions& positions, const Faces& faces, const Vector& measure, Index count) {
  constexpr double kFirst = 0.7548776662466927, kSecond = 0.5698402909980532;
  const double each = measure.sum() / static_cast<double>(count);
  Positions samples(count, 3);
  Index face = 0;
  double before = 0.0;
  for (Index k = 0; k < count; ++k) {
    const double wanted = (static_cast<double>(k) + 0.5) * each;
    while (face + 1 < measure.size() && before + measure(face) < wanted) before += measure(face++);
    double integer = 0.0;
    double u = std::modf(0.5 + static_cast<double>(k) * kFirst, &integer);
    double v = std::modf(0.5 + static_cast<double>(k) * kSecond, &integer);
    if (u + v > 1.0) u = 1.0 - u, v = 1.0 - v;
    samples.row(k) = (1.0 - u - v) * positions.row(faces(face, 0)) + u * positions.row(faces(face, 1)) +
                     v * positions.row(faces(face, 2));
  }
  return samples;
}

/// Every n-th point.
Positions some_points(const Positions& positions, Index count) {
  const Index all = positions.rows(), taken = std::min(count, all);
  Positions samples(taken, 3);
  for (Index k = 0; k < taken; ++k) samples.row(k) = positions.row(k * all / taken);
  return samples;
}

}  // namespace

GoalSurface::GoalSurface(GoalKind kind, const Positions& positions, const Faces& faces, const Garment& garment)
    : kind_(kind),
      positions_(positions),
      faces_(faces),
      cloth_(garment.faces),
      axes_(1.0, 1.0, kind == GoalKind::silhouette ? 0.0 : 1.0) {
  if (positions_.rows() == 0) throw ShapeError("goal: holds no point");
  if (kind_ == GoalKind::silhouette) positions_.col(2).setZero();
  const Vector cloth_areas = face_areas(garment.positions, cloth_);
  if (kind_ == GoalKind::points) {
    parts_.push_back(
        make_part(garment, cloth_, cloth_areas, faces_of_points(positions_.rows()), some_points(positions_, kSamples)));
    return;
  }
  const Vector areas = face_areas(positions_, faces_);
  if (!(areas.sum() > 0.0)) throw ShapeError("goal: its faces have no area");
  parts_.push_back(make_part(garment, cloth_, cloth_areas, faces_, even_samples(positions_, faces_, areas, kSamples)));
  if (kind_ == GoalKind::silhouette) return;
  const Faces cloth_edges = faces_of_edges(open_edges(cloth_)), edges = faces_of_edges(open_edges(faces_));
  const Vector lengths = edge_lengths(positions_, edges);
  if (cloth_edges.rows() == 0 || !(lengths.sum() > 0.0)) return;
  parts_.push_back(make_part(garment, cloth_edges, edge_lengths(garment.positions, cloth_edges), edges,
                             even_samples(positions_, edges, lengths, kOutlineSamples)));
}

GoalSurface::Part GoalSurface::make_part(const Garment& garment, const Faces& cloth, const Vector& measure,
                                         const Faces& goal, Positions samples) const {
  Vector shares = Vector::Zero(garment.vertex_count());
  for (Index f = 0; f < cloth.rows(); ++f) {
    const bool is_edge = cloth(f, 1) == cloth(f, 2);
    for (Index k = 0; k < (is_edge ? 2 : 3); ++k)
      shares(cloth(f, k)) += measure(f) / ((is_edge ? 2.0 : 3.0) * measure.sum());
  }
  const double per_coordinate = kSquareMillimetres / axes_.sum();
  Part part{.vertices = {},
            .vertex_factors = {},
            .cloth = cloth,
            .goal = tree_of(positions_, goal),
            .samples = std::move(samples),
            .sample_factor = 0.0};
  for (Index v = 0; v < shares.size(); ++v)
    if (shares(v) > 0.0) part.vertices.push_back(v);
  part.vertex_factors.resize(std::ssize(part.vertices));
  for (Index i = 0; i < part.vertex_factors.size(); ++i)
    part.vertex_factors(i) = std::sqrt(per_coordinate * shares(part.vertices[i]));
  part.sample_factor = std::sqrt(per_coordinate / static_cast<double>(part.samples.rows()));
  return part;
}

NearestSurface GoalSurface::tree_of(const Positions& positions, const Faces& faces) const {
  std::vector<Vec3> points(positions.rows());
  for (Index v = 0; v < positions.rows(); ++v) points[v] = positions.row(v).transpose().array() * axes_;
  std::vector<std::array<int, 3>> triangles(faces.rows());
  for (Index f = 0; f < faces.rows(); ++f) triangles[f] = {faces(f, 0), faces(f, 1), faces(f, 2)};
  return {std::move(points), std::move(triangles)};
}

GoalPairs GoalSurface::pairs(const Positions& shape) const {
  require_shape("goal: vertices of the cloth", shape.rows(), cloth_.maxCoeff() + 1);
  GoalPairs pairs;
  for (const auto& part : parts_) {
    auto& found = pairs.parts.emplace_back();
    found.onto.resize(std::ssize(part.vertices), 3);
    for (Index i = 0; i < found.onto.rows(); ++i) {
      const Vec3 point = shape.row(part.vertices[i]).transpose().array() * axes_;
      found.onto.row(i) = part.goal.nearest(point).point.transpose();
    }
    const NearestSurface cloth = tree_of(shape, part.cloth);
    found.weights.resize(part.samples.rows(), 3);
    for (Index s = 0; s < part.samples.rows(); ++s) {
      const auto hit = cloth.nearest(part.samples.row(s).transpose());
      const auto& corners = cloth.face(hit.face);
      found.faces.push_back({corners[0], corners[1], corners[2]});
      found.weights.row(s) = hit.weights.transpose();
    }
  }
  return pairs;
}

Index GoalSurface::residual_count() const {
  Index count = 0;
  for (const auto& part : parts_) count += 3 * (std::ssize(part.vertices) + part.samples.rows());
  return count;
}

Vector GoalSurface::residuals(const GoalPairs& pairs, const Positions& shape) const {
  Vector residuals = residual_change(pairs, shape);
  Index row = 0;
  const auto subtract = [&](double factor, const auto& point) {
    residuals.segment<3>(3 * row++).array() -= factor * point.transpose().array() * axes_;
  };
  for (std::size_t p = 0; p < parts_.size(); ++p) {
    const auto& part = parts_[p];
    for (Index i = 0; i < part.vertex_factors.size(); ++i) subtract(part.vertex_factors(i), pairs.parts[p].onto.row(i));
    for (Index s = 0; s < part.samples.rows(); ++s) subtract(part.sample_factor, part.samples.row(s));
  }
  return residuals;
}

Vector GoalSurface::residual_change(const GoalPairs& pairs, const Positions& change) const {
  Vector result(residual_count());
  Index row = 0;
  const auto add = [&](double factor, const Eigen::RowVector3d& point) {
    result.segment<3>(3 * row++) = factor * point.transpose().array() * axes_;
  };
  for (std::size_t p = 0; p < parts_.size(); ++p) {
    const auto& part = parts_[p];
    for (Index i = 0; i < part.vertex_factors.size(); ++i) add(part.vertex_factors(i), change.row(part.vertices[i]));
    for (Index s = 0; s < part.samples.rows(); ++s) {
      Eigen::RowVector3d point = Eigen::RowVector3d::Zero();
      for (int k = 0; k < 3; ++k) point += pairs.parts[p].weights(s, k) * change.row(pairs.parts[p].faces[s][k]);
      add(part.sample_factor, point);
    }
  }
  return result;
}

Positions GoalSurface::pullback(const GoalPairs& pairs, const Vector& residuals) const {
  Positions gradient = Positions::Zero(cloth_.maxCoeff() + 1, 3);
  Index row = 0;
  const auto next = [&]() -> Eigen::RowVector3d {
    return (residuals.segment<3>(3 * row++).array() * axes_).matrix().transpose();
  };
  for (std::size_t p = 0; p < parts_.size(); ++p) {
    const auto& part = parts_[p];
    for (Index i = 0; i < part.vertex_factors.size(); ++i)
      gradient.row(part.vertices[i]) += part.vertex_factors(i) * next();
    for (Index s = 0; s < part.samples.rows(); ++s) {
      const Eigen::RowVector3d one = part.sample_factor * next();
      for (int k = 0; k < 3; ++k) gradient.row(pairs.parts[p].faces[s][k]) += pairs.parts[p].weights(s, k) * one;
    }
  }
  return gradient;
}

Vector GoalSurface::distances_mm(const Positions& shape) const {
  Vector distances(shape.rows());
  for (Index v = 0; v < shape.rows(); ++v)
    distances(v) = 1000.0 * parts_.front().goal.nearest(shape.row(v).transpose().array() * axes_).distance;
  return distances;
}

double GoalSurface::chamfer_mm(const Positions& shape) const {
  const NearestSurface cloth = tree_of(shape, cloth_);
  const Positions fine = kind_ == GoalKind::points
                             ? some_points(positions_, kFineSamples)
                             : even_samples(positions_, faces_, face_areas(positions_, faces_), kFineSamples);
  double back = 0.0;
  for (Index s = 0; s < fine.rows(); ++s) back += cloth.nearest(fine.row(s).transpose()).distance;
  return 0.5 * (distances_mm(shape).mean() + 1000.0 * back / static_cast<double>(fine.rows()));
}

double GoalSurface::iou(const Positions& shape) const {
  if (kind_ == GoalKind::points) return std::numeric_limits<double>::quiet_NaN();
  return silhouette_iou(shape, cloth_, positions_, faces_);
}

void read_mask(const std::filesystem::path& file, double metres_per_pixel, const Eigen::Vector2d& origin,
               Positions& positions, Faces& faces) {
  const auto fail = [&](const std::string& problem) { throw ConfigError(file.string() + ": " + problem); };
  require_file(file);
  png_image image{};
  image.version = PNG_IMAGE_VERSION;
  if (png_image_begin_read_from_file(&image, file.c_str()) == 0) fail(std::string("is no PNG: ") + image.message);
  image.format = PNG_FORMAT_GRAY;
  const Index width = image.width, height = image.height;
  if (static_cast<double>(width) * static_cast<double>(height) > kMostPixels) {
    png_image_free(&image);
    fail("has " + std::to_string(width) + " x " + std::to_string(height) + " pixels, must have at most 1e8");
  }
  std::vector<unsigned char> grey(PNG_IMAGE_SIZE(image));
  const png_color black{0, 0, 0};
  if (png_image_finish_read(&image, &black, grey.data(), 0, nullptr) == 0)
    fail(std::string("is damaged: ") + image.message);
  // Every run of white pixels in a row is a rectangle.
  std::vector<std::array<double, 4>> runs;  // x from, x to, y from, y to
  for (Index row = 0; row < height; ++row) {
    const unsigned char* pixels = grey.data() + row * width;
    const double top = origin.y() + static_cast<double>(height - row) * metres_per_pixel;
    for (Index column = 0; column < width;) {
      Index end = column;
      while (end < width && pixels[end] >= 128) ++end;
      if (end > column)
        runs.push_back({origin.x() + static_cast<double>(column) * metres_per_pixel,
                        origin.x() + static_cast<double>(end) * metres_per_pixel, top - metres_per_pixel, top});
      column = std::max(end, column + 1);
    }
  }
  if (runs.empty()) fail("has no white pixel: white is cloth");
  positions.resize(4 * std::ssize(runs), 3);
  faces.resize(2 * std::ssize(runs), 3);
  for (Index i = 0; i < std::ssize(runs); ++i) {
    const auto& [left, right, bottom, top] = runs[i];
    const int first = static_cast<int>(4 * i);
    positions.row(first) << left, bottom, 0.0;
    positions.row(first + 1) << right, bottom, 0.0;
    positions.row(first + 2) << right, top, 0.0;
    positions.row(first + 3) << left, top, 0.0;
    faces.row(2 * i) << first, first + 1, first + 2;
    faces.row(2 * i + 1) << first, first + 2, first + 3;
  }
}

}  // namespace weft
