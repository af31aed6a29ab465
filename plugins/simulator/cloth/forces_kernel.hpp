// The internal forces of a list of blocks, for the lanes of one instruction set. A file that includes this has defined
// Lanes, in its unnamed namespace and below its target pragma if it has one: a function here is compiled for the
// instruction set that is in force where it is included. (A lambda would not be.) The operations, and the order in which forces are added to a
// vertex, do not depend on the number of lanes. So neither do the bits.

namespace weft::cloth {
namespace {

using F = Lanes::F;
struct Vector {
  F x, y, z;
};
inline Vector operator-(const Vector& a, const Vector& b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
inline Vector operator+(const Vector& a, const Vector& b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
inline Vector operator*(F s, const Vector& a) { return {s * a.x, s * a.y, s * a.z}; }
inline Vector fma(F s, const Vector& a, const Vector& b) {
  return {Lanes::fma(s, a.x, b.x), Lanes::fma(s, a.y, b.y), Lanes::fma(s, a.z, b.z)};
}
inline F dot(const Vector& a, const Vector& b) { return Lanes::fma(a.z, b.z, Lanes::fma(a.y, b.y, a.x * b.x)); }
inline Vector cross(const Vector& a, const Vector& b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

/// One long function, because all parts of a block's computation share values that stay in registers.
template <bool kDampStretch, bool kDampBend>
float add_forces(const ForceArguments& arguments) {
  const Fixed4* x = arguments.x;
  const Float4* v = arguments.v;
  const F half = Lanes::splat(0.5f), one = Lanes::splat(1.0f);
  const F per_unit = Lanes::splat(static_cast<float>(1.0 / arguments.unit));
  [[maybe_unused]] const F damp_stretch = Lanes::splat(static_cast<float>(arguments.damping_stretch_s)) * per_unit;
  [[maybe_unused]] const F damp_bend = Lanes::splat(static_cast<float>(arguments.damping_bend_s)) * per_unit;
  constexpr int kRates = kDampBend ? 5 : kDampStretch ? 2 : 0;
  F largest = one;
  for (const ElementBlock& block : arguments.blocks)
    for (int lane = 0; lane < kElementLanes; lane += Lanes::kCount) {
      const Lanes::Records origin = Lanes::load(x, block.node[0] + lane);
      [[maybe_unused]] Vector origin_rate;
      if constexpr (kRates > 0) Lanes::load(v, block.node[0] + lane, origin_rate);
      Vector d[5];
      [[maybe_unused]] Vector rate[5];
#pragma GCC unroll 5
      for (int k = 0; k < 5; ++k) {
        Lanes::difference(Lanes::load(x, block.node[k + 1] + lane), origin, d[k]);
        if (k >= kRates) continue;
        Lanes::load(v, block.node[k + 1] + lane, rate[k]);
        rate[k] = rate[k] - origin_rate;
      }

      // Membrane. F = [x_u x_v]; P = F S; force on corner i = -P grad N_i.
      const F g0 = Lanes::load(block.gradient[0] + lane), g1 = Lanes::load(block.gradient[1] + lane);
      const F g2 = Lanes::load(block.gradient[2] + lane), g3 = Lanes::load(block.gradient[3] + lane);
      const Vector fu = fma(g1, d[1], g0 * d[0]), fv = fma(g3, d[1], g2 * d[0]);
      [[maybe_unused]] Vector n;  // unit normal; early, since root and division take long
      if constexpr (kDampBend) {
        n = cross(fu, fv);
        n = (one / Lanes::root(Lanes::larger(dot(n, n), Lanes::splat(1e-12f)))) * n;
      }
      const F uu = dot(fu, fu), vv = dot(fv, fv);
      F e11 = half * (uu - one), e22 = half * (vv - one), shear = dot(fu, fv);
      {
        // Larger eigenvalue of F^T F.
        const F mean = half * (uu + vv), apart = half * (uu - vv);
        largest = Lanes::larger(largest, mean + Lanes::root(Lanes::fma(apart, apart, shear * shear)));
      }
      if constexpr (kDampStretch) {
        const F s = damp_stretch;
        const Vector ru = fma(g1, rate[1], g0 * rate[0]), rv = fma(g3, rate[1], g2 * rate[0]);
        e11 = Lanes::fma(s, dot(fu, ru), e11);
        e22 = Lanes::fma(s, dot(fv, rv), e22);
        shear = Lanes::fma(s, dot(fu, rv) + dot(fv, ru), shear);
      }
      const F c12 = Lanes::load(block.stiffness[1] + lane);
      const F s11 = Lanes::fma(Lanes::load(block.stiffness[0] + lane), e11, c12 * e22);
      const F s22 = Lanes::fma(Lanes::load(block.stiffness[2] + lane), e22, c12 * e11);
      const F s12 = Lanes::load(block.stiffness[3] + lane) * shear;
      const Vector pu = fma(s12, fv, s11 * fu), pv = fma(s22, fv, s12 * fu);
      Vector out[6];
      out[1] = fma(g2, pv, g0 * pu);
      out[2] = fma(g3, pv, g1 * pu);

      // Bending: y_k = sum_j w_kj (x_j - x_0), force on node j = -sum_k w_kj y_k. Weights carry sqrt(unit) each way.
      Vector y[3];
#pragma GCC unroll 3
      for (int k = 0; k < 3; ++k) {
        y[k] = Lanes::load(block.bend[k][0] + lane) * d[0];
#pragma GCC unroll 4
        for (int j = 1; j < 5; ++j) y[k] = fma(Lanes::load(block.bend[k][j] + lane), d[j], y[k]);
      }
      if constexpr (kDampBend) {
        // Only along the normal, where curvature lies. A rigid rotation changes y across the normal and is not damped.
        F along[5];
#pragma GCC unroll 5
        for (int k = 0; k < 5; ++k) along[k] = dot(rate[k], n);
#pragma GCC unroll 3
        for (int k = 0; k < 3; ++k) {
          F bending = Lanes::load(block.bend[k][0] + lane) * along[0];
#pragma GCC unroll 4
          for (int j = 1; j < 5; ++j) bending = Lanes::fma(Lanes::load(block.bend[k][j] + lane), along[j], bending);
          y[k] = fma(damp_bend * bending, n, y[k]);
        }
      }
#pragma GCC unroll 5
      for (int j = 1; j < 6; ++j) {
        if (j < 3)
          out[j] = fma(Lanes::load(block.bend[0][j - 1] + lane), y[0], out[j]);
        else
          out[j] = Lanes::load(block.bend[0][j - 1] + lane) * y[0];
#pragma GCC unroll 2
        for (int k = 1; k < 3; ++k) out[j] = fma(Lanes::load(block.bend[k][j - 1] + lane), y[k], out[j]);
      }
      out[0] = ((out[1] + out[2]) + (out[3] + out[4])) + out[5];
      Lanes::add_and_subtract(arguments.forces, block, lane, out);
    }
  return Lanes::largest(largest);
}

inline float add_forces(const ForceArguments& a) {
  const bool stretch = a.damping_stretch_s > 0.0, bend = a.damping_bend_s > 0.0;
  if (stretch) return bend ? add_forces<true, true>(a) : add_forces<true, false>(a);
  return bend ? add_forces<false, true>(a) : add_forces<false, false>(a);
}

}  // namespace
}  // namespace weft::cloth
