#pragma once
#include <immintrin.h>

#include <cstdint>

/// Eight lanes of float, and the moves between vertex records (x, y, z, unused) and lanes.
namespace weft::cloth {

using F8 = __m256;
using I8 = __m256i;

inline F8 splat(float a) { return _mm256_set1_ps(a); }
inline F8 fma(F8 a, F8 b, F8 c) { return _mm256_fmadd_ps(a, b, c); }
inline F8 fnma(F8 a, F8 b, F8 c) { return _mm256_fnmadd_ps(a, b, c); }  // c - a b
inline F8 min8(F8 a, F8 b) { return _mm256_min_ps(a, b); }
inline F8 max8(F8 a, F8 b) { return _mm256_max_ps(a, b); }
inline F8 clamp01(F8 a) { return min8(max8(a, splat(0.0f)), splat(1.0f)); }
inline F8 select(F8 mask, F8 yes, F8 no) { return _mm256_blendv_ps(no, yes, mask); }
inline F8 less(F8 a, F8 b) { return _mm256_cmp_ps(a, b, _CMP_LT_OQ); }
inline F8 both(F8 a, F8 b) { return _mm256_and_ps(a, b); }

struct Vec8 {
  F8 x, y, z;
};
inline Vec8 operator+(const Vec8& a, const Vec8& b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
inline Vec8 operator-(const Vec8& a, const Vec8& b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
inline Vec8 operator*(F8 s, const Vec8& a) { return {s * a.x, s * a.y, s * a.z}; }
inline Vec8 fma(F8 s, const Vec8& a, const Vec8& b) { return {fma(s, a.x, b.x), fma(s, a.y, b.y), fma(s, a.z, b.z)}; }
inline Vec8 fnma(F8 s, const Vec8& a, const Vec8& b) {
  return {fnma(s, a.x, b.x), fnma(s, a.y, b.y), fnma(s, a.z, b.z)};
}
inline F8 dot(const Vec8& a, const Vec8& b) { return fma(a.z, b.z, fma(a.y, b.y, a.x * b.x)); }
inline Vec8 select(F8 mask, const Vec8& yes, const Vec8& no) {
  return {select(mask, yes.x, no.x), select(mask, yes.y, no.y), select(mask, yes.z, no.z)};
}
inline Vec8 cross(const Vec8& a, const Vec8& b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

/// Position of a vertex in fixed point, relative to a common origin: differences are exact in integers, wherever the
/// cloth is, and convert to float with full relative precision.
struct alignas(16) Fixed4 {
  std::int32_t x, y, z, w;
};
struct alignas(16) Float4 {
  float x, y, z, w;
};
struct alignas(32) Double4 {
  double x, y, z, w;
};

struct Fixed8 {
  I8 x, y, z;
};
/// The records of eight vertices as lanes.
inline Fixed8 load8(const Fixed4* table, const std::int32_t* index) {
  const auto at = [&](int lane) { return _mm_load_si128(reinterpret_cast<const __m128i*>(table + index[lane])); };
  const I8 a = _mm256_set_m128i(at(4), at(0));
  const I8 b = _mm256_set_m128i(at(5), at(1));
  const I8 c = _mm256_set_m128i(at(6), at(2));
  const I8 d = _mm256_set_m128i(at(7), at(3));
  const I8 t0 = _mm256_unpacklo_epi32(a, b), t1 = _mm256_unpackhi_epi32(a, b);
  const I8 t2 = _mm256_unpacklo_epi32(c, d), t3 = _mm256_unpackhi_epi32(c, d);
  return {_mm256_unpacklo_epi64(t0, t2), _mm256_unpackhi_epi64(t0, t2), _mm256_unpacklo_epi64(t1, t3)};
}
inline Vec8 load8(const Float4* table, const std::int32_t* index) {
  const Fixed8 bits = load8(reinterpret_cast<const Fixed4*>(table), index);
  return {_mm256_castsi256_ps(bits.x), _mm256_castsi256_ps(bits.y), _mm256_castsi256_ps(bits.z)};
}
/// a - b as float, in fixed-point units. Exact subtraction, modulo 2^32 (wraps as two's complement).
inline Vec8 difference(const Fixed8& a, const Fixed8& b) {
  return {_mm256_cvtepi32_ps(_mm256_sub_epi32(a.x, b.x)), _mm256_cvtepi32_ps(_mm256_sub_epi32(a.y, b.y)),
          _mm256_cvtepi32_ps(_mm256_sub_epi32(a.z, b.z))};
}
/// table[index[lane]] += v[lane], lane by lane in this order; indices may repeat.
inline void add8(Float4* table, const std::int32_t* index, const Vec8& v) {
  const F8 zero = _mm256_setzero_ps();
  const F8 t0 = _mm256_unpacklo_ps(v.x, v.y), t1 = _mm256_unpackhi_ps(v.x, v.y);
  const F8 t2 = _mm256_unpacklo_ps(v.z, zero), t3 = _mm256_unpackhi_ps(v.z, zero);
  const auto low = [](F8 a, F8 b) {
    return _mm256_castpd_ps(_mm256_unpacklo_pd(_mm256_castps_pd(a), _mm256_castps_pd(b)));
  };
  const auto high = [](F8 a, F8 b) {
    return _mm256_castpd_ps(_mm256_unpackhi_pd(_mm256_castps_pd(a), _mm256_castps_pd(b)));
  };
  const F8 r[4] = {low(t0, t2), high(t0, t2), low(t1, t3), high(t1, t3)};
  const auto add = [&](int lane, __m128 value) {
    float* to = &table[index[lane]].x;
    _mm_store_ps(to, _mm_add_ps(_mm_load_ps(to), value));
  };
  for (int k = 0; k < 4; ++k) add(k, _mm256_castps256_ps128(r[k]));
  for (int k = 0; k < 4; ++k) add(k + 4, _mm256_extractf128_ps(r[k], 1));
}

}  // namespace weft::cloth
