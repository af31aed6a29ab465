#include <algorithm>

#include "forces.hpp"

// From here on, functions are compiled for AVX-512. All of them have internal linkage. So no other file gets one of
// them, as it might get an inline function of a header if the whole file were compiled so.
#ifdef __clang__
#pragma clang attribute push(__attribute__((target("avx512f,avx512vl,avx512dq,avx512bw"))), apply_to = function)
#else
#pragma GCC push_options
#pragma GCC target("avx512f,avx512vl,avx512dq,avx512bw,prefer-vector-width=512")
#endif

namespace weft::cloth {
namespace {

/// Sixteen lanes.
struct Lanes {
  using F = __m512;
  struct Records {
    __m512i x, y, z;
  };
  static constexpr int kCount = 16;
  static F splat(float a) { return _mm512_set1_ps(a); }
  static F fma(F a, F b, F c) { return _mm512_fmadd_ps(a, b, c); }
  static F larger(F a, F b) { return _mm512_max_ps(a, b); }
  static F root(F a) { return _mm512_sqrt_ps(a); }
  static F load(const float* row) { return _mm512_load_ps(row); }
  template <class Record>
  static __m128i record(const Record* table, Offset offset) {
    return _mm_load_si128(reinterpret_cast<const __m128i*>(at(table, offset)));
  }
  /// The records of lanes k, k + 4, k + 8 and k + 12.
  template <class Record>
  static __m512i four(const Record* table, const Offset* offset) {
    __m512i records = _mm512_castsi128_si512(record(table, offset[0]));
    records = _mm512_inserti32x4(records, record(table, offset[4]), 1);
    records = _mm512_inserti32x4(records, record(table, offset[8]), 2);
    return _mm512_inserti32x4(records, record(table, offset[12]), 3);
  }
  template <class Record>
  static Records columns(const Record* table, const Offset* offset) {
    const __m512i a = four(table, offset), b = four(table, offset + 1);
    const __m512i c = four(table, offset + 2), d = four(table, offset + 3);
    const __m512i t0 = _mm512_unpacklo_epi32(a, b), t1 = _mm512_unpackhi_epi32(a, b);
    const __m512i t2 = _mm512_unpacklo_epi32(c, d), t3 = _mm512_unpackhi_epi32(c, d);
    return {_mm512_unpacklo_epi64(t0, t2), _mm512_unpackhi_epi64(t0, t2), _mm512_unpacklo_epi64(t1, t3)};
  }
  static Records load(const Fixed4* table, const Offset* offset) { return columns(table, offset); }
  template <class Vector>
  static void load(const Float4* table, const Offset* offset, Vector& out) {
    const Records bits = columns(table, offset);
    out = {_mm512_castsi512_ps(bits.x), _mm512_castsi512_ps(bits.y), _mm512_castsi512_ps(bits.z)};
  }
  template <class Vector>
  static void difference(const Records& a, const Records& b, Vector& out) {
    out = {_mm512_cvtepi32_ps(_mm512_sub_epi32(a.x, b.x)), _mm512_cvtepi32_ps(_mm512_sub_epi32(a.y, b.y)),
           _mm512_cvtepi32_ps(_mm512_sub_epi32(a.z, b.z))};
  }
  static F low(F a, F b) { return _mm512_castpd_ps(_mm512_unpacklo_pd(_mm512_castps_pd(a), _mm512_castps_pd(b))); }
  static F high(F a, F b) { return _mm512_castpd_ps(_mm512_unpackhi_pd(_mm512_castps_pd(a), _mm512_castps_pd(b))); }
  /// Vectors as records (x, y, z, 0): records[k] holds those of lanes k, k + 4, k + 8 and k + 12.
  template <class Vector>
  static void transpose(const Vector& v, F (&records)[4]) {
    const F zero = _mm512_setzero_ps();
    const F t0 = _mm512_unpacklo_ps(v.x, v.y), t1 = _mm512_unpackhi_ps(v.x, v.y);
    const F t2 = _mm512_unpacklo_ps(v.z, zero), t3 = _mm512_unpackhi_ps(v.z, zero);
    records[0] = low(t0, t2), records[1] = high(t0, t2), records[2] = low(t1, t3), records[3] = high(t1, t3);
  }
  /// The first eight lanes come first, as where there are no more.
  template <int kHalf, class Combine>
  static void combine_half(Float4* forces, const Offset* offset, const F (&records)[4], Combine&& combine) {
    const auto update = [&](int lane, __m128 value) {
      float* to = &at(forces, offset[lane])->x;
      _mm_store_ps(to, combine(_mm_load_ps(to), value));
    };
#pragma GCC unroll 4
    for (int k = 0; k < 4; ++k) update(8 * kHalf + k, _mm512_extractf32x4_ps(records[k], 2 * kHalf));
#pragma GCC unroll 4
    for (int k = 0; k < 4; ++k) update(8 * kHalf + 4 + k, _mm512_extractf32x4_ps(records[k], 2 * kHalf + 1));
  }
  template <int kHalf>
  static void combine_halves(Float4* forces, const ElementBlock& block, const F (&records)[6][4]) {
    combine_half<kHalf>(forces, block.node[0], records[0], [](__m128 a, __m128 b) { return _mm_add_ps(a, b); });
#pragma GCC unroll 5
    for (int j = 1; j < 6; ++j)
      combine_half<kHalf>(forces, block.node[j], records[j], [](__m128 a, __m128 b) { return _mm_sub_ps(a, b); });
  }
  template <class Vector>
  static void add_and_subtract(Float4* forces, const ElementBlock& block, int, const Vector (&out)[6]) {
    F records[6][4];
#pragma GCC unroll 6
    for (int j = 0; j < 6; ++j) transpose(out[j], records[j]);
    combine_halves<0>(forces, block, records);
    combine_halves<1>(forces, block, records);
  }
  static float largest(F a) { return _mm512_reduce_max_ps(a); }
};

}  // namespace
}  // namespace weft::cloth

#include "forces_kernel.hpp"

namespace weft::cloth {

float add_forces_wide(const ForceArguments& arguments) { return add_forces(arguments); }

}  // namespace weft::cloth
#ifdef __clang__
#pragma clang attribute pop
#else
#pragma GCC pop_options
#endif

namespace weft::cloth {

bool has_wide_lanes() {
  return __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512vl") &&
         __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512bw");
}

}  // namespace weft::cloth
