#include "mass_scaling.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include "stability.hpp"

namespace weft::cloth {
namespace {

// Of w0 = 1 + kDamping / s^2: lambda p(lambda) of short waves lies between 0.3 and 1.7 of its mean.
constexpr double kDamping = 0.4;
constexpr int kMostStages = 64;

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
      const auto &p = topology.rest[face[(k + 1) % 3]], &q = topology.rest[face[(k + 2) % 3]];
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
  start_.assign(static_cast<std::size_t>(topology.vertices) + 1, 0);
  for (std::size_t k = 0; k < entries.size(); ++k) {
    if (k > 0 && entries[k].row == entries[k - 1].row && entries[k].column == entries[k - 1].column) {
      value.back() += entries[k].value;
      continue;
    }
    column_.push_back(entries[k].column);
    value.push_back(entries[k].value);
    start_[static_cast<std::size_t>(entries[k].row) + 1] = static_cast<std::int32_t>(column_.size());
  }
  for (std::size_t i = 1; i < start_.size(); ++i) start_[i] = std::max(start_[i], start_[i - 1]);
  value_.assign(value.begin(), value.end());
  now_.resize(masses.size());
  last_.resize(masses.size());

  const double most = largest_eigenvalue(masses, [&](const std::vector<double>& x, std::vector<double>& out) {
    for (std::size_t i = 0; i < x.size(); ++i) {
      out[i] = 0.0;
      for (std::int32_t k = start_[i]; k < start_[i + 1]; ++k) out[i] += value[k] * x[column_[k]];
    }
  });
  const double allowed = std::max(warp, weft) / density / (length * length);
  if (most <= allowed) return;
  Polynomial p;
  do p = polynomial(++stages_, most);
  while (p.largest() > allowed && stages_ < kMostStages);
  // The stages come in whole numbers: what they could do beyond `allowed` is not used.
  if (p.largest() < allowed) p = polynomial(stages_, most * allowed / p.largest());
  largest_ = p.largest();
  for (const auto& [now, last, slope] : p.stage)
    stage_.push_back({static_cast<float>(now), static_cast<float>(last), static_cast<float>(slope / p.tau),
                      static_cast<float>(slope)});
}

const Float4* MassScaling::apply(const Float4* a, const Float4* w) const {
  const auto n = static_cast<std::int32_t>(now_.size());
  Float4 *now = now_.data(), *last = last_.data();
  const __m128 first = _mm_set1_ps(stage_[0].gain);
  for (std::int32_t i = 0; i < n; ++i) {
    _mm_store_ps(&now[i].x, _mm_mul_ps(first, _mm_load_ps(&a[i].x)));
    _mm_store_ps(&last[i].x, _mm_setzero_ps());
  }
  for (int j = 1; j < stages_; ++j) {
    const Stage& s = stage_[static_cast<std::size_t>(j)];
    const __m128 of_now = _mm_set1_ps(s.now), of_last = _mm_set1_ps(s.last);
    const __m128 gain = _mm_set1_ps(s.gain), slope = _mm_set1_ps(s.slope);
    for (std::int32_t i = 0; i < n; ++i) {
      __m128 pull = _mm_setzero_ps();
      for (std::int32_t k = start_[i]; k < start_[i + 1]; ++k)
        pull = _mm_fmadd_ps(_mm_set1_ps(value_[k]), _mm_load_ps(&now[column_[k]].x), pull);
      __m128 next = _mm_mul_ps(gain, _mm_load_ps(&a[i].x));
      next = _mm_fmadd_ps(of_last, _mm_load_ps(&last[i].x), next);
      next = _mm_fmadd_ps(of_now, _mm_load_ps(&now[i].x), next);
      next = _mm_fnmadd_ps(_mm_mul_ps(slope, _mm_load_ps(&w[i].x)), pull, next);
      _mm_store_ps(&last[i].x, next);
    }
    std::swap(now, last);
  }
  return now;
}

}  // namespace weft::cloth
