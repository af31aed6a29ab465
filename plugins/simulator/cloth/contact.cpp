#include "contact.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>

namespace weft::cloth {
namespace {

// Part of the explicit limit dt^2 lambda = 4 that contact takes: 0.5 for the spring and 2 * 0.55 for the dashpot; the
// elements take 4 * 0.75^2 = 2.25 at the default step_safety.
constexpr float kSpring = 0.5f;
constexpr float kDashpot = 0.55f;
// A vertex counts as if it carried at least this sum of |weight| (two layers give 2 to 4), and only pairs that touch count:
// pairs which come and go must not change the stiffness of the others. When fast approach brought in more pairs, springs
// were softer while compressed than while released, and resting layers bounced for ever.
constexpr float kLeastLoad = 6.0f;
// A pair pressed deeper than this part of its distance yields (keeps the gap it has) ...
constexpr float kYield = 0.25f;
// ... and recovers at this speed, m/s, so that separating layers gain no energy worth naming.
constexpr float kRecovery = 0.02f;
// Edge pairs act at a smaller distance than vertices: in flat layers vertex-triangle pairs carry the load alone.
constexpr float kEdgePart = 0.8f;

struct Measured {
  F8 distance;     // m, negative: on the wrong side
  Vec8 normal;
  F8 weight[4];
  F8 inside;       // mask: closest points are interior to both primitives
};

inline Vec8 scaled(const Vec8& a, float s) { return splat(s) * a; }

Vec8 unit_vector(const Vec8& r, F8 length) { return (splat(1.0f) / max8(length, splat(1e-12f))) * r; }

/// Vertex against triangle; Ericson (2005, sec. 5.1.5) without branches: the interior projection where it exists, else
/// the nearest of the three edges.
Measured measure_vertex_triangle(const Vec8& ap, const Vec8& ab, const Vec8& ac, const Vec8& memory, F8 known, F8 reach) {
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
  best = select(closer, q2, best), eb = select(closer, zero, eb), ec = select(closer, t2, ec), r = select(closer, r2, r);
  closer = less(q3, best);
  best = select(closer, q3, best), eb = select(closer, one - t3, eb), ec = select(closer, t3, ec), r = select(closer, r3, r);
  const F8 outside_distance = _mm256_sqrt_ps(best);

  Vec8 n = cross(ab, ac);
  n = unit_vector(n, _mm256_sqrt_ps(dot(n, n)));
  F8 height = dot(ap, n);
  // Side: as remembered, else as it stands. Further than `reach` on the other side it has come round the border.
  // (A memory that lies in the triangle's plane, from an approach past the border, knows no side.)
  const F8 remembered = dot(memory, n);
  const F8 same = less(zero, remembered);
  known = both(known, less(splat(0.2f), _mm256_andnot_ps(splat(-0.0f), remembered)));
  const F8 above = less(zero, height);
  const F8 near = less(_mm256_andnot_ps(splat(-0.0f), height), reach);
  const F8 side_up = select(both(known, near), same, above);
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
Measured measure_edge_edge(const Vec8& d1, const Vec8& d2, const Vec8& r, const Vec8& memory, F8 known, F8 reach) {
  const F8 zero = splat(0.0f), one = splat(1.0f);
  const F8 a = dot(d1, d1), e = dot(d2, d2), b = dot(d1, d2), c = dot(d1, r), f = dot(d2, r);
  const F8 denominator = a * e - b * b;
  const F8 parallel = less(denominator, splat(1e-6f) * (a * e));
  F8 s = select(parallel, splat(0.5f), clamp01((b * f - c * e) / select(parallel, one, denominator)));
  const F8 t = clamp01((b * s + f) / e);
  s = clamp01((b * t - c) / a);
  const Vec8 gap = fnma(t, d2, fma(s, d1, r));
  const F8 length = _mm256_sqrt_ps(dot(gap, gap));
  Vec8 n = unit_vector(gap, length);
  const F8 inside = both(both(less(zero, s), less(s, one)), both(less(zero, t), less(t, one)));
  const F8 flipped = both(both(known, inside), both(less(dot(memory, n), zero), less(length, reach)));
  Measured m;
  m.inside = inside;
  m.distance = select(flipped, zero - length, length);
  m.normal = select(flipped, scaled(n, -1.0f), n);
  m.weight[0] = one - s;
  m.weight[1] = s;
  m.weight[2] = t - one;
  m.weight[3] = zero - t;
  return m;
}

/// Measures eight candidates (indices into list); lanes beyond count repeat the first.
struct Lanes {
  alignas(32) std::int32_t vertex[4][8];
  alignas(32) float memory[3][8];
  alignas(32) float reach[8];
};
template <bool kEdges>
Measured measure(const SelfContact::Candidate* const* list, int count, const Fixed4* x, float unit) {
  Lanes lanes;
  for (int lane = 0; lane < 8; ++lane) {
    const SelfContact::Candidate& candidate = *list[lane < count ? lane : 0];
    for (int k = 0; k < 4; ++k) lanes.vertex[k][lane] = candidate.v[k];
    for (int k = 0; k < 3; ++k) lanes.memory[k][lane] = candidate.normal[k];
    lanes.reach[lane] = kEdges ? 0.5f * candidate.distance : candidate.distance;
  }
  const Vec8 memory{_mm256_load_ps(lanes.memory[0]), _mm256_load_ps(lanes.memory[1]), _mm256_load_ps(lanes.memory[2])};
  const F8 known = less(splat(0.5f), dot(memory, memory));
  const F8 reach = _mm256_load_ps(lanes.reach);
  const Fixed8 p0 = load8(x, lanes.vertex[0]), p1 = load8(x, lanes.vertex[1]);
  const Fixed8 p2 = load8(x, lanes.vertex[2]), p3 = load8(x, lanes.vertex[3]);
  if constexpr (kEdges)
    return measure_edge_edge(scaled(difference(p1, p0), unit), scaled(difference(p3, p2), unit),
                             scaled(difference(p0, p2), unit), memory, known, reach);
  else
    return measure_vertex_triangle(scaled(difference(p0, p1), unit), scaled(difference(p2, p1), unit),
                                   scaled(difference(p3, p1), unit), memory, known, reach);
}

struct Stored {
  alignas(32) float distance[8], normal[3][8], weight[4][8], inside[8];
  explicit Stored(const Measured& m) {
    _mm256_store_ps(distance, m.distance);
    _mm256_store_ps(normal[0], m.normal.x);
    _mm256_store_ps(normal[1], m.normal.y);
    _mm256_store_ps(normal[2], m.normal.z);
    for (int k = 0; k < 4; ++k) _mm256_store_ps(weight[k], m.weight[k]);
    _mm256_store_ps(inside, _mm256_and_ps(m.inside, splat(1.0f)));
  }
};

inline std::uint64_t key_of(const std::int32_t (&v)[4], bool edges) {
  // Vertex and face, or two edges: 16 + 16 + 16 + 16 bits do not hold 4 vertices of a large mesh, so mix.
  std::uint64_t h = edges ? 0x243f6a8885a308d3ull : 0x13198a2e03707344ull;
  for (const std::int32_t i : v) {
    h ^= static_cast<std::uint32_t>(i);
    h *= 0x9e3779b97f4a7c15ull;
    h ^= h >> 29;
  }
  return h;
}

double segment_distance2(const std::array<double, 2>& p, const std::array<double, 2>& a, const std::array<double, 2>& b) {
  const double ux = b[0] - a[0], uy = b[1] - a[1], px = p[0] - a[0], py = p[1] - a[1];
  const double t = std::clamp((px * ux + py * uy) / (ux * ux + uy * uy), 0.0, 1.0);
  const double dx = px - t * ux, dy = py - t * uy;
  return dx * dx + dy * dy;
}

}  // namespace

SelfContact::SelfContact(const Topology& topology, const Fabric& fabric)
    : topology_(&topology),
      thickness_(static_cast<float>(fabric.thickness_m)),
      edge_thickness_(kEdgePart * static_cast<float>(fabric.thickness_m)),
      friction_(static_cast<float>(fabric.self_friction)),
      least_slack_(std::max(static_cast<float>(fabric.thickness_m), 0.08f * static_cast<float>(topology.max_edge))) {}

double SelfContact::longest_step(double g) const {
  // k depth = m g with k = kSpring m / (2 kLeastLoad dt^2).
  return std::sqrt(0.08 * thickness_ * kSpring / (2.0 * kLeastLoad * std::max(g, 1e-9)));
}

void SelfContact::clear(State& state) const {
  const auto n = static_cast<std::size_t>(topology_->vertices);
  state.valid = false;
  state.vertex_triangle.clear();
  state.edge_edge.clear();
  state.active.clear();
  state.vertex_triangle.reserve(16 * n);
  state.edge_edge.reserve(32 * n);
  state.active.reserve(16 * n);
  state.fast.clear();
  state.fast.reserve(16 * n);
  state.path.assign(n, 0.0f);
  state.slack.assign(n, 0.0f);
  state.touching = 0;
}

/// Pairs that lie near one another in the rest shape must not repel there: their distance is at most 0.7 of what
/// separates them at rest, which leaves room for compression.
float SelfContact::pair_distance(const std::int32_t (&v)[4], bool edges) const {
  const float full = edges ? edge_thickness_ : thickness_;
  if (topology_->component[v[0]] != topology_->component[v[3]]) return full;
  const auto& rest = topology_->rest;
  const double far = 2.0 * full;
  double low[2][2], high[2][2];  // boxes of first and second
  const int split = edges ? 2 : 1;
  for (int k = 0; k < 2; ++k) {
    for (int side = 0; side < 2; ++side) low[side][k] = 1e30, high[side][k] = -1e30;
    for (int i = 0; i < 4; ++i) {
      const int side = i >= split;
      low[side][k] = std::min(low[side][k], rest[v[i]][k]);
      high[side][k] = std::max(high[side][k], rest[v[i]][k]);
    }
    if (low[0][k] > high[1][k] + far || low[1][k] > high[0][k] + far) return full;
  }
  double d2;
  if (edges) {
    d2 = std::min(std::min(segment_distance2(rest[v[0]], rest[v[2]], rest[v[3]]), segment_distance2(rest[v[1]], rest[v[2]], rest[v[3]])),
                  std::min(segment_distance2(rest[v[2]], rest[v[0]], rest[v[1]]), segment_distance2(rest[v[3]], rest[v[0]], rest[v[1]])));
  } else {
    d2 = std::min(segment_distance2(rest[v[0]], rest[v[1]], rest[v[2]]),
                  std::min(segment_distance2(rest[v[0]], rest[v[2]], rest[v[3]]), segment_distance2(rest[v[0]], rest[v[1]], rest[v[3]])));
  }
  return std::min(full, static_cast<float>(0.7 * std::sqrt(d2)));
}

void SelfContact::prepare(State& state, const Double4* x, const Fixed4* fixed, double unit, const float* speed,
                          const float* reach, double frame_seconds) const {
  bool good = state.valid;
  const std::int32_t n = topology_->vertices;
  for (std::int32_t i = 0; good && i < n; ++i) good = state.path[i] + reach[i] <= state.slack[i];
  if (!good) find_candidates(state, x, fixed, unit, speed, frame_seconds);
}

void SelfContact::find_candidates(State& state, const Double4* x, const Fixed4* fixed, double unit, const float* speed,
                                  double frame_seconds) const {
  const std::int32_t n = topology_->vertices;
  // Old memory by key, open addressing. Only pairs whose side or slip is known matter.
  thread_local std::vector<std::int32_t> table;
  thread_local std::vector<Candidate> old;
  old.clear();
  for (const auto* list : {&state.vertex_triangle, &state.edge_edge})
    for (const Candidate& c : *list)
      if (c.normal[0] != 0.0f || c.normal[1] != 0.0f || c.normal[2] != 0.0f) old.push_back(c);
  const std::size_t old_vertex_triangle = static_cast<std::size_t>(
      std::count_if(state.vertex_triangle.begin(), state.vertex_triangle.end(), [](const Candidate& c) {
        return c.normal[0] != 0.0f || c.normal[1] != 0.0f || c.normal[2] != 0.0f;
      }));
  std::size_t size = 64;
  while (size < 2 * old.size()) size *= 2;
  table.assign(size, -1);
  for (std::size_t k = 0; k < old.size(); ++k) {
    std::size_t at = key_of(old[k].v, k >= old_vertex_triangle) & (size - 1);
    while (table[at] >= 0) at = (at + 1) & (size - 1);
    table[at] = static_cast<std::int32_t>(k);
  }
  const auto recall = [&](Candidate& c, bool edges) {
    std::size_t at = key_of(c.v, edges) & (size - 1);
    while (table[at] >= 0) {
      const Candidate& o = old[table[at]];
      if ((static_cast<std::size_t>(table[at]) >= old_vertex_triangle) == edges && std::memcmp(o.v, c.v, sizeof c.v) == 0) {
        std::memcpy(c.normal, o.normal, sizeof c.normal);
        std::memcpy(c.slip, o.slip, sizeof c.slip);
        c.present = o.present;
        return;
      }
      at = (at + 1) & (size - 1);
    }
  };

  // Slack: what a vertex moves in a frame at its present speed, and a little for what it may gain.
  float max_slack = 0.0f;
  for (std::int32_t i = 0; i < n; ++i) {
    state.path[i] = 0.0f;
    state.slack[i] = least_slack_ + 1.25f * speed[i] * static_cast<float>(frame_seconds);
    max_slack = std::max(max_slack, state.slack[i]);
  }

  // Uniform grid over the bounding box, dense, x fastest: the cells of a row are one contiguous range.
  double low[3] = {1e300, 1e300, 1e300}, high[3] = {-1e300, -1e300, -1e300};
  for (std::int32_t i = 0; i < n; ++i) {
    const double p[3] = {x[i].x, x[i].y, x[i].z};
    for (int k = 0; k < 3; ++k) low[k] = std::min(low[k], p[k]), high[k] = std::max(high[k], p[k]);
  }
  double cell = std::max(0.5 * topology_->max_edge, static_cast<double>(thickness_));
  std::int64_t count[3];
  for (;;) {
    double cells = 1.0;
    for (int k = 0; k < 3; ++k) cells *= std::floor((high[k] - low[k]) / cell) + 1.0;
    if (cells <= 64.0 * n + 4096.0) break;
    cell *= 1.3;
  }
  for (int k = 0; k < 3; ++k) count[k] = static_cast<std::int64_t>((high[k] - low[k]) / cell) + 1;
  const double per_cell = 1.0 / cell;
  const auto cell_of = [&](double value, int k) {
    return std::clamp(static_cast<std::int64_t>(std::floor((value - low[k]) * per_cell)), std::int64_t{0}, count[k] - 1);
  };
  thread_local std::vector<std::int32_t> start, item, cell_index;
  thread_local std::vector<Float4> position, centre;
  position.resize(n);
  for (std::int32_t i = 0; i < n; ++i)
    position[i] = {static_cast<float>(x[i].x - low[0]), static_cast<float>(x[i].y - low[1]),
                   static_cast<float>(x[i].z - low[2]), state.slack[i]};
  const auto sort_into_cells = [&](const std::vector<Float4>& points) {
    start.assign(static_cast<std::size_t>(count[0] * count[1] * count[2]) + 1, 0);
    cell_index.resize(points.size());
    item.resize(points.size());
    for (std::size_t i = 0; i < points.size(); ++i) {
      const std::int64_t cx = cell_of(points[i].x + low[0], 0), cy = cell_of(points[i].y + low[1], 1),
                         cz = cell_of(points[i].z + low[2], 2);
      cell_index[i] = static_cast<std::int32_t>((cz * count[1] + cy) * count[0] + cx);
      ++start[cell_index[i] + 1];
    }
    for (std::size_t k = 1; k < start.size(); ++k) start[k] += start[k - 1];
    // Backwards, so that items keep their order and start[] ends as the beginning of each cell.
    for (std::size_t i = points.size(); i-- > 0;) item[--start[cell_index[i] + 1]] = static_cast<std::int32_t>(i);
    for (std::size_t k = 0; k + 1 < start.size(); ++k) start[k] = start[k + 1];
    start.back() = static_cast<std::int32_t>(points.size());
  };
  const auto visit = [&](const float (&from)[3], const float (&to)[3], auto&& body) {
    const std::int64_t x0 = cell_of(from[0] + low[0], 0), x1 = cell_of(to[0] + low[0], 0);
    const std::int64_t y0 = cell_of(from[1] + low[1], 1), y1 = cell_of(to[1] + low[1], 1);
    const std::int64_t z0 = cell_of(from[2] + low[2], 2), z1 = cell_of(to[2] + low[2], 2);
    for (std::int64_t cz = z0; cz <= z1; ++cz)
      for (std::int64_t cy = y0; cy <= y1; ++cy) {
        const std::int64_t row = (cz * count[1] + cy) * count[0];
        for (std::int32_t k = start[row + x0]; k < start[row + x1 + 1]; ++k) body(item[k]);
      }
  };

  const Candidate* group[8];
  thread_local std::vector<Candidate> pending;
  const float unit_f = static_cast<float>(unit);
  // Measures the pending pairs and keeps those within reach of their slack.
  const auto keep = [&](std::vector<Candidate>& out, auto edges) {
    constexpr bool kEdges = decltype(edges)::value;
    for (std::size_t k = 0; k < pending.size(); k += 8) {
      const int lanes = static_cast<int>(std::min<std::size_t>(8, pending.size() - k));
      for (int lane = 0; lane < lanes; ++lane) group[lane] = &pending[k + lane];
      const Stored m(measure<kEdges>(group, lanes, fixed, unit_f));
      for (int lane = 0; lane < lanes; ++lane) {
        Candidate& c = pending[k + lane];
        if (m.distance[lane] > c.distance + c.due) continue;  // due holds the sum of slacks here
        c.distance = pair_distance(c.v, kEdges);
        c.present = c.distance;
        recall(c, kEdges);
        c.due = 0.0f;  // measured again by the next activate(), with its memory
        out.push_back(c);
      }
    }
    pending.clear();
  };

  state.vertex_triangle.clear();
  sort_into_cells(position);
  for (const auto& face : topology_->faces) {
    const Float4 &a = position[face[0]], &b = position[face[1]], &c = position[face[2]];
    const float slack = std::max(a.w, std::max(b.w, c.w)) + thickness_;
    const float lower[3] = {std::min(a.x, std::min(b.x, c.x)) - slack, std::min(a.y, std::min(b.y, c.y)) - slack,
                            std::min(a.z, std::min(b.z, c.z)) - slack};
    const float upper[3] = {std::max(a.x, std::max(b.x, c.x)) + slack, std::max(a.y, std::max(b.y, c.y)) + slack,
                            std::max(a.z, std::max(b.z, c.z)) + slack};
    const float from[3] = {lower[0] - max_slack, lower[1] - max_slack, lower[2] - max_slack};
    const float to[3] = {upper[0] + max_slack, upper[1] + max_slack, upper[2] + max_slack};
    visit(from, to, [&](std::int32_t i) {
      const Float4& p = position[i];
      if (p.x < lower[0] - p.w || p.x > upper[0] + p.w || p.y < lower[1] - p.w || p.y > upper[1] + p.w ||
          p.z < lower[2] - p.w || p.z > upper[2] + p.w || i == face[0] || i == face[1] || i == face[2])
        return;
      Candidate candidate{};
      candidate.v[0] = i;
      for (int k = 0; k < 3; ++k) candidate.v[k + 1] = face[k];
      candidate.distance = thickness_;
      candidate.due = slack - thickness_ + p.w;
      pending.push_back(candidate);
    });
    if (pending.size() >= 64) keep(state.vertex_triangle, std::false_type{});
  }
  keep(state.vertex_triangle, std::false_type{});

  state.edge_edge.clear();
  centre.resize(topology_->edges.size());
  float half_size = 0.0f;
  for (std::size_t k = 0; k < topology_->edges.size(); ++k) {
    const Float4 &a = position[topology_->edges[k][0]], &b = position[topology_->edges[k][1]];
    centre[k] = {0.5f * (a.x + b.x), 0.5f * (a.y + b.y), 0.5f * (a.z + b.z), std::max(a.w, b.w)};
    half_size = std::max(half_size, 0.5f * std::max(std::abs(a.x - b.x), std::max(std::abs(a.y - b.y), std::abs(a.z - b.z))));
  }
  sort_into_cells(centre);
  for (std::size_t k = 0; k < topology_->edges.size(); ++k) {
    const auto& edge = topology_->edges[k];
    const Float4 &a = position[edge[0]], &b = position[edge[1]];
    const float slack = centre[k].w + edge_thickness_;
    const float lower[3] = {std::min(a.x, b.x) - slack, std::min(a.y, b.y) - slack, std::min(a.z, b.z) - slack};
    const float upper[3] = {std::max(a.x, b.x) + slack, std::max(a.y, b.y) + slack, std::max(a.z, b.z) + slack};
    const float grow = max_slack + half_size;
    const float from[3] = {lower[0] - grow, lower[1] - grow, lower[2] - grow};
    const float to[3] = {upper[0] + grow, upper[1] + grow, upper[2] + grow};
    visit(from, to, [&](std::int32_t j) {
      if (j <= static_cast<std::int32_t>(k)) return;
      const auto& other = topology_->edges[j];
      const Float4 &p = position[other[0]], &q = position[other[1]];
      const float s = centre[j].w;
      if (std::max(p.x, q.x) < lower[0] - s || std::min(p.x, q.x) > upper[0] + s || std::max(p.y, q.y) < lower[1] - s ||
          std::min(p.y, q.y) > upper[1] + s || std::max(p.z, q.z) < lower[2] - s || std::min(p.z, q.z) > upper[2] + s)
        return;
      if (edge[0] == other[0] || edge[0] == other[1] || edge[1] == other[0] || edge[1] == other[1]) return;
      Candidate candidate{};
      candidate.v[0] = edge[0], candidate.v[1] = edge[1], candidate.v[2] = other[0], candidate.v[3] = other[1];
      candidate.distance = edge_thickness_;
      candidate.due = slack - edge_thickness_ + s;
      pending.push_back(candidate);
    });
    if (pending.size() >= 64) keep(state.edge_edge, std::true_type{});
  }
  keep(state.edge_edge, std::true_type{});
  state.valid = true;
}

void SelfContact::activate(State& state, const Fixed4* fixed, double unit, const float* bound, const float* inverse_mass,
                           float dt, float block_seconds) const {
  state.active.clear();
  state.fast.clear();
  const float unit_f = static_cast<float>(unit);
  const float* path = state.path.data();
  const auto choose = [&](std::vector<Candidate>& list, std::int32_t offset, auto edges) {
    constexpr bool kEdges = decltype(edges)::value;
    const Candidate* group[8];
    int lanes = 0;
    const auto flush = [&] {
      if (lanes == 0) return;
      const Stored m(measure<kEdges>(group, lanes, fixed, unit_f));
      for (int lane = 0; lane < lanes; ++lane) {
        Candidate& c = list[group[lane] - list.data()];
        const float paths = (path[c.v[0]] + path[c.v[1]]) + (path[c.v[2]] + path[c.v[3]]);
        const float bounds = (bound[c.v[0]] + bound[c.v[1]]) + (bound[c.v[2]] + bound[c.v[3]]);
        const float gap = m.distance[lane];
        c.due = paths + (gap - c.distance);
        // Remember the side only from where it is certain; a new pair takes it from the geometry.
        for (int k = 0; k < 3; ++k) c.normal[k] = m.normal[k][lane];
        const bool near = bounds >= c.due && (!kEdges || m.inside[lane] != 0.0f);
        if (!near) {
          for (float& s : c.slip) s = 0.0f;
          c.present = c.distance;
          continue;
        }
        c.present = std::min(c.distance, c.present + kRecovery * block_seconds);
        c.present = std::min(c.present, std::max(gap, 0.0f) + kYield * c.distance);
        Active a;
        float along = 0.0f;
        for (int k = 0; k < 3; ++k) along += c.slip[k] * c.normal[k];
        for (int k = 0; k < 3; ++k) a.slip[k] = c.slip[k] - along * c.normal[k];
        for (int k = 0; k < 4; ++k) {
          a.v[k] = c.v[k];
          a.weight[k] = m.weight[k][lane];
        }
        for (int k = 0; k < 3; ++k) a.normal[k] = c.normal[k];
        a.distance = c.present;
        a.least = 0.5f * c.distance;
        a.touching = gap < a.distance;
        if (gap - a.least < bounds - paths) state.fast.push_back(static_cast<std::int32_t>(state.active.size()));
        a.candidate = offset + static_cast<std::int32_t>(&c - list.data());
        state.active.push_back(a);
      }
      lanes = 0;
    };
    for (Candidate& c : list) {
      const float bounds = (bound[c.v[0]] + bound[c.v[1]]) + (bound[c.v[2]] + bound[c.v[3]]);
      if (bounds < c.due) continue;
      group[lanes++] = &c;
      if (lanes == 8) flush();
    }
    flush();
  };
  choose(state.vertex_triangle, 0, std::false_type{});
  choose(state.edge_edge, static_cast<std::int32_t>(state.vertex_triangle.size()), std::true_type{});

  // Stiffness: Gershgorin over the pairs that share a vertex. With k_p = s min_i m_i / (2 W_i dt^2), W_i the sum of
  // |weight| of vertex i over its pairs, the rows of dt^2 M^-1 sum_p k_p g_p g_p^T sum to at most s.
  thread_local std::vector<float> load;
  load.assign(static_cast<std::size_t>(topology_->vertices), 0.0f);
  for (const Active& a : state.active)
    if (a.touching)
      for (int k = 0; k < 4; ++k) load[a.v[k]] += std::abs(a.weight[k]);
  const float per_dt2 = 1.0f / (dt * dt);
  for (Active& a : state.active) {
    float worst = 0.0f;
    for (int k = 0; k < 4; ++k) worst = std::max(worst, 2.0f * std::max(load[a.v[k]], kLeastLoad) * inverse_mass[a.v[k]]);
    const float mass = worst > 0.0f ? 1.0f / worst : 0.0f;
    a.stiffness = kSpring * mass * per_dt2;
    a.damping = kDashpot * mass / dt;
  }
}

void SelfContact::add_forces(State& state, const Fixed4* fixed, const Float4* v, double unit, float dt, Float4* forces) const {
  const __m128 scale = _mm_set1_ps(static_cast<float>(unit));
  std::int64_t touching = 0;
  for (std::size_t index = 0; index < state.active.size(); ++index) {
    Active& a = state.active[index];
    const auto position = [&](int k) { return _mm_load_si128(reinterpret_cast<const __m128i*>(fixed + a.v[k])); };
    const auto velocity = [&](int k) { return _mm_load_ps(&v[a.v[k]].x); };
    const __m128i p0 = position(0);
    __m128 r = _mm_mul_ps(_mm_set1_ps(a.weight[1]), _mm_cvtepi32_ps(_mm_sub_epi32(position(1), p0)));
    r = _mm_fmadd_ps(_mm_set1_ps(a.weight[2]), _mm_cvtepi32_ps(_mm_sub_epi32(position(2), p0)), r);
    r = _mm_fmadd_ps(_mm_set1_ps(a.weight[3]), _mm_cvtepi32_ps(_mm_sub_epi32(position(3), p0)), r);
    __m128 u = _mm_mul_ps(_mm_set1_ps(a.weight[0]), velocity(0));
    for (int k = 1; k < 4; ++k) u = _mm_fmadd_ps(_mm_set1_ps(a.weight[k]), velocity(k), u);
    const __m128 n = _mm_setr_ps(a.normal[0], a.normal[1], a.normal[2], 0.0f);
    const float gap = _mm_cvtss_f32(_mm_dp_ps(_mm_mul_ps(r, scale), n, 0x71));
    const float approach = _mm_cvtss_f32(_mm_dp_ps(u, n, 0x71));
    if (gap >= a.distance) {
      a.slip[0] = a.slip[1] = a.slip[2] = 0.0f;
      continue;
    }
    const float normal_force = std::max(0.0f, a.stiffness * (a.distance - gap) - a.damping * approach);
    if (normal_force > 0.0f) ++touching;
    // Tangential spring with slider.
    const __m128 tangential = _mm_sub_ps(u, _mm_mul_ps(_mm_set1_ps(approach), n));
    __m128 slip = _mm_fmadd_ps(_mm_set1_ps(dt), tangential, _mm_setr_ps(a.slip[0], a.slip[1], a.slip[2], 0.0f));
    __m128 pull = _mm_fmadd_ps(_mm_set1_ps(a.stiffness), slip, _mm_mul_ps(_mm_set1_ps(a.damping), tangential));
    const float size = std::sqrt(_mm_cvtss_f32(_mm_dp_ps(pull, pull, 0x71)));
    const float limit = friction_ * normal_force;
    if (size > limit) {
      pull = _mm_mul_ps(pull, _mm_set1_ps(limit / size));
      slip = a.stiffness > 0.0f ? _mm_mul_ps(pull, _mm_set1_ps(1.0f / a.stiffness)) : _mm_setzero_ps();
    }
    alignas(16) float stored[4];
    _mm_store_ps(stored, slip);
    for (int k = 0; k < 3; ++k) a.slip[k] = stored[k];
    const __m128 force = _mm_sub_ps(_mm_mul_ps(_mm_set1_ps(normal_force), n), pull);
    for (int k = 0; k < 4; ++k) {
      float* to = &forces[a.v[k]].x;
      _mm_store_ps(to, _mm_fmadd_ps(_mm_set1_ps(a.weight[k]), force, _mm_load_ps(to)));
    }
  }
  state.touching = touching;
}

void SelfContact::stop(const State& state, const Double4* x, const Fixed4* fixed, double unit, double dt, double floor,
                       const float* inverse_mass, Double4* v) const {
  constexpr int kPasses = 12;
  const double per_dt = 1.0 / dt;
  for (int pass = 0; pass < kPasses; ++pass) {
    bool changed = false;
    for (const std::int32_t index : state.fast) {
      const Active& a = state.active[index];
      double gap = 0.0, approach = 0.0, inverse = 0.0;
      const Fixed4& o = fixed[a.v[0]];
      for (int k = 0; k < 4; ++k) {
        const std::int32_t i = a.v[k];
        const Fixed4& p = fixed[i];
        const auto diff = [](std::int32_t s, std::int32_t t) {
          return static_cast<double>(static_cast<std::int32_t>(static_cast<std::uint32_t>(s) - static_cast<std::uint32_t>(t)));
        };
        const Double4& u = v[i];
        const double w = a.weight[k], nx = a.normal[0], ny = a.normal[1], nz = a.normal[2];
        // The ground comes after this and takes what is left of a downward velocity; here it counts as a wall.
        const double lowest = std::min(0.0, (floor - x[i].z) * per_dt);
        const bool blocked = u.z <= lowest && w * nz < 0.0;
        gap += w * unit * (diff(p.x, o.x) * nx + diff(p.y, o.y) * ny + diff(p.z, o.z) * nz);
        approach += w * (u.x * nx + u.y * ny + std::max(u.z, lowest) * nz);
        inverse += w * w * inverse_mass[i] * (nx * nx + ny * ny + (blocked ? 0.0 : nz * nz));
      }
      const double wanted = std::min(0.0, (a.least - gap) * per_dt);
      if (approach >= wanted - 1e-9 || inverse <= 1e-12) continue;
      const double impulse = (wanted - approach) / inverse;
      for (int k = 0; k < 4; ++k) {
        const double s = impulse * a.weight[k] * inverse_mass[a.v[k]];
        v[a.v[k]].x += s * a.normal[0];
        v[a.v[k]].y += s * a.normal[1];
        v[a.v[k]].z += s * a.normal[2];
      }
      changed = true;
    }
    if (!changed) break;
  }
}

void SelfContact::remember(State& state) const {
  const auto split = static_cast<std::int32_t>(state.vertex_triangle.size());
  for (const Active& a : state.active) {
    Candidate& c = a.candidate < split ? state.vertex_triangle[a.candidate] : state.edge_edge[a.candidate - split];
    for (int k = 0; k < 3; ++k) c.slip[k] = a.slip[k];
  }
}

}  // namespace weft::cloth
