#include "mass_scaling.hpp"

#include <Eigen/SparseCholesky>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <tuple>
#include <utility>

#include "stability.hpp"

namespace weft::cloth {
namespace {

// In w0 = 1 + kDamping / s^2. With it, lambda p(lambda) of short waves lies between 0.3 and 1.7 of its mean.
constexpr double kDamping = 0.4;
constexpr int kMostStages = 64;
// Floats before the first and after the last record of a plane: a diagonal of eight lanes begins at most seven early.
constexpr std::int32_t kRoom = 8;

/// For eigenvalues up to `most`.
struct Polynomial {
  std::vector<std::array<double, 3>> stage;  ///< now, last, slope of MassScaling::Stage
  double tau = 0.0, end = 0.0;               ///< end: 1 / T_s(w0)
  double largest() const { return (1.0 + end) / tau; }
};
Polynomial polynomial(int stages, double most) {
  const double w0 = 1.0 + kDamping / (stages * stages), w1 = (1.0 + w0) / most;
  Polynomial p;
  double before = 1.0, now = w0;  // T_{j-1}(w0), T_j(w0)
  double y_before = 0.0, y = w1 / w0;
  p.stage.push_back({0.0, 0.0, y});
  for (int j = 1; j < stages; ++j) {
    const double next = 2.0 * w0 * now - before, mu = 2.0 * now / next, nu = before / next;
    p.stage.push_back({mu * w0, -nu, mu * w1});
    const double y_next = mu * w0 * y - nu * y_before + mu * w1;  // at lambda = 0
    y_before = std::exchange(y, y_next);
    before = std::exchange(now, next);
  }
  p.tau = y;
  p.end = 1.0 / now;
  return p;
}

}  // namespace

MassScaling::MassScaling(const Topology& topology, const MembraneModuli& m, double density,
                         const std::vector<double>& masses, double length) {
  if (length <= 0.0) return;
  // c11 e11^2 + 2 c12 e11 e22 + c22 e22^2 + g (2 e12)^2 <= sum over x, y of warp (d/du)^2 + weft (d/dv)^2: the first
  // three terms by 2 c12 e11 e22 <= c12 (r e11^2 + e22^2 / r), the last where g / warp + g / weft <= 1.
  const double r = std::sqrt(m.c22 / m.c11);
  double warp = m.c11 + m.c12 * r, weft = m.c22 + m.c12 / r;
  const double up = std::max(1.0, m.g / warp + m.g / weft);
  warp *= up, weft *= up;

  struct Entry {
    std::int32_t row, column;
    double value;
  };
  std::vector<Entry> entries;
  for (std::size_t f = 0; f < topology.faces.size(); ++f) {
    const auto& face = topology.faces[f];
    double gradient[3][2];  // of the hat functions: the opposite edge, turned
    for (int k = 0; k < 3; ++k) {
      const auto &p = topology.corner[f][(k + 1) % 3], &q = topology.corner[f][(k + 2) % 3];
      gradient[k][0] = (p[1] - q[1]) / (2.0 * topology.area[f]);
      gradient[k][1] = (q[0] - p[0]) / (2.0 * topology.area[f]);
    }
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j)
        entries.push_back(
            {face[i], face[j],
             topology.area[f] * (warp * gradient[i][0] * gradient[j][0] + weft * gradient[i][1] * gradient[j][1])});
  }
  std::stable_sort(entries.begin(), entries.end(), [](const Entry& a, const Entry& b) {
    return std::pair(a.row, a.column) < std::pair(b.row, b.column);
  });
  std::vector<double> value;
  std::vector<std::int32_t> start(topology.vertices + 1, 0), column;
  for (std::size_t k = 0; k < entries.size(); ++k) {
    if (k > 0 && entries[k].row == entries[k - 1].row && entries[k].column == entries[k - 1].column) {
      value.back() += entries[k].value;
      continue;
    }
    column.push_back(entries[k].column);
    value.push_back(entries[k].value);
    start[entries[k].row + 1] = static_cast<std::int32_t>(column.size());
  }
  for (std::size_t i = 1; i < start.size(); ++i) start[i] = std::max(start[i], start[i - 1]);

