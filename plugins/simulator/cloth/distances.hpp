#pragma once
#include <algorithm>
#include <array>
#include <cstdint>

#include "simd.hpp"

/// Distances of the pairs that can be in contact: eight pairs at once in space, and one in the rest shape.
namespace weft::cloth {

/// Eight pairs: how far apart, along which direction, and between which points.
struct Measured {
  F8 distance;  // m, negative: on the wrong side
  Vec8 normal;
  F8 weight[4];
  F8 inside;  // mask: closest points are interior to both primitives
};

inline Vec8 scaled(const Vec8& a, float s) { return splat(s) * a; }

inline Vec8 unit_vector(const Vec8& r, F8 length) { return (splat(1.0f) / max8(length, splat(1e-12f))) * r; }

/// The memory that tells a pair's side: its last normal, if known, within reach.
struct Memory {
  Vec8 normal;
  F8 known;  // mask
  F8 reach;  // m
};

/// Vertex against triangle; Ericson (2005, sec. 5.1.5) without branches: the interior projection where it exists, else
/// the nearest of the three edges.
/// @param memory null: the side is the one on which the vertex is.
[[gnu::always_inline]] inline Measured measure_vertex_triangle(const Vec8& ap, const Vec8& ab, const Vec8& ac,
                                                               const Memory* memory) {
  const F8 zero = splat(0.0f), one = splat(1.0f);
  const F8 d00 = dot(ab, ab), d01 = dot(ab, ac), d11 = dot(ac, ac), d20 = dot(ap, ab), d21 = dot(ap, ac);
  const F8 denominator = max8(d00 * d11 - d01 * d01, splat(1e-30f));
  F8 b = (d11 * d20 - d01 * d21) / denominator;
  F8 c = (d00 * d21 - d01 * d20) / denominator;
  const F8 inside = both(both(less(zero, b), less(zero, c)), less(b + c, one));

  const F8 t1 = clamp01(d20 / d00), t2 = clamp01(d21 / d11);
  const F8 bc2 = d00 - d01 - d01 + d11;
  const F8 t3 = clamp01((d21 - d20 - d01 + d00) / bc2);
  const Vec8 r1 = fnma(t1, ab, ap), r2 = fnma(t2, ac, ap);
  const Vec8 r3 = fnma(t3, ac, fnma(one - t3, ab, ap));
  F8 best = dot(r1, r1), eb = t1, ec = zero;
  Vec8 r = r1;
  const F8 q2 = dot(r2, r2), q3 = dot(r3, r3);
  F8 closer = less(q2, best);
  best = select(closer, q2, best), eb = select(closer, zero, eb), ec = select(closer, t2, ec),
  r = select(closer, r2, r);
  closer = less(q3, best);
  best = select(closer, q3, best), eb = select(closer, one - t3, eb), ec = select(closer, t3, ec),
  r = select(closer, r3, r);
  const F8 outside_distance = _mm256_sqrt_ps(best);

  Vec8 n = cross(ab, ac);
  n = unit_vector(n, _mm256_sqrt_ps(dot(n, n)));
  F8 height = dot(ap, n);
  F8 side_up = less(zero, height);
  if (memory) {
    // The side is the remembered one, else the current one. A vertex farther than `reach` on the other side has come
    // round the border. (A remembered normal in the triangle's plane, from an approach past the border, tells no side.)
    const F8 remembered = dot(memory->normal, n);
    const F8 knows = both(memory->known, less(splat(0.2f), _mm256_andnot_ps(splat(-0.0f), remembered)));
    const F8 near = less(_mm256_andnot_ps(splat(-0.0f), height), memory->reach);
    side_up = select(both(knows, near), less(zero, remembered), side_up);
  }
  n = select(side_up, n, scaled(n, -1.0f));
  height = select(side_up, height, zero - height);

  Measured m;
  b = select(inside, b, eb), c = select(inside, c, ec);
  m.inside = inside;
  m.distance = select(inside, height, outside_distance);
  m.normal = select(inside, n, unit_vector(r, outside_distance));
  m.weight[0] = one;
  m.weight[1] = b + c - one;
  m.weight[2] = zero - b;
  m.weight[3] = zero - c;
  return m;
}

/// Edge against edge; Ericson (2005, sec. 5.1.9). r = first - second start.
[[gnu::always_inline]] inline Measured measure_edge_edge(const Vec8& d1, const Vec8& d2, const Vec8& r,
                                                         const Memory* memory) {
  const F8 zero = splat(0.0f), one = splat(1.0f);
  const F8 a = dot(d1, d1), e = dot(d2, d2), b = dot(d1, d2), c = dot(d1, r), f = dot(d2, r);
  const F8 denominator = a * e - b * b;
  const F8 parallel = less(denominator, splat(1e-6f) * (a * e));
  F8 s = select(parallel, splat(0.5f), clamp01((b * f - c * e) / select(parallel, one, denominator)));
  const F8 t = clamp01((b * s + f) / e);
  s = clamp01((b * t - c) / a);
  const Vec8 gap = fnma(t, d2, fma(s, d1, r));
  const F8 length = _mm256_sqrt_ps(dot(gap, gap));
  Measured m;
  m.inside = both(both(less(zero, s), less(s, one)), both(less(zero, t), less(t, one)));
  m.distance = length;
  m.normal = unit_vector(gap, length);
  if (memory) {
    const F8 flipped = both(both(memory->known, m.inside),
                            both(less(dot(memory->normal, m.normal), zero), less(length, memory->reach)));
    m.distance = select(flipped, zero - length, length);
    m.normal = select(flipped, scaled(m.normal, -1.0f), m.normal);
  }
  m.weight[0] = one - s;
  m.weight[1] = s;
  m.weight[2] = t - one;
  m.weight[3] = zero - t;
  return m;
}

/// @param vertex (k, lane): index of the pair's k-th vertex.
template <bool kEdges, class Vertex>
[[gnu::always_inline]] inline Measured measure(Vertex&& vertex, const Memory* memory, const Fixed4* x, float unit) {
  Fixed8 p[4];
  for (int k = 0; k < 4; ++k) p[k] = load8([&](int lane) { return x + vertex(k, lane); });
  if constexpr (kEdges)
    return measure_edge_edge(scaled(difference(p[1], p[0]), unit), scaled(difference(p[3], p[2]), unit),
                             scaled(difference(p[0], p[2]), unit), memory);
  else
    return measure_vertex_triangle(scaled(difference(p[0], p[1]), unit), scaled(difference(p[2], p[1]), unit),
                                   scaled(difference(p[3], p[1]), unit), memory);
}

/// The same in memory, to be read lane by lane.
struct Stored {
  alignas(32) float distance[8], normal[3][8], weight[4][8];
  unsigned inside;  // lanes
  explicit Stored(const Measured& m) {
    _mm256_store_ps(distance, m.distance);
    _mm256_store_ps(normal[0], m.normal.x);
    _mm256_store_ps(normal[1], m.normal.y);
    _mm256_store_ps(normal[2], m.normal.z);
    for (int k = 0; k < 4; ++k) _mm256_store_ps(weight[k], m.weight[k]);
    inside = static_cast<unsigned>(_mm256_movemask_ps(m.inside));
  }
};

/// Squared distance of a point to a segment of the rest shape, m^2.
inline double segment_distance2(const std::array<double, 2>& p, const std::array<double, 2>& a,
                                const std::array<double, 2>& b) {
  const double ux = b[0] - a[0], uy = b[1] - a[1], px = p[0] - a[0], py = p[1] - a[1];
  const double t = std::clamp((px * ux + py * uy) / (ux * ux + uy * uy), 0.0, 1.0);
  const double dx = px - t * ux, dy = py - t * uy;
  return dx * dx + dy * dy;
}

}  // namespace weft::cloth
