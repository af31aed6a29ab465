#include "stability.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

namespace weft::cloth {
namespace {

constexpr int kIterations = 60;
constexpr double kMargin = 1.05;

/// A fixed rough start vector that contains every mode.
double start_value(std::size_t i) {
  std::uint64_t z = (i + 1) * 0x9e3779b97f4a7c15ull;
  z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ull;
  z = (z ^ (z >> 27)) * 0x94d049bb133111ebull;
  return static_cast<double>(z >> 11) * 0x1.0p-52 - 1.0;
}

// The coupling in stable_step(). Cloth that is folded sharply on coarse edges reaches 0.26.
constexpr double kShared = 0.3;

/// Of the explicit limit: dt^2 stiffness + dt damping.
struct Demand {
  double stiffness, damping;
};
/// Of motion along the cloth and across it, each with its part of the other.
std::pair<Demand, Demand> demands(const Spectrum& s, double stretch_damping_s, double bend_damping_s) {
  const Demand along{0.25 * (s.membrane + s.bending), 0.5 * s.membrane * stretch_damping_s};
  const Demand across{0.25 * s.bending, 0.5 * s.bending * bend_damping_s};
  const auto coupled = [](const Demand& one, const Demand& other) {
    return Demand{one.stiffness + kShared * other.stiffness, one.damping + kShared * other.damping};
  };
  return {coupled(along, across), coupled(across, along)};
}

/// The largest eigenvalue of the membrane, 1/s^2, in N coordinates: the plane of a chart, or space.
template <std::size_t N>
double membrane_frequency(const Elements& elements, const std::vector<double>& masses) {
  const std::size_t n = masses.size();
  std::vector<std::array<double, N>> u(n), k(n);
  for (std::size_t i = 0; i < n; ++i)
    for (std::size_t c = 0; c < N; ++c) u[i][c] = start_value(N * i + c);
  double membrane = 0.0;
  for (int iteration = 0; iteration < kIterations; ++iteration) {
    double norm = 0.0;
    for (std::size_t i = 0; i < n; ++i) {
      double square = u[i][0] * u[i][0];
      for (std::size_t c = 1; c < N; ++c) square += u[i][c] * u[i][c];
      norm += masses[i] * square;
    }
    norm = std::sqrt(norm);
    for (auto& value : u)
      for (double& one : value) one /= norm;
    elements.membrane_stiffness(u, k);
    double quotient = 0.0;
    for (std::size_t i = 0; i < n; ++i) {
      double energy = u[i][0] * k[i][0];
      for (std::size_t c = 1; c < N; ++c) energy += u[i][c] * k[i][c];
      quotient += energy;
      for (std::size_t c = 0; c < N; ++c) u[i][c] = k[i][c] / masses[i];
    }
    membrane = kMargin * quotient;
  }
  return membrane;
}

}  // namespace

double power_iteration(std::size_t n, const std::function<double(std::vector<double>&)>& multiply) {
  std::vector<double> x(n);
  for (std::size_t i = 0; i < n; ++i) x[i] = start_value(i);
  double quotient = 0.0;
  for (int iteration = 0; iteration < kIterations; ++iteration) quotient = multiply(x);
  return kMargin * quotient;
}

double largest_eigenvalue(const std::vector<double>& masses,
                          const std::function<void(const std::vector<double>&, std::vector<double>&)>& stiffness) {
  const std::size_t n = masses.size();
  std::vector<double> k(n);
  return power_iteration(n, [&](std::vector<double>& w) {
    double norm = 0.0, energy = 0.0;
    for (std::size_t i = 0; i < n; ++i) norm += masses[i] * w[i] * w[i];
    norm = std::sqrt(norm);
    if (norm <= 0.0) return 0.0;
    for (double& value : w) value /= norm;
    stiffness(w, k);
    for (std::size_t i = 0; i < n; ++i) {
      energy += w[i] * k[i];
      w[i] = k[i] / masses[i];
    }
    return energy;
  });
}

Spectrum largest_frequencies(const Elements& elements, const std::vector<double>& masses, const MassScaling& scaling) {
  Spectrum result;
  const auto bending = [&](const std::vector<double>& w, std::vector<double>& out) {
    elements.bending_stiffness(w, out);
  };
  if (scaling.stages() > 1) return {scaling.largest(), scaling.largest(bending)};
  result.bending = largest_eigenvalue(masses, bending);
  result.membrane =
      elements.has_frames() ? membrane_frequency<3>(elements, masses) : membrane_frequency<2>(elements, masses);
  return result;
}

double damping_part(const Spectrum& spectrum, double stretch_damping_s, double bend_damping_s, double safety,
                    double least_step) {
  if (least_step <= 0.0) return 1.0;
  const double step = least_step * stable_step(spectrum, 0.0, 0.0, safety);
  const auto [along, across] = demands(spectrum, stretch_damping_s, bend_damping_s);
  const auto part = [&](const Demand& demand) {
    const double wanted = step * demand.damping;
    const double left = safety * safety - step * step * demand.stiffness;
    return wanted > 0.0 ? left / wanted : 1.0;
  };
  return std::clamp(std::min(part(along), part(across)), 0.0, 1.0);
}

double limit_taken(const Spectrum& spectrum, double stretch_damping_s, double bend_damping_s, double step) {
  const auto [along, across] = demands(spectrum, stretch_damping_s, bend_damping_s);
  const auto taken = [&](const Demand& demand) { return step * step * demand.stiffness + step * demand.damping; };
  return 4.0 * std::max(taken(along), taken(across));
}

double stable_step(const Spectrum& spectrum, double stretch_damping_s, double bend_damping_s, double safety) {
  const double c = safety * safety;
  const auto [along, across] = demands(spectrum, stretch_damping_s, bend_damping_s);
  const auto longest = [&](const Demand& demand) {
    const double a = demand.stiffness, b = demand.damping;
    return a > 0.0 ? 2.0 * c / (b + std::sqrt(b * b + 4.0 * a * c)) : 1.0;
  };
  return std::min(longest(along), longest(across));
}

}  // namespace weft::cloth