  const double most = largest_eigenvalue(masses, [&](const std::vector<double>& x, std::vector<double>& out) {
    for (std::size_t i = 0; i < x.size(); ++i) {
      out[i] = 0.0;
      for (std::int32_t k = start[i]; k < start[i + 1]; ++k) out[i] += value[k] * x[column[k]];
    }
  });
  const double allowed = std::max(warp, weft) / density / (length * length);
  if (most <= allowed) return;
  Polynomial p;
  do p = polynomial(++stages_, most);
  while (p.largest() > allowed && stages_ < kMostStages);
  // The number of stages is whole: an effect beyond `allowed` is not used.
  if (p.largest() < allowed) p = polynomial(stages_, most * allowed / p.largest());
  largest_ = p.largest();
  arrange(topology, start, column, value);
  std::vector<Eigen::Triplet<double>> triplets;
  for (const Entry& e : entries) triplets.emplace_back(e.row, e.column, e.value);
  laplacian_.resize(topology.vertices, topology.vertices);
  laplacian_.setFromTriplets(triplets.begin(), triplets.end());
  for (const auto& [now, last, slope] : p.stage)
    stage_.push_back({static_cast<float>(now), static_cast<float>(last), static_cast<float>(slope / p.tau),
                      static_cast<float>(slope)});
}

double MassScaling::largest(
    const std::function<void(const std::vector<double>&, std::vector<double>&)>& stiffness) const {
  // L is singular: it maps fields that are constant on a piece of the cloth to 0, and so does K. A shift of its
  // diagonal hardly changes r.
  const Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>> solver(
      laplacian_ + 1e-9 * Eigen::SparseMatrix<double>(laplacian_.diagonal().asDiagonal()));
  const std::size_t n = laplacian_.rows();
  return largest_ * power_iteration(n, [&](std::vector<double>& x) {
           std::vector<double> k(n);
           stiffness(x, k);
           const Eigen::Map<const Eigen::VectorXd> force(k.data(), laplacian_.rows());
           Eigen::Map<Eigen::VectorXd> shape(x.data(), laplacian_.rows());
           const double quotient = shape.dot(force) / shape.dot(laplacian_ * shape);
           shape = solver.solve(force);
           shape /= shape.cwiseAbs().maxCoeff();
           return quotient;
         });
}

void MassScaling::Planes::resize(std::size_t rows) {
  for (auto& plane : of) plane.assign(rows + 2 * kRoom, 0.0f);
}

void MassScaling::arrange(const Topology& topology, const std::vector<std::int32_t>& start,
                          const std::vector<std::int32_t>& column, const std::vector<double>& value) {
  // Consecutive vertices of a strip should have consecutive neighbours in one strip, so that there are few diagonals. A
  // triangular lattice has 7 where its rows are the strips.
  const std::int32_t n = topology.vertices, padding = (8 - n % 8) % 8;
  std::vector<std::int32_t> order(n), row(order.size()), strip(order.size()), offsets;
  const auto group_offsets = [&](std::int32_t first) -> std::vector<std::int32_t>& {
    offsets.clear();
    for (std::int32_t r = first; r < std::min(first + 8, n); ++r)
      for (std::int32_t k = start[order[r]]; k < start[order[r] + 1]; ++k)
        offsets.push_back(row[column[k]] - (r - first));
    std::sort(offsets.begin(), offsets.end());
    offsets.erase(std::unique(offsets.begin(), offsets.end()), offsets.end());
    return offsets;
  };
  std::size_t fewest = std::numeric_limits<std::size_t>::max();
  for (const int across : {1, 0})
    for (const double height : {0.8, 0.866, 0.93, 1.0})
      for (const double shift : {0.0, 0.5}) {
        const auto place = [&](std::int32_t i, int axis) { return topology.place[i][axis]; };
        for (std::int32_t i = 0; i < n; ++i) {
          order[i] = i;
          strip[i] = static_cast<std::int32_t>(std::floor(place(i, across) / (height * topology.mean_edge) + shift));
        }
        std::sort(order.begin(), order.end(), [&](std::int32_t i, std::int32_t j) {
          return std::tuple(strip[i], place(i, 1 - across), i) < std::tuple(strip[j], place(j, 1 - across), j);
        });
        for (std::int32_t r = 0; r < n; ++r) row[order[r]] = r;
        std::size_t diagonals = 0;
        for (std::int32_t first = 0; first < n; first += 8) diagonals += group_offsets(first).size();
        if (diagonals >= fewest) continue;
        fewest = diagonals;
        vertex_ = order;
      }

  order = vertex_;
  for (std::int32_t r = 0; r < n; ++r) row[order[r]] = r;
  vertex_.insert(vertex_.end(), padding, order.back());
  start_.push_back(0);
  for (std::int32_t first = 0; first < n; first += 8) {
    const std::size_t begin = at_.size();
    for (const std::int32_t offset : group_offsets(first)) {
      at_.push_back(offset + kRoom);
      diagonal_.push_back({});
    }
    for (std::int32_t r = first; r < std::min(first + 8, n); ++r)
      for (std::int32_t k = start[order[r]]; k < start[order[r] + 1]; ++k) {
        const auto here = std::lower_bound(at_.begin() + static_cast<std::ptrdiff_t>(begin), at_.end(),
                                           row[column[k]] - (r - first) + kRoom);
        diagonal_[here - at_.begin()].value[r - first] = static_cast<float>(value[k]);
      }
    start_.push_back(static_cast<std::int32_t>(at_.size()));
  }
  for (Planes* planes : {&a_, &w_, &now_, &last_}) planes->resize(vertex_.size());
  out_.resize(n);
}

