#pragma once
#include <immintrin.h>

#include <cstddef>
#include <cstdint>
#include <type_traits>

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
inline __m256d load(const Double4& a) { return _mm256_load_pd(&a.x); }
inline void store(Double4& a, __m256d value) { _mm256_store_pd(&a.x, value); }

/// Squared lengths of four vectors (x, y, z, unused), as _mm_dp_ps rounds them.
inline __m128 squares4(__m128 a, __m128 b, __m128 c, __m128 d) {
  const __m128 low = _mm_unpacklo_ps(a, b), low2 = _mm_unpacklo_ps(c, d);
  const __m128 high = _mm_unpackhi_ps(a, b), high2 = _mm_unpackhi_ps(c, d);
  const __m128 x = _mm_movelh_ps(low, low2), y = _mm_movehl_ps(low2, low), z = _mm_movelh_ps(high, high2);
  return _mm_add_ps(_mm_add_ps(_mm_mul_ps(x, x), _mm_mul_ps(y, y)), _mm_mul_ps(z, z));
}
/// Length of a list of vertices that is processed in fours.
inline std::size_t padded(std::size_t vertices) { return (vertices + 3) / 4 * 4; }
inline float largest_of(__m128 a) {
  a = _mm_max_ps(a, _mm_movehl_ps(a, a));
  return _mm_cvtss_f32(_mm_max_ss(a, _mm_shuffle_ps(a, a, 1)));
}

/// body(lane) for the lanes of a mask, lowest first.
template <class Body>
[[gnu::always_inline]] inline void each_lane(unsigned mask, Body&& body) {
  for (; mask != 0; mask &= mask - 1) body(__builtin_ctz(mask));
}

