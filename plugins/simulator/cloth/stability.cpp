#include "stability.hpp"

#include <algorithm>
#include <cmath>

namespace weft::cloth {
namespace {

constexpr int kIterations = 60;
constexpr double kMargin = 1.05;

/// A fixed rough start vector: no mode is missing from it, and it is the same everywhere.
double start_value(std::size_t i) {
  std::uint64_t z = (i + 1) * 0x9e3779b97f4a7c15ull;
  z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ull;
  z = (z ^ (z >> 27)) * 0x94d049bb133111ebull;
  return static_cast<double>(z >> 11) * 0x1.0p-52 - 1.0;
}

}  // namespace

Spectrum largest_frequencies(const Elements& elements, const std::vector<double>& masses) {
  const std::size_t n = masses.size();
  Spectrum result;
  {
    std::vector<std::array<double, 2>> u(n), k(n);
    for (std::size_t i = 0; i < n; ++i) u[i] = {start_value(2 * i), start_value(2 * i + 1)};
    for (int iteration = 0; iteration < kIterations; ++iteration) {
      double norm = 0.0;
      for (std::size_t i = 0; i < n; ++i) norm += masses[i] * (u[i][0] * u[i][0] + u[i][1] * u[i][1]);
      norm = std::sqrt(norm);
      for (auto& value : u) value = {value[0] / norm, value[1] / norm};
      elements.membrane_stiffness(u, k);
      double quotient = 0.0;
      for (std::size_t i = 0; i < n; ++i) {
        quotient += u[i][0] * k[i][0] + u[i][1] * k[i][1];
        u[i] = {k[i][0] / masses[i], k[i][1] / masses[i]};
      }
      result.membrane = quotient;
    }
  }
  {
    std::vector<double> w(n), k(n);
    for (std::size_t i = 0; i < n; ++i) w[i] = start_value(i);
    for (int iteration = 0; iteration < kIterations; ++iteration) {
      double norm = 0.0;
      for (std::size_t i = 0; i < n; ++i) norm += masses[i] * w[i] * w[i];
      norm = std::sqrt(norm);
      if (norm <= 0.0) break;
      for (double& value : w) value /= norm;
      elements.bending_stiffness(w, k);
      double quotient = 0.0;
      for (std::size_t i = 0; i < n; ++i) {
        quotient += w[i] * k[i];
        w[i] = k[i] / masses[i];
      }
      result.bending = quotient;
    }
  }
  result.membrane *= kMargin;
  result.bending *= kMargin;
  return result;
}

double damping_part(const Spectrum& spectrum, double stretch_damping_s, double bend_damping_s, double safety,
                    double least_step) {
  const double b = 0.5 * (spectrum.membrane * stretch_damping_s + spectrum.bending * bend_damping_s);
  if (b <= 0.0 || least_step <= 0.0) return 1.0;
  const double c = safety * safety, step = least_step * stable_step(spectrum, 0.0, 0.0, safety);
  return std::min(1.0, c * (1.0 - least_step * least_step) / (step * b));
}

double stable_step(const Spectrum& spectrum, double stretch_damping_s, double bend_damping_s, double safety) {
  const double a = 0.25 * (spectrum.membrane + spectrum.bending);
  const double b = 0.5 * (spectrum.membrane * stretch_damping_s + spectrum.bending * bend_damping_s);
  const double c = safety * safety;
  if (a <= 0.0) return 1.0;
  return 2.0 * c / (b + std::sqrt(b * b + 4.0 * a * c));
}

}  // namespace weft::cloth