const Float4* MassScaling::apply(const Float4* a, const Float4* w) const {
  const auto rows = static_cast<std::int32_t>(vertex_.size()), n = static_cast<std::int32_t>(out_.size());
  const auto planes = [](Planes& p) {
    return std::array<float*, 3>{p.of[0].data() + kRoom, p.of[1].data() + kRoom, p.of[2].data() + kRoom};
  };
  const std::array<float*, 3> forced = planes(a_), free = planes(w_);
  std::array<float*, 3> now = planes(now_), last = planes(last_);
  const F8 first_gain = splat(stage_[0].gain), zero = _mm256_setzero_ps();
  for (std::int32_t r = 0; r < rows; r += 8) {
    const Vec8 a8 = load8(a, &vertex_[r]), w8 = load8(w, &vertex_[r]);
    const F8 as[3] = {a8.x, a8.y, a8.z}, ws[3] = {w8.x, w8.y, w8.z};
    for (int c = 0; c < 3; ++c) {
      _mm256_storeu_ps(forced[c] + r, as[c]);
      _mm256_storeu_ps(free[c] + r, ws[c]);
      _mm256_storeu_ps(now[c] + r, first_gain * as[c]);
      _mm256_storeu_ps(last[c] + r, zero);
    }
  }
  for (int j = 1; j < stages_; ++j) {
    const Stage& s = stage_[j];
    const F8 of_now = splat(s.now), of_last = splat(s.last), gain = splat(s.gain), slope = splat(s.slope);
    for (std::int32_t r = 0; r < rows; r += 8) {
      F8 pull[3] = {zero, zero, zero};
      for (std::int32_t k = start_[r / 8]; k < start_[r / 8 + 1]; ++k) {
        const F8 value = _mm256_load_ps(diagonal_[k].value);
        const std::ptrdiff_t from = at_[k] - kRoom;
        for (int c = 0; c < 3; ++c) pull[c] = fma(value, _mm256_loadu_ps(now[c] + from), pull[c]);
      }
      for (int c = 0; c < 3; ++c) {
        F8 next = gain * _mm256_loadu_ps(forced[c] + r);
        next = fma(of_last, _mm256_loadu_ps(last[c] + r), next);
        next = fma(of_now, _mm256_loadu_ps(now[c] + r), next);
        _mm256_storeu_ps(last[c] + r, fnma(slope * _mm256_loadu_ps(free[c] + r), pull[c], next));
      }
    }
    std::swap(now, last);
  }
  for (std::int32_t r = 0; r < n; r += 8) {
    const Vec8 v{_mm256_loadu_ps(now[0] + r), _mm256_loadu_ps(now[1] + r), _mm256_loadu_ps(now[2] + r)};
    store8(out_.data(), &vertex_[r], v);
  }
  return out_.data();
}

}  // namespace weft::cloth
