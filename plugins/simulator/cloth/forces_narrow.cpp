#include <algorithm>

#include "forces.hpp"

namespace weft::cloth {
namespace {

/// Eight lanes (AVX2).
struct Lanes {
  using F = F8;
  using Records = Fixed8;
  static constexpr int kCount = 8;
  static F splat(float a) { return _mm256_set1_ps(a); }
  static F fma(F a, F b, F c) { return _mm256_fmadd_ps(a, b, c); }
  static F larger(F a, F b) { return _mm256_max_ps(a, b); }
  static F root(F a) { return _mm256_sqrt_ps(a); }
  static F load(const float* row) { return _mm256_load_ps(row); }
  static Records load(const Fixed4* table, const Offset* offset) { return load8(table, offset); }
  template <class Vector>
  static void load(const Float4* table, const Offset* offset, Vector& out) {
    const Vec8 v = load8(table, offset);
    out = {v.x, v.y, v.z};
  }
  template <class Vector>
  static void difference(const Records& a, const Records& b, Vector& out) {
    const Vec8 v = cloth::difference(a, b);
    out = {v.x, v.y, v.z};
  }
  template <class Vector>
  static void add_and_subtract(Float4* forces, const ElementBlock& block, int lane, const Vector (&out)[6]) {
    add8(forces, block.node[0] + lane, {out[0].x, out[0].y, out[0].z});
    for (int j = 1; j < 6; ++j) subtract8(forces, block.node[j] + lane, {out[j].x, out[j].y, out[j].z});
  }
  static float largest(F a) {
    alignas(32) float lanes[8];
    _mm256_store_ps(lanes, a);
    return *std::max_element(lanes, lanes + 8);
  }
};

}  // namespace
}  // namespace weft::cloth

#include "forces_kernel.hpp"

namespace weft::cloth {

float add_forces_narrow(const ForceArguments& arguments) { return add_forces(arguments); }

}  // namespace weft::cloth
