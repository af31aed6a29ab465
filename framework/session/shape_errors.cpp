#include "session/shape_errors.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <set>

#include "weft/error.hpp"

namespace weft {
namespace {

constexpr double kNone = std::numeric_limits<double>::quiet_NaN();
constexpr double kFarthest = 100.0;  // m; a raster beyond it would only cost time

/// The cells first, first + 1, ..., last of a row.
struct CellRun {
  Index first = 0, last = -1;
  Index count() const { return last - first + 1; }
};

/// The cells of a row or column whose centres lie in [low, high].
CellRun cells_between(double low, double high, double cell) {
  return {static_cast<Index>(std::ceil(low / cell - 0.5)), static_cast<Index>(std::floor(high / cell - 0.5))};
}

/// The silhouette of a shape, row by row from below.
class Silhouette {
 public:
  Silhouette(const Positions& positions, const Faces& faces, double cell) : cell_(cell) {
    for (Index f = 0; f < faces.rows(); ++f) {
      Triangle one;
      for (int k = 0; k < 3; ++k) one.corners[k] = positions.row(faces(f, k)).head<2>().transpose();
      // From below: an edge that two triangles share is then cut at the same
      // number in both, and leaves no gap.
      std::sort(one.corners.begin(), one.corners.end(),
                [](const Corner& a, const Corner& b) { return a.y() != b.y() ? a.y() < b.y() : a.x() < b.x(); });
      one.rows = cells_between(one.corners[0].y(), one.corners[2].y(), cell);
      if (one.rows.count() > 0) triangles_.push_back(one);
    }
    std::sort(triangles_.begin(), triangles_.end(),
              [](const Triangle& a, const Triangle& b) { return a.rows.first < b.rows.first; });
  }

  bool empty() const { return triangles_.empty(); }
  Index first_row() const { return triangles_.front().rows.first; }
  Index last_row() const {
    const auto higher = [](const Triangle& a, const Triangle& b) { return a.rows.last < b.rows.last; };
    return std::max_element(triangles_.begin(), triangles_.end(), higher)->rows.last;
  }

  /// The covered cells of a row, as disjoint runs from left to right. Rows must
  /// be asked for in rising order.
  const std::vector<CellRun>& row(Index number) {
    for (; next_ < triangles_.size() && triangles_[next_].rows.first <= number; ++next_) active_.push_back(next_);
    std::erase_if(active_, [&](std::size_t i) { return triangles_[i].rows.last < number; });
    runs_.clear();
    const double y = (static_cast<double>(number) + 0.5) * cell_;
    for (const std::size_t i : active_) {
      const CellRun run = cut(triangles_[i], y);
      if (run.count() > 0) runs_.push_back(run);
    }
    std::sort(runs_.begin(), runs_.end(), [](const CellRun& a, const CellRun& b) { return a.first < b.first; });
    merged_.clear();
    for (const CellRun& run : runs_) {
      if (!merged_.empty() && run.first <= merged_.back().last + 1)
        merged_.back().last = std::max(merged_.back().last, run.last);
      else
        merged_.push_back(run);
    }
    return merged_;
  }

 private:
  using Corner = Eigen::Vector2d;
  struct Triangle {
    std::array<Corner, 3> corners;  // sorted by y, then x
    CellRun rows;
  };

  /// The cells of the row with centres at height y that a triangle covers.
  CellRun cut(const Triangle& triangle, double y) const {
    double low = std::numeric_limits<double>::infinity(), high = -low;
    for (const auto& [from, to] : {std::pair{0, 1}, {1, 2}, {0, 2}}) {
      const Corner &a = triangle.corners[from], &b = triangle.corners[to];
      if (y < a.y() || y > b.y() || a.y() == b.y()) continue;  // the ends of a level edge belong to the other two
      const double x = a.x() + (y - a.y()) / (b.y() - a.y()) * (b.x() - a.x());
      low = std::min(low, x);
      high = std::max(high, x);
    }
    return low <= high ? cells_between(low, high, cell_) : CellRun();
  }

