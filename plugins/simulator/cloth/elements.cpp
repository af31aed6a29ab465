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

BendingModuli bending_moduli(double warp, double weft, double bias) {
  const double twist = 4.0 * bias - warp - weft;
  // d33 at least a twentieth of the mean keeps saddle shapes from being free.
  const double d33 = std::max(twist, 0.05 * (warp + weft));
  const double limit = 0.95 * std::sqrt(warp * weft);
  return {warp, weft, std::clamp(0.5 * (twist - d33), -limit, limit), d33};
}

Elements::Elements(const Topology& topology, const Fabric& fabric) : topology_(&topology), fabric_(fabric) {
  const auto face_total = static_cast<std::int32_t>(topology.faces.size());
  // A difference of two vertices of a patch must fit in +-2^31 units, stretched up to threefold.
  unit_ = std::ldexp(1.0, -30);
  while (12.0 * topology.max_edge > std::ldexp(unit_, 31)) unit_ *= 4.0;

  gradient_.resize(face_total);
  patches_.resize(face_total);
  factors_.resize(face_total);
  blocks_.assign((face_total + kElementLanes - 1) / kElementLanes, ElementBlock{});
  for (std::int32_t f = 0; f < face_total; ++f) {
    const auto &p = topology.corner[f][0], &q = topology.corner[f][1], &r = topology.corner[f][2];
    const double u1 = q[0] - p[0], v1 = q[1] - p[1], u2 = r[0] - p[0], v2 = r[1] - p[1];
    const double det = u1 * v2 - v1 * u2;
    gradient_[f] = {v2 / det, -v1 / det, -u2 / det, u1 / det};
    patches_[f] = make_patch(f);
    ElementBlock& block = blocks_[f / kElementLanes];
    const int lane = f % kElementLanes;
    for (int k = 0; k < 6; ++k) block.node[k][lane] = offset_of(patches_[f].node[k]);
    for (int k = 0; k < 4; ++k) block.gradient[k][lane] = static_cast<float>(gradient_[f][k] * unit_);
  }

  BendingModuli bending = bending_moduli(fabric_.bend_warp_n_m, fabric_.bend_weft_n_m, fabric_.bend_bias_n_m);
  stiffest_membrane_ = membrane_moduli(fabric_);
  if (fabric_.tables) take_stiffest(bending);
  set_all(stiffest_membrane_, bending);
}

void Elements::set_all(const MembraneModuli& membrane, const BendingModuli& bending) {
  for (std::int32_t f = 0; f < face_count(); ++f) {
    set_membrane(f, membrane);
    set_bending(f, bending);
  }
  reference_membrane_ = membrane;
  reference_bending_ = bending;
  free_edges_set_ = false;
}

Elements::Patch Elements::make_patch(std::int32_t f) const {
  const auto& face = topology_->faces[f];
  Patch patch;
  for (int k = 0; k < 3; ++k) {
    const std::int32_t across = topology_->opposite[f][k];
    patch.ghost[k] = topology_->free_edge[f][k];
    patch.node[k] = face[k];
    patch.node[3 + k] = patch.ghost[k] ? face[0] : across;
  }
  patch.second = second_derivatives(points_of(f, patch), topology_->area[f]);
  return patch;
}

PatchPoints Elements::points_of(std::int32_t f, const Patch& patch) const {
  PatchPoints point;
  for (int k = 0; k < 3; ++k) point[k] = topology_->corner[f][k];
  for (int k = 0; k < 3; ++k) {
    for (int axis = 0; axis < 2; ++axis) {
      // A ghost stands where the parallelogram would put it; condensation makes the result independent of the place.
      point[3 + k][axis] = patch.ghost[k] ? point[(k + 1) % 3][axis] + point[(k + 2) % 3][axis] - point[k][axis]
                                          : topology_->beyond[f][k][axis];
    }
  }
  return point;
}

void Elements::set_membrane(std::int32_t f, const MembraneModuli& m) {
  ElementBlock& block = blocks_[f / kElementLanes];
  const double scale = topology_->area[f] / unit_;
  const double values[4] = {m.c11, m.c12, m.c22, m.g};
  for (int k = 0; k < 4; ++k) block.stiffness[k][f % kElementLanes] = static_cast<float>(scale * values[k]);
}

void Elements::set_bending(std::int32_t f, const BendingModuli& m) {
  const Patch& patch = patches_[f];
  factors_[f] = bending_factors(points_of(f, patch), topology_->area[f], patch.second, patch.ghost, m);
  const double root_unit = std::sqrt(unit_);
  for (int row = 0; row < 3; ++row)
    for (int k = 1; k < 6; ++k)
      blocks_[f / kElementLanes].bend[row][k - 1][f % kElementLanes] =
          static_cast<float>(factors_[f][row][k] * root_unit);
}

float Elements::add_forces(const Fixed4* x, const Float4* v, Float4* forces, bool wide) const {
  const ForceArguments arguments{blocks_, unit_, fabric_.damping_stretch_s, fabric_.damping_bend_s, x, v, forces};
  return wide ? add_forces_wide(arguments) : add_forces_narrow(arguments);
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

void Elements::membrane_stiffness(const std::vector<std::array<double, 2>>& u,
                                  std::vector<std::array<double, 2>>& out) const {
  std::fill(out.begin(), out.end(), std::array<double, 2>{0.0, 0.0});
  const MembraneModuli& m = reference_membrane_;
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

void Elements::membrane_stiffness(const std::vector<std::array<double, 3>>& u,
                                  std::vector<std::array<double, 3>>& out) const {
  std::fill(out.begin(), out.end(), std::array<double, 3>{});
  const MembraneModuli& m = reference_membrane_;
  using Vec = Eigen::Vector3d;
  const auto at = [](const std::array<double, 3>& value) { return Vec(value[0], value[1], value[2]); };
  for (std::int32_t f = 0; f < face_count(); ++f) {
    const auto& face = topology_->faces[f];
    const auto& g = gradient_[f];
    const Vec p = at(topology_->place[face[0]]);
    const Vec d1 = at(topology_->place[face[1]]) - p, d2 = at(topology_->place[face[2]]) - p;
    // The yarns as drawn: unit vectors, square to each other.
    const Vec warp = (g[0] * d1 + g[1] * d2).normalized(), across = g[2] * d1 + g[3] * d2;
    const Vec weft = (across - across.dot(warp) * warp).normalized();
    const Vec du1 = at(u[face[1]]) - at(u[face[0]]), du2 = at(u[face[2]]) - at(u[face[0]]);
    const Vec along_warp = g[0] * du1 + g[1] * du2, along_weft = g[2] * du1 + g[3] * du2;
    const double e11 = warp.dot(along_warp), e22 = weft.dot(along_weft);
    const double shear = warp.dot(along_weft) + weft.dot(along_warp), a = topology_->area[f];
    const double s11 = a * (m.c11 * e11 + m.c12 * e22), s22 = a * (m.c12 * e11 + m.c22 * e22), s12 = a * m.g * shear;
    const Vec f1 = g[0] * (s11 * warp + s12 * weft) + g[2] * (s22 * weft + s12 * warp);
    const Vec f2 = g[1] * (s11 * warp + s12 * weft) + g[3] * (s22 * weft + s12 * warp);
    for (int k = 0; k < 3; ++k) {
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