struct Fixed8 {
  I8 x, y, z;
};
/// Eight records of 16 bytes, their first three components as lanes.
template <class Address>
[[gnu::always_inline]] inline Fixed8 load8(Address&& address) {
  const auto at = [&](int lane) { return _mm_loadu_si128(reinterpret_cast<const __m128i*>(address(lane))); };
  const I8 a = _mm256_set_m128i(at(4), at(0));
  const I8 b = _mm256_set_m128i(at(5), at(1));
  const I8 c = _mm256_set_m128i(at(6), at(2));
  const I8 d = _mm256_set_m128i(at(7), at(3));
  const I8 t0 = _mm256_unpacklo_epi32(a, b), t1 = _mm256_unpackhi_epi32(a, b);
  const I8 t2 = _mm256_unpacklo_epi32(c, d), t3 = _mm256_unpackhi_epi32(c, d);
  return {_mm256_unpacklo_epi64(t0, t2), _mm256_unpackhi_epi64(t0, t2), _mm256_unpacklo_epi64(t1, t3)};
}
inline Vec8 as_float(const Fixed8& bits) {
  return {_mm256_castsi256_ps(bits.x), _mm256_castsi256_ps(bits.y), _mm256_castsi256_ps(bits.z)};
}
/// The records of eight vertices.
[[gnu::always_inline]] inline Fixed8 load8(const Fixed4* table, const std::int32_t* index) {
  return load8([&](int lane) { return table + index[lane]; });
}
[[gnu::always_inline]] inline Vec8 load8(const Float4* table, const std::int32_t* index) {
  return as_float(load8([&](int lane) { return table + index[lane]; }));
}
/// Their fourth components.
[[gnu::always_inline]] inline F8 load_w8(const Float4* table, const std::int32_t* index) {
  const auto w = [&](int lane) { return table[index[lane]].w; };
  return _mm256_setr_ps(w(0), w(1), w(2), w(3), w(4), w(5), w(6), w(7));
}
/// Byte offset of a vertex's record in every table of 16-byte records: 16 times its index. The element blocks store it,
/// because computing addresses took a quarter of the instructions of the forces.
using Offset = std::uint32_t;
inline Offset offset_of(std::int32_t vertex) { return 16u * static_cast<Offset>(vertex); }
template <class Record>
[[gnu::always_inline]] inline Record* at(Record* table, Offset offset) {
  static_assert(sizeof(Record) == 16);
  using Byte = std::conditional_t<std::is_const_v<Record>, const char, char>;
  return reinterpret_cast<Record*>(reinterpret_cast<Byte*>(table) + offset);
}
[[gnu::always_inline]] inline Fixed8 load8(const Fixed4* table, const Offset* offset) {
  return load8([&](int lane) { return at(table, offset[lane]); });
}
[[gnu::always_inline]] inline Vec8 load8(const Float4* table, const Offset* offset) {
  return as_float(load8([&](int lane) { return at(table, offset[lane]); }));
}
/// a - b as float, in fixed-point units. Exact subtraction, modulo 2^32 (wraps as two's complement).
inline Vec8 difference(const Fixed8& a, const Fixed8& b) {
  return {_mm256_cvtepi32_ps(_mm256_sub_epi32(a.x, b.x)), _mm256_cvtepi32_ps(_mm256_sub_epi32(a.y, b.y)),
          _mm256_cvtepi32_ps(_mm256_sub_epi32(a.z, b.z))};
}
/// Eight vectors as records (x, y, z, 0).
struct Records8 {
  F8 r[4];  ///< of lanes k and k + 4
  explicit Records8(const Vec8& v) {
    const F8 zero = _mm256_setzero_ps();
    const F8 t0 = _mm256_unpacklo_ps(v.x, v.y), t1 = _mm256_unpackhi_ps(v.x, v.y);
    const F8 t2 = _mm256_unpacklo_ps(v.z, zero), t3 = _mm256_unpackhi_ps(v.z, zero);
    const auto low = [](F8 a, F8 b) {
      return _mm256_castpd_ps(_mm256_unpacklo_pd(_mm256_castps_pd(a), _mm256_castps_pd(b)));
    };
    const auto high = [](F8 a, F8 b) {
      return _mm256_castpd_ps(_mm256_unpackhi_pd(_mm256_castps_pd(a), _mm256_castps_pd(b)));
    };
    r[0] = low(t0, t2), r[1] = high(t0, t2), r[2] = low(t1, t3), r[3] = high(t1, t3);
  }
};
/// The records of eight vertices. Where an index repeats, its first lane counts.
[[gnu::always_inline]] inline void store8(Float4* table, const std::int32_t* index, const Vec8& v) {
  const Records8 records(v);
  for (int k = 4; k-- > 0;) _mm_store_ps(&table[index[k + 4]].x, _mm256_extractf128_ps(records.r[k], 1));
  for (int k = 4; k-- > 0;) _mm_store_ps(&table[index[k]].x, _mm256_castps256_ps128(records.r[k]));
}
/// record = combine(record, v[lane]) for the vertices at offset[lane], lane by lane in this order; offsets may repeat.
template <class Combine>
[[gnu::always_inline]] inline void update8(Float4* table, const Offset* offset, const Vec8& v, Combine&& combine) {
  const Records8 records(v);
  const auto update = [&](int lane, __m128 value) {
    float* to = &at(table, offset[lane])->x;
    _mm_store_ps(to, combine(_mm_load_ps(to), value));
  };
  for (int k = 0; k < 4; ++k) update(k, _mm256_castps256_ps128(records.r[k]));
  for (int k = 0; k < 4; ++k) update(k + 4, _mm256_extractf128_ps(records.r[k], 1));
}
[[gnu::always_inline]] inline void add8(Float4* table, const Offset* offset, const Vec8& v) {
  update8(table, offset, v, [](__m128 a, __m128 b) { return _mm_add_ps(a, b); });
}
[[gnu::always_inline]] inline void subtract8(Float4* table, const Offset* offset, const Vec8& v) {
  update8(table, offset, v, [](__m128 a, __m128 b) { return _mm_sub_ps(a, b); });
}

}  // namespace weft::cloth