  double cell_;
  std::vector<Triangle> triangles_;  // by their first row
  std::size_t next_ = 0;
  std::vector<std::size_t> active_;
  std::vector<CellRun> runs_, merged_;
};

Index cells_of(const std::vector<CellRun>& runs) {
  Index count = 0;
  for (const CellRun& run : runs) count += run.count();
  return count;
}

Index cells_in_both(const std::vector<CellRun>& a, const std::vector<CellRun>& b) {
  Index count = 0;
  for (std::size_t i = 0, k = 0; i < a.size() && k < b.size();) {
    count += std::max<Index>(0, std::min(a[i].last, b[k].last) - std::max(a[i].first, b[k].first) + 1);
    a[i].last < b[k].last ? ++i : ++k;
  }
  return count;
}

bool is_near(const Positions& shape) { return shape.leftCols(2).cwiseAbs().maxCoeff() <= kFarthest; }

}  // namespace

double silhouette_iou(const Positions& a, const Positions& b, const Faces& faces, double cell) {
  require_shape("silhouettes: vertices", b.rows(), a.rows());
  return silhouette_iou(a, faces, b, faces, cell);
}

double silhouette_iou(const Positions& a, const Faces& faces_a, const Positions& b, const Faces& faces_b, double cell) {
  if (a.rows() == 0 || b.rows() == 0 || !is_near(a) || !is_near(b)) return kNone;
  Silhouette first(a, faces_a, cell), second(b, faces_b, cell);
  if (first.empty() && second.empty()) return kNone;
  if (first.empty() || second.empty()) return 0.0;
  Index both = 0, any = 0;
  const Index end = std::max(first.last_row(), second.last_row());
  for (Index row = std::min(first.first_row(), second.first_row()); row <= end; ++row) {
    const auto &one = first.row(row), &other = second.row(row);
    const Index shared = cells_in_both(one, other);
    both += shared;
    any += cells_of(one) + cells_of(other) - shared;
  }
  return any > 0 ? static_cast<double>(both) / static_cast<double>(any) : kNone;
}

double silhouette_area(const Positions& shape, const Faces& faces, double cell) {
  if (shape.rows() == 0 || !is_near(shape)) return kNone;
  Silhouette silhouette(shape, faces, cell);
  Index cells = 0;
  if (!silhouette.empty()) {
    for (Index row = silhouette.first_row(); row <= silhouette.last_row(); ++row)
      cells += cells_of(silhouette.row(row));
  }
  return static_cast<double>(cells) * cell * cell;
}

double coverage(const Positions& shape, const Garment& garment, double cell) {
  return silhouette_area(shape, garment.faces, cell) / silhouette_area(garment.positions, garment.faces, cell);
}

double mean_distance_mm(const Positions& shape, const Positions& goal, const std::vector<bool>& counts) {
  if (counts.empty()) return mean_distance_mm(shape, goal);
  require_shape("mean distance: vertices", shape.rows(), goal.rows());
  require_shape("mean distance: counts", counts.size(), goal.rows());
  double sum = 0.0, count = 0.0;
  for (Index v = 0; v < shape.rows(); ++v)
    if (counts[v]) sum += (shape.row(v) - goal.row(v)).norm(), count += 1.0;
  return count > 0.0 ? 1000.0 * sum / count : kNone;
}

ShapeErrors shape_errors(const Positions& shape, const Positions& goal, const Task& task,
                         const std::vector<bool>& seen) {
  require_shape("shape errors: vertices", shape.rows(), goal.rows());
  const Vector distances = 1000.0 * (shape - goal).rowwise().norm();
  const auto counts = [&](Index vertex) { return seen.empty() || seen[vertex]; };
  const auto mean_over = [&](const std::set<Index>& vertices) {
    double sum = 0.0, count = 0.0;
    for (const Index v : vertices) {
      if (counts(v)) sum += distances(v), count += 1.0;
    }
    return count > 0.0 ? sum / count : kNone;
  };
  ShapeErrors errors;
  for (Index v = 0; v < distances.size(); ++v)
    if (counts(v)) errors.max_mm = std::max(errors.max_mm, distances(v));
  const auto& grasped = task.manipulation.grasp_vertices;
  errors.grasped_mm = mean_over({grasped.begin(), grasped.end()});
  std::set<Index> named;
  for (const auto& [name, vertex] : task.garment->vertices) named.insert(vertex);
  errors.named_mm = mean_over(named);
  errors.iou = silhouette_iou(shape, goal, task.garment->faces);
  errors.coverage = coverage(shape, *task.garment);
  return errors;
}

}  // namespace weft
