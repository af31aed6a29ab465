#include "elements.hpp"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>

namespace weft::cloth {
MembraneModuli membrane_moduli(const Fabric& fabric) {
  const double warp = fabric.stretch_warp_n_per_m, weft = fabric.stretch_weft_n_per_m;
  const double nu12 = fabric.poisson, nu21 = nu12 * weft / warp;
  const double det = 1.0 - nu12 * nu21;
  return {warp / det, nu12 * weft / det, weft / det, fabric.stretch_shear_n_per_m};
}

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

BendingModuli bending_moduli(double warp, double weft, double bias) {
  const double twist = 4.0 * bias - warp - weft;
  // d33 at least a twentieth of the mean keeps saddle shapes from being free.
  const double d33 = std::max(twist, 0.05 * (warp + weft));
  const double limit = 0.95 * std::sqrt(warp * weft);
  return {warp, weft, std::clamp(0.5 * (twist - d33), -limit, limit), d33};
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

Elements::Elements(const Topology& topology, const Fabric& fabric) : topology_(&topology), fabric_(fabric) {
  const auto face_total = static_cast<std::int32_t>(topology.faces.size());
  // A difference of two vertices of a patch must fit in +-2^31 units, stretched up to threefold.
  unit_ = std::ldexp(1.0, -30);
  while (12.0 * topology.max_edge > std::ldexp(unit_, 31)) unit_ *= 4.0;

  gradient_.resize(face_total);
  patches_.resize(face_total);
  factors_.resize(face_total);
  blocks_.assign((face_total + 7) / 8, ElementBlock{});
  for (std::int32_t f = 0; f < face_total; ++f) {
    const auto& face = topology.faces[f];
    const auto& p = topology.rest[face[0]];
    const auto& q = topology.rest[face[1]];
    const auto& r = topology.rest[face[2]];
    const double u1 = q[0] - p[0], v1 = q[1] - p[1], u2 = r[0] - p[0], v2 = r[1] - p[1];
    const double det = u1 * v2 - v1 * u2;
    gradient_[f] = {v2 / det, -v1 / det, -u2 / det, u1 / det};
    patches_[f] = make_patch(f);
    ElementBlock& block = blocks_[f / 8];
    const int lane = f % 8;
    for (int k = 0; k < 6; ++k) block.node[k][lane] = offset_of(patches_[f].node[k]);
    for (int k = 0; k < 4; ++k) block.gradient[k][lane] = static_cast<float>(gradient_[f][k] * unit_);
  }

  if (fabric_.tables) {
    for (const auto& row : fabric_.tables->stretching) {
      const double m = fabric_.stretch_multiplier;
      stiffest_membrane_.c11 = std::max(stiffest_membrane_.c11, 2.0 * m * row[0]);
      stiffest_membrane_.c12 = std::max(stiffest_membrane_.c12, 2.0 * m * row[1]);
      stiffest_membrane_.c22 = std::max(stiffest_membrane_.c22, 2.0 * m * row[2]);
      stiffest_membrane_.g = std::max(stiffest_membrane_.g, m * row[3]);
    }
    BendingModuli stiffest;  // the stiffest column, for the step size; update_moduli() replaces it before use
    for (int column = 0; column < 5; ++column) {
      const BendingModuli m = bending_moduli(*fabric_.tables, fabric_.bend_multiplier, 10.0 * column);
      stiffest = {std::max(stiffest.d11, m.d11), std::max(stiffest.d22, m.d22), 0.0, std::max(stiffest.d33, m.d33)};
    }
    for (std::int32_t f = 0; f < face_total; ++f) {
      set_membrane(f, stiffest_membrane_);
      set_bending(f, stiffest);
    }
  } else {
    stiffest_membrane_ = membrane_moduli(fabric_);
    const BendingModuli bending = bending_moduli(fabric_.bend_warp_n_m, fabric_.bend_weft_n_m, fabric_.bend_bias_n_m);
    for (std::int32_t f = 0; f < face_total; ++f) {
      set_membrane(f, stiffest_membrane_);
      set_bending(f, bending);
    }
  }
}

Elements::Patch Elements::make_patch(std::int32_t f) const {
  const auto& face = topology_->faces[f];
  Patch patch;
  for (int k = 0; k < 3; ++k) {
    const std::int32_t across = topology_->opposite[f][k];
    patch.ghost[k] = across < 0;
    patch.node[k] = face[k];
    patch.node[3 + k] = patch.ghost[k] ? face[0] : across;
  }
  patch.second = second_derivatives(points_of(f, patch), topology_->area[f]);
  return patch;
}

PatchPoints Elements::points_of(std::int32_t f, const Patch& patch) const {
  const auto& face = topology_->faces[f];
  PatchPoints point;
  for (int k = 0; k < 3; ++k) point[k] = {topology_->rest[face[k]][0], topology_->rest[face[k]][1]};
  for (int k = 0; k < 3; ++k) {
    for (int axis = 0; axis < 2; ++axis) {
      // A ghost stands where the parallelogram would put it; condensation makes the result independent of the place.
      point[3 + k][axis] = patch.ghost[k] ? point[(k + 1) % 3][axis] + point[(k + 2) % 3][axis] - point[k][axis]
                                          : topology_->rest[patch.node[3 + k]][axis];
    }
  }
  return point;
}

void Elements::set_membrane(std::int32_t f, const MembraneModuli& m) {
  ElementBlock& block = blocks_[f / 8];
  const double scale = topology_->area[f] / unit_;
  const double values[4] = {m.c11, m.c12, m.c22, m.g};
  for (int k = 0; k < 4; ++k) block.stiffness[k][f % 8] = static_cast<float>(scale * values[k]);
}

void Elements::set_bending(std::int32_t f, const BendingModuli& m) {
  const Patch& patch = patches_[f];
  factors_[f] = bending_factors(points_of(f, patch), topology_->area[f], patch.second, patch.ghost, m);
  const double root_unit = std::sqrt(unit_);
  for (int row = 0; row < 3; ++row)
    for (int k = 1; k < 6; ++k)
      blocks_[f / 8].bend[row][k - 1][f % 8] = static_cast<float>(factors_[f][row][k] * root_unit);
}

/// One long function, because all parts of a block's computation share values that stay in registers.
template <bool kDampStretch, bool kDampBend>
float Elements::add_forces_impl(const Fixed4* x, const Float4* v, Float4* forces) const {
  const F8 half = splat(0.5f), one = splat(1.0f);
  const F8 per_unit = splat(static_cast<float>(1.0 / unit_));
  const F8 damp_stretch = splat(static_cast<float>(fabric_.damping_stretch_s)) * per_unit;
  const F8 damp_bend = splat(static_cast<float>(fabric_.damping_bend_s)) * per_unit;
  constexpr int kRates = kDampBend ? 5 : kDampStretch ? 2 : 0;
  F8 largest = one;
  for (const ElementBlock& block : blocks_) {
    const auto row = [](const float(&values)[8]) { return _mm256_load_ps(values); };
    const Fixed8 origin = load8(x, block.node[0]);
    [[maybe_unused]] const Vec8 origin_rate = load8(v, block.node[0]);
    Vec8 d[5];
    [[maybe_unused]] Vec8 rate[5];
    for (int k = 0; k < 5; ++k) {
      d[k] = difference(load8(x, block.node[k + 1]), origin);
      if (k < kRates) rate[k] = load8(v, block.node[k + 1]) - origin_rate;
    }

    // Membrane. F = [x_u x_v]; P = F S; force on corner i = -P grad N_i.
    const F8 g0 = row(block.gradient[0]), g1 = row(block.gradient[1]);
    const F8 g2 = row(block.gradient[2]), g3 = row(block.gradient[3]);
    const Vec8 fu = fma(g1, d[1], g0 * d[0]), fv = fma(g3, d[1], g2 * d[0]);
    [[maybe_unused]] Vec8 n;  // unit normal; early, since root and division take long
    if constexpr (kDampBend) {
      n = cross(fu, fv);
      n = (one / _mm256_sqrt_ps(max8(dot(n, n), splat(1e-12f)))) * n;
    }
    const F8 uu = dot(fu, fu), vv = dot(fv, fv);
    F8 e11 = half * (uu - one), e22 = half * (vv - one), shear = dot(fu, fv);
    {
      // Larger eigenvalue of F^T F.
      const F8 mean = half * (uu + vv), apart = half * (uu - vv);
      largest = max8(largest, mean + _mm256_sqrt_ps(fma(apart, apart, shear * shear)));
    }
    if constexpr (kDampStretch) {
      const F8 s = damp_stretch;
      const Vec8 ru = fma(g1, rate[1], g0 * rate[0]), rv = fma(g3, rate[1], g2 * rate[0]);
      e11 = fma(s, dot(fu, ru), e11);
      e22 = fma(s, dot(fv, rv), e22);
      shear = fma(s, dot(fu, rv) + dot(fv, ru), shear);
    }
    const F8 c12 = row(block.stiffness[1]);
    const F8 s11 = fma(row(block.stiffness[0]), e11, c12 * e22);
    const F8 s22 = fma(row(block.stiffness[2]), e22, c12 * e11);
    const F8 s12 = row(block.stiffness[3]) * shear;
    const Vec8 pu = fma(s12, fv, s11 * fu), pv = fma(s22, fv, s12 * fu);
    Vec8 out[6];
    out[1] = fma(g2, pv, g0 * pu);
    out[2] = fma(g3, pv, g1 * pu);

    // Bending: y_k = sum_j w_kj (x_j - x_0), force on node j = -sum_k w_kj y_k. Weights carry sqrt(unit) each way.
    Vec8 y[3];
    for (int k = 0; k < 3; ++k) {
      y[k] = row(block.bend[k][0]) * d[0];
      for (int j = 1; j < 5; ++j) y[k] = fma(row(block.bend[k][j]), d[j], y[k]);
    }
    if constexpr (kDampBend) {
      // Only along the normal, where curvature lies. A rigid rotation changes y across the normal and is not damped.
      F8 along[5];
      for (int k = 0; k < 5; ++k) along[k] = dot(rate[k], n);
      for (int k = 0; k < 3; ++k) {
        F8 bending = row(block.bend[k][0]) * along[0];
        for (int j = 1; j < 5; ++j) bending = fma(row(block.bend[k][j]), along[j], bending);
        y[k] = fma(damp_bend * bending, n, y[k]);
      }
    }
    for (int j = 1; j < 6; ++j) {
      if (j < 3)
        out[j] = fma(row(block.bend[0][j - 1]), y[0], out[j]);
      else
        out[j] = row(block.bend[0][j - 1]) * y[0];
      for (int k = 1; k < 3; ++k) out[j] = fma(row(block.bend[k][j - 1]), y[k], out[j]);
    }
    out[0] = ((out[1] + out[2]) + (out[3] + out[4])) + out[5];
    add8(forces, block.node[0], out[0]);
    for (int j = 1; j < 6; ++j) subtract8(forces, block.node[j], out[j]);
  }
  alignas(32) float lanes[8];
  _mm256_store_ps(lanes, largest);
  return *std::max_element(lanes, lanes + 8);
}

float Elements::add_forces(const Fixed4* x, const Float4* v, Float4* forces) const {
  const bool stretch = fabric_.damping_stretch_s > 0.0, bend = fabric_.damping_bend_s > 0.0;
  if (stretch) return bend ? add_forces_impl<true, true>(x, v, forces) : add_forces_impl<true, false>(x, v, forces);
  return bend ? add_forces_impl<false, true>(x, v, forces) : add_forces_impl<false, false>(x, v, forces);
}

std::array<double, 3> Elements::strain(const Double4* x, std::int32_t f) const {
  const auto& face = topology_->faces[f];
  const auto& g = gradient_[f];
  const auto at = [&](std::int32_t i) { return Eigen::Vector3d(x[i].x, x[i].y, x[i].z); };
  const Eigen::Vector3d d1 = at(face[1]) - at(face[0]), d2 = at(face[2]) - at(face[0]);
  const Eigen::Vector3d fu = g[0] * d1 + g[1] * d2, fv = g[2] * d1 + g[3] * d2;
  return {0.5 * (fu.squaredNorm() - 1.0), 0.5 * (fv.squaredNorm() - 1.0), 0.5 * fu.dot(fv)};
}

double Elements::principal_strain(const Double4* x, std::int32_t f) const {
  const auto e = strain(x, f);
  const double mean = 0.5 * (e[0] + e[1]), radius = std::hypot(0.5 * (e[0] - e[1]), e[2]);
  const auto stretch = [](double green) { return std::abs(std::sqrt(std::max(0.0, 1.0 + 2.0 * green)) - 1.0); };
  return std::max(stretch(mean + radius), stretch(mean - radius));
}

void Elements::update_moduli(const Double4* x) {
  for (std::int32_t f = 0; f < face_count(); ++f) {
    const auto e = strain(x, f);
    set_membrane(f, membrane_moduli(*fabric_.tables, fabric_.stretch_multiplier, e[0], e[1], e[2]));
    const Patch& patch = patches_[f];
    double square = 0.0;
    constexpr double kWeight[3] = {1.0, 1.0, 2.0};
    for (int row = 0; row < 3; ++row) {
      Eigen::Vector3d second = Eigen::Vector3d::Zero();
      for (int k = 0; k < 6; ++k) {
        if (k >= 3 && patch.ghost[k - 3]) continue;
        const Double4 &p = x[patch.node[k]], &o = x[patch.node[0]];
        second += patch.second[row][k] * Eigen::Vector3d(p.x - o.x, p.y - o.y, p.z - o.z);
      }
      square += kWeight[row] * second.squaredNorm();
    }
    const bool boundary = patch.ghost[0] || patch.ghost[1] || patch.ghost[2];
    // At a free edge the unconstrained second derivatives are unknown: the table's first column.
    set_bending(f, bending_moduli(*fabric_.tables, fabric_.bend_multiplier, boundary ? 0.0 : std::sqrt(square)));
  }
}

void Elements::membrane_stiffness(const std::vector<std::array<double, 2>>& u,
                                  std::vector<std::array<double, 2>>& out) const {
  std::fill(out.begin(), out.end(), std::array<double, 2>{0.0, 0.0});
  const MembraneModuli& m = stiffest_membrane_;
  for (std::int32_t f = 0; f < face_count(); ++f) {
    const auto& face = topology_->faces[f];
    const auto& g = gradient_[f];
    const double du1 = u[face[1]][0] - u[face[0]][0], du2 = u[face[2]][0] - u[face[0]][0];
    const double dv1 = u[face[1]][1] - u[face[0]][1], dv2 = u[face[2]][1] - u[face[0]][1];
    const double e11 = g[0] * du1 + g[1] * du2, e22 = g[2] * dv1 + g[3] * dv2;
    const double shear = g[2] * du1 + g[3] * du2 + g[0] * dv1 + g[1] * dv2;
    const double a = topology_->area[f];
    const double s11 = a * (m.c11 * e11 + m.c12 * e22), s22 = a * (m.c12 * e11 + m.c22 * e22), s12 = a * m.g * shear;
    const double f1[2] = {g[0] * s11 + g[2] * s12, g[2] * s22 + g[0] * s12};
    const double f2[2] = {g[1] * s11 + g[3] * s12, g[3] * s22 + g[1] * s12};
    for (int k = 0; k < 2; ++k) {
      out[face[1]][k] += f1[k];
      out[face[2]][k] += f2[k];
      out[face[0]][k] -= f1[k] + f2[k];
    }
  }
}

void Elements::bending_stiffness(const std::vector<double>& w, std::vector<double>& out) const {
  std::fill(out.begin(), out.end(), 0.0);
  for (std::int32_t f = 0; f < face_count(); ++f) {
    const auto& node = patches_[f].node;
    for (int row = 0; row < 3; ++row) {
      double y = 0.0;
      for (int k = 0; k < 6; ++k) y += factors_[f][row][k] * w[node[k]];
      for (int k = 0; k < 6; ++k) out[node[k]] += factors_[f][row][k] * y;
    }
  }
}

}  // namespace weft::cloth
