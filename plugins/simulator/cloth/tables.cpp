// The moduli of a fabric with tables, from strain and curvature.
#include <Eigen/Core>
#include <algorithm>
#include <cmath>

#include "elements.hpp"

namespace weft::cloth {
namespace {

/// Largest r with det(A - r B) = 0 for symmetric A = [a11 a12; a12 a22] and positive definite B.
double largest_ratio(double a11, double a12, double a22, double b11, double b12, double b22) {
  // Of L^-1 A L^-T, B = L L^T.
  const double t = b12 / b11, rest = b22 - t * b12;
  const double one = a11 / b11, two = (a22 - t * (2.0 * a12 - t * a11)) / rest;
  const double apart = 0.5 * (one - two), both = a12 - t * a11;
  return 0.5 * (one + two) + std::sqrt(apart * apart + both * both / (b11 * rest));
}
double growth(const MembraneModuli& now, const MembraneModuli& reference) {
  return std::max(largest_ratio(now.c11, now.c12, now.c22, reference.c11, reference.c12, reference.c22),
                  now.g / reference.g);
}
double growth(const BendingModuli& now, const BendingModuli& reference) {
  return std::max(largest_ratio(now.d11, now.d12, now.d22, reference.d11, reference.d12, reference.d22),
                  now.d33 / reference.d33);
}
bool definite(const MembraneModuli& m) { return m.c11 > 0.0 && m.c11 * m.c22 > 1.001 * m.c12 * m.c12 && m.g > 0.0; }
bool definite(const BendingModuli& m) { return m.d11 > 0.0 && m.d11 * m.d22 > 1.001 * m.d12 * m.d12 && m.d33 > 0.0; }

}  // namespace

MembraneModuli membrane_moduli(const MaterialTables& tables, double multiplier, double e11, double e22, double e12) {
  // Principal direction of E, and its principal stretch minus one.
  const double mean = 0.5 * (e11 + e22), half = 0.5 * (e11 - e22), radius = std::hypot(half, e12);
  const double angle = radius > 0.0 ? 0.5 * std::abs(std::atan2(e12, half)) : 0.0;  // [0, pi/2] by symmetry
  const double stretch = std::sqrt(std::max(0.0, 1.0 + 2.0 * (mean + radius))) - 1.0;
  const double t = std::clamp(stretch * 6.0, 0.0, 1.0);
  const double column = std::clamp(angle / (M_PI / 8.0), 0.0, 4.0);
  const int i = std::min(3, static_cast<int>(column));
  const double s = column - i;
  double c[4];
  for (int k = 0; k < 4; ++k) {
    const auto at = [&](int row) { return std::max(0.0, tables.stretching[row][k]); };
    c[k] = multiplier * ((1.0 - t) * at(0) + t * ((1.0 - s) * at(1 + i) + s * at(2 + i)));
  }
  return {2.0 * c[0], 2.0 * c[1], 2.0 * c[2], c[3]};
}

BendingModuli bending_moduli(const MaterialTables& tables, double multiplier, double curvature) {
  const double column = std::clamp(curvature / 10.0, 0.0, 4.0);
  const int i = std::min(3, static_cast<int>(column));
  const double s = column - i;
  const auto at = [&](int row) {
    return 0.25 * multiplier * std::max(0.0, (1.0 - s) * tables.bending[row][i] + s * tables.bending[row][i + 1]);
  };
  return bending_moduli(at(2), at(0), at(1));
}

/// Bounds of the moduli over all strains and curvatures. update_moduli() replaces them before they act.
void Elements::take_stiffest(BendingModuli& bending) {
  stiffest_membrane_ = {};
  for (const auto& row : fabric_.tables->stretching) {
    const double m = fabric_.stretch_multiplier;
    stiffest_membrane_.c11 = std::max(stiffest_membrane_.c11, 2.0 * m * row[0]);
    stiffest_membrane_.c12 = std::max(stiffest_membrane_.c12, 2.0 * m * row[1]);
    stiffest_membrane_.c22 = std::max(stiffest_membrane_.c22, 2.0 * m * row[2]);
    stiffest_membrane_.g = std::max(stiffest_membrane_.g, m * row[3]);
  }
  bending = {};
  for (int column = 0; column < 5; ++column) {
    const BendingModuli m = bending_moduli(*fabric_.tables, fabric_.bend_multiplier, 10.0 * column);
    bending = {std::max(bending.d11, m.d11), std::max(bending.d22, m.d22), 0.0, std::max(bending.d33, m.d33)};
  }
}

void Elements::refer_to_rest() {
  const MembraneModuli membrane = membrane_moduli(*fabric_.tables, fabric_.stretch_multiplier, 0.0, 0.0, 0.0);
  const BendingModuli bending = bending_moduli(*fabric_.tables, fabric_.bend_multiplier, 0.0);
  if (definite(membrane) && definite(bending)) set_all(membrane, bending);
}

Elements::Growth Elements::update_moduli(const Double4* x) {
  const bool compare = definite(reference_membrane_) && definite(reference_bending_);
  Growth largest;
  for (std::int32_t f = 0; f < face_count(); ++f) {
    const auto e = strain(x, f);
    const MembraneModuli membrane = membrane_moduli(*fabric_.tables, fabric_.stretch_multiplier, e[0], e[1], e[2]);
    set_membrane(f, membrane);
    if (compare) largest.membrane = std::max(largest.membrane, growth(membrane, reference_membrane_));
    const Patch& patch = patches_[f];
    // At a free edge the unconstrained second derivatives are unknown: the table's first column.
    if (patch.ghost[0] || patch.ghost[1] || patch.ghost[2]) {
      if (!free_edges_set_) set_bending(f, bending_moduli(*fabric_.tables, fabric_.bend_multiplier, 0.0));
      continue;
    }
    const BendingModuli bending =
        bending_moduli(*fabric_.tables, fabric_.bend_multiplier, std::sqrt(square_curvature(x, patch)));
    set_bending_inside(f, bending);
    if (compare) largest.bending = std::max(largest.bending, growth(bending, reference_bending_));
  }
  free_edges_set_ = true;
  return largest;
}

double Elements::square_curvature(const Double4* x, const Patch& patch) {
  Eigen::Vector3d d[6];
  const Double4& o = x[patch.node[0]];
  for (int k = 1; k < 6; ++k) {
    const Double4& p = x[patch.node[k]];
    d[k] = {p.x - o.x, p.y - o.y, p.z - o.z};
  }
  constexpr double kWeight[3] = {1.0, 1.0, 2.0};
  double square = 0.0;
  for (int row = 0; row < 3; ++row) {
    Eigen::Vector3d second = patch.second[row][1] * d[1];
    for (int k = 2; k < 6; ++k) second += patch.second[row][k] * d[k];
    square += kWeight[row] * second.squaredNorm();
  }
  return square;
}

/// The energy of set_bending() by Cholesky's factors of the moduli, where no edge is free.
void Elements::set_bending_inside(std::int32_t f, const BendingModuli& m) {
  const PatchRows& second = patches_[f].second;
  const double scale = std::sqrt(topology_->area[f] * unit_), root = std::sqrt(std::max(m.d11, 0.0));
  const double coupled = root > 0.0 ? m.d12 / root : 0.0;
  const double uu = scale * root, uv = scale * coupled,
               vv = scale * std::sqrt(std::max(m.d22 - coupled * coupled, 0.0)),
               twist = scale * std::sqrt(std::max(m.d33, 0.0));
  ElementBlock& block = blocks_[f / kElementLanes];
  const int lane = f % kElementLanes;
  for (int k = 1; k < 6; ++k) {
    block.bend[0][k - 1][lane] = static_cast<float>(uu * second[0][k] + uv * second[1][k]);
    block.bend[1][k - 1][lane] = static_cast<float>(vv * second[1][k]);
    block.bend[2][k - 1][lane] = static_cast<float>(twist * second[2][k]);
  }
}

}  // namespace weft::cloth
