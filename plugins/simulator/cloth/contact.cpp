#include "contact.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>

namespace weft::cloth {
namespace {

// Part of the explicit limit dt^2 lambda = 4 that contact takes besides the spring: 2 * 0.45 for the dashpot; the
// elements take 4 * 0.8^2 = 2.56 at the default step_safety.
constexpr float kDashpot = 0.45f;
// A vertex counts as if it carried at least this sum of |weight| (two layers give 2 to 4), and only pairs that touch
// count: pairs which come and go must not change the stiffness of the others. When fast approach brought in more pairs,
// springs were softer while compressed than while released, and resting layers bounced for ever.
constexpr float kLeastLoad = 6.0f;
// A pair pressed deeper than this part of its distance yields (keeps the gap it has) ...
constexpr float kYield = 0.25f;
// ... and recovers at this speed, m/s, so that separating layers gain no energy worth naming. (0.02 kept some folds
// from settling below 5 mm/s.)
constexpr float kRecovery = 0.003f;
// Edge pairs act at a smaller distance than vertices: in flat layers vertex-triangle pairs carry the load alone.
constexpr float kEdgePart = 0.8f;

// Slack of the candidates as a part of the mean edge: more of it finds more pairs, which all have to be looked at, less
// of it searches more often. From 0.02 to 0.06 there is little between them.
constexpr float kSlack = 0.05f;
// Candidates are good for this long at most, s; where a search is for few vertices, all are searched for after so long.
// (After a second, layers at rest had more than twice the candidates: whatever could touch in all that time.)
constexpr double kLongest = 1.0, kRenewal = 0.05;
// Where a search is for few vertices: those that have used this part of their slack, or whose path ends within this
// many frames, are searched for before they have to be.
constexpr float kNear = 0.25f;
constexpr double kSoon = 0.4;
// Of the table of remembered pairs: the upper half of a pair's key, and its place in the list. The last is never taken.
constexpr std::uint64_t kTag = 0xffffffff00000000ull, kFree = ~0ull;

struct Measured {
  F8 distance;  // m, negative: on the wrong side
  Vec8 normal;
  F8 weight[4];
  F8 inside;  // mask: closest points are interior to both primitives
};

inline Vec8 scaled(const Vec8& a, float s) { return splat(s) * a; }

Vec8 unit_vector(const Vec8& r, F8 length) { return (splat(1.0f) / max8(length, splat(1e-12f))) * r; }

/// What a pair's side is told by: its last normal, where known, within reach.
struct Memory {
  Vec8 normal;
  F8 known;  // mask
  F8 reach;  // m
};

/// Vertex against triangle; Ericson (2005, sec. 5.1.5) without branches: the interior projection where it exists, else
/// the nearest of the three edges.
/// @param memory null: the side is where the vertex stands.
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
    // Side: as remembered, else as it stands. Further than `reach` on the other side it has come round the border.
    // (A memory that lies in the triangle's plane, from an approach past the border, knows no side.)
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

/// Measures eight candidates on the sides that they remember.
template <bool kEdges>
Measured measure(SelfContact::Candidate* const (&list)[8], SelfContact::Contact* const (&contact)[8], const Fixed4* x,
                 float unit) {
  Memory memory;
  memory.normal = as_float(load8([&](int lane) { return contact[lane]->normal; }));
  memory.known = less(splat(0.5f), dot(memory.normal, memory.normal));
  const auto reach = [&](int lane) { return kEdges ? 0.5f * list[lane]->distance : list[lane]->distance; };
  memory.reach = _mm256_setr_ps(reach(0), reach(1), reach(2), reach(3), reach(4), reach(5), reach(6), reach(7));
  return measure<kEdges>([&](int k, int lane) { return list[lane]->v[k]; }, &memory, x, unit);
}

template <class Body>
[[gnu::always_inline]] inline void each_lane(unsigned mask, Body&& body) {
  for (; mask != 0; mask &= mask - 1) body(__builtin_ctz(mask));
}

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

double segment_distance2(const std::array<double, 2>& p, const std::array<double, 2>& a,
                         const std::array<double, 2>& b) {
  const double ux = b[0] - a[0], uy = b[1] - a[1], px = p[0] - a[0], py = p[1] - a[1];
  const double t = std::clamp((px * ux + py * uy) / (ux * ux + uy * uy), 0.0, 1.0);
  const double dx = px - t * ux, dy = py - t * uy;
  return dx * dx + dy * dy;
}

}  // namespace

SelfContact::SelfContact(const Topology& topology, const Fabric& fabric, float spring, std::int32_t piecewise)
    : topology_(&topology),
      thickness_(static_cast<float>(fabric.thickness_m)),
      edge_thickness_(kEdgePart * static_cast<float>(fabric.thickness_m)),
      friction_(static_cast<float>(fabric.self_friction)),
      spring_(spring),
      slack_(kSlack * static_cast<float>(topology.mean_edge)),
      piecewise_(piecewise) {
  make_patches();
}

/// Splits the faces of each component at the median of their rest centres until at most eight are left.
void SelfContact::make_patches() {
  const auto face_total = static_cast<std::int32_t>(topology_->faces.size());
  std::vector<std::int32_t> order(face_total);
  for (std::int32_t f = 0; f < face_total; ++f) order[f] = f;
  const auto component = [&](std::int32_t f) { return topology_->component[topology_->faces[f][0]]; };
  const auto centre = [&](std::int32_t f, int axis) {
    double sum = 0.0;
    for (const std::int32_t v : topology_->faces[f]) sum += topology_->rest[v][axis];
    return sum;
  };
  std::stable_sort(order.begin(), order.end(),
                   [&](std::int32_t f, std::int32_t g) { return component(f) < component(g); });

  std::vector<std::uint8_t> vertex_taken(topology_->vertices, 0), edge_taken(topology_->edges.size(), 0);
  const auto emit = [](std::vector<BoxBlock>& blocks, const std::vector<std::int32_t>& ids, std::int32_t(&range)[2],
                       auto&& corner) {
    range[0] = static_cast<std::int32_t>(blocks.size());
    for (std::size_t k = 0; k < ids.size(); ++k) {
      if (k % 8 == 0) {
        blocks.emplace_back();
        std::fill(std::begin(blocks.back().id), std::end(blocks.back().id), -1);
        for (int c = 0; c < 3; ++c)
          for (int lane = 0; lane < 8; ++lane) blocks.back().corner[c][lane] = corner(ids[k], c);
      }
      blocks.back().id[k % 8] = ids[k];
      for (int c = 0; c < 3; ++c) blocks.back().corner[c][k % 8] = corner(ids[k], c);
    }
    range[1] = static_cast<std::int32_t>(blocks.size());
  };
  std::vector<Node>& nodes = scratch_.nodes;
  const auto split = [&](auto&& self, std::int32_t begin, std::int32_t end) -> std::int32_t {
    const auto node = static_cast<std::int32_t>(nodes.size());
    nodes.push_back({});
    nodes[node].left = nodes[node].right = nodes[node].patch = -1;
    nodes[node].convex = nearly_convex({order.begin() + begin, order.begin() + end});
    if (end - begin <= 8) {
      std::vector<std::int32_t> faces(order.begin() + begin, order.begin() + end), vertices, edges;
      for (const std::int32_t f : faces) {
        for (int k = 0; k < 3; ++k) {
          const std::int32_t v = topology_->faces[f][k], w = topology_->faces[f][(k + 1) % 3];
          if (!vertex_taken[v]) vertex_taken[v] = 1, vertices.push_back(v);
          const std::array<std::int32_t, 2> edge{std::min(v, w), std::max(v, w)};
          const auto at = static_cast<std::int32_t>(
              std::lower_bound(topology_->edges.begin(), topology_->edges.end(), edge) - topology_->edges.begin());
          if (!edge_taken[at]) edge_taken[at] = 1, edges.push_back(at);
        }
      }
      Patch patch;
      emit(scratch_.faces, faces, patch.faces, [&](std::int32_t f, int c) { return topology_->faces[f][c]; });
      emit(scratch_.vertices, vertices, patch.vertices, [](std::int32_t v, int) { return v; });
      emit(scratch_.edges, edges, patch.edges, [&](std::int32_t e, int c) { return topology_->edges[e][c % 2]; });
      nodes[node].patch = static_cast<std::int32_t>(patches_.size());
      patches_.push_back(patch);
      return node;
    }
    double low[2] = {1e300, 1e300}, high[2] = {-1e300, -1e300};
    for (std::int32_t k = begin; k < end; ++k)
      for (int axis = 0; axis < 2; ++axis) {
        low[axis] = std::min(low[axis], centre(order[k], axis));
        high[axis] = std::max(high[axis], centre(order[k], axis));
      }
    const int axis = high[0] - low[0] >= high[1] - low[1] ? 0 : 1;
    // Whole patches of eight on the left, so that few lanes stay empty.
    const std::int32_t half = ((end - begin) / 2 + 7) / 8 * 8;
    const std::int32_t middle = begin + std::min(half, end - begin - 1);
    std::nth_element(order.begin() + begin, order.begin() + middle, order.begin() + end,
                     [&](std::int32_t f, std::int32_t g) {
                       const double p = centre(f, axis), q = centre(g, axis);
                       return p != q ? p < q : f < g;
                     });
    const std::int32_t left = self(self, begin, middle);
    const std::int32_t right = self(self, middle, end);
    nodes[node].left = left, nodes[node].right = right;
    return node;
  };
  // Components hang in a chain: a node over the first and the rest of them.
  const auto chain = [&](auto&& self, std::int32_t begin) -> std::int32_t {
    std::int32_t end = begin;
    while (end < face_total && component(order[end]) == component(order[begin])) ++end;
    if (end == face_total) return split(split, begin, end);
    const auto node = static_cast<std::int32_t>(nodes.size());
    nodes.push_back({});
    nodes[node].patch = -1;
    nodes[node].convex = false;
    const std::int32_t left = split(split, begin, end);
    const std::int32_t right = self(self, end);
    nodes[node].left = left, nodes[node].right = right;
    return node;
  };
  chain(chain, 0);
  scratch_.sums.resize(nodes.size());
  scratch_.boxed.resize(patches_.size());
}

/// One connected piece whose area fills its convex hull to 85 %, without cuts: every border edge lies at the hull.
bool SelfContact::nearly_convex(const std::vector<std::int32_t>& faces) const {
  using Point = std::array<double, 2>;
  std::vector<Point> points;
  double area = 0.0;
  for (const std::int32_t f : faces) {
    area += topology_->area[f];
    for (const std::int32_t v : topology_->faces[f]) points.push_back(topology_->rest[v]);
  }
  std::sort(points.begin(), points.end());
  points.erase(std::unique(points.begin(), points.end()), points.end());
  const auto turn = [](const Point& o, const Point& a, const Point& b) {
    return (a[0] - o[0]) * (b[1] - o[1]) - (a[1] - o[1]) * (b[0] - o[0]);
  };
  std::vector<Point> hull;  // Andrew's monotone chain
  for (int side = 0; side < 2; ++side) {
    const std::size_t start = hull.size();
    for (const Point& p : points) {
      while (hull.size() >= start + 2 && turn(hull[hull.size() - 2], hull.back(), p) <= 0.0) hull.pop_back();
      hull.push_back(p);
    }
    hull.pop_back();
    std::reverse(points.begin(), points.end());
  }
  double hull_area = 0.0;
  for (std::size_t k = 0; k < hull.size(); ++k)
    hull_area += 0.5 * turn({0.0, 0.0}, hull[k], hull[(k + 1) % hull.size()]);
  if (area < 0.85 * hull_area) return false;
  const double near = 0.5 * topology_->max_edge;
  std::vector<std::int32_t> sorted(faces), seen(faces.size(), 0), stack{0};
  std::sort(sorted.begin(), sorted.end());
  for (const std::int32_t f : faces)
    for (int k = 0; k < 3; ++k) {
      if (topology_->opposite[f][k] >= 0) continue;
      const Point &a = topology_->rest[topology_->faces[f][(k + 1) % 3]],
                  &b = topology_->rest[topology_->faces[f][(k + 2) % 3]];
      const Point middle{0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])};
      double best = 1e300;
      for (std::size_t j = 0; j < hull.size(); ++j)
        best = std::min(best, segment_distance2(middle, hull[j], hull[(j + 1) % hull.size()]));
      if (best > near * near) return false;
    }
  // Connected through shared vertices, counted over the faces around each vertex.
  std::size_t reached = 1;
  seen[0] = 1;
  while (!stack.empty()) {
    const std::int32_t f = sorted[stack.back()];
    stack.pop_back();
    for (const std::int32_t v : topology_->faces[f])
      for (std::int32_t k = topology_->face_of_vertex_start[v]; k < topology_->face_of_vertex_start[v + 1]; ++k) {
        const auto at = std::lower_bound(sorted.begin(), sorted.end(), topology_->face_of_vertex[k]) - sorted.begin();
        if (at == static_cast<std::ptrdiff_t>(sorted.size()) || sorted[at] != topology_->face_of_vertex[k] || seen[at])
          continue;
        seen[at] = 1;
        ++reached;
        stack.push_back(static_cast<std::int32_t>(at));
      }
  }
  return reached == faces.size();
}

double SelfContact::longest_step(double g, double part) const {
  // k depth = m g with k = spring_ m / (2 kLeastLoad dt^2).
  return std::sqrt(part * thickness_ * spring_ / (2.0 * kLeastLoad * std::max(g, 1e-9)));
}

void SelfContact::clear(State& state) const {
  const auto n = static_cast<std::size_t>(topology_->vertices);
  state.valid = false;
  state.vertex_triangle.clear();
  state.edge_edge.clear();
  state.vertex_triangle.reserve(16 * n);
  state.edge_edge.reserve(32 * n);
  scratch_.active.reserve(16 * n);
  scratch_.soon_faces.reserve(16 * n);
  scratch_.soon_edges.reserve(32 * n);
  scratch_.fast.reserve(16 * n);
  state.path.assign(padded(n), 0.0f);
  state.start.assign(n, Double4{});
  state.drift.assign(n, Double4{});
  state.until.assign(n, 0.0);
  state.elapsed = state.horizon = state.renewal = 0.0;
  state.flat.assign(scratch_.nodes.size(), 0);
  state.touching = 0;
  scratch_.old.reserve(48 * n);
  scratch_.pending_faces.blocks.resize(kMostPending / 8);
  scratch_.pending_edges.blocks.resize(kMostPending / 8);
  scratch_.table.reserve(128 * n);
  scratch_.met.reserve(16 * scratch_.nodes.size());
  scratch_.position.resize(n);
  scratch_.later.resize(n);
  scratch_.drift.resize(n);
  scratch_.strayed.resize(n);
  scratch_.load.resize(n);
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
    d2 = std::min(std::min(segment_distance2(rest[v[0]], rest[v[2]], rest[v[3]]),
                           segment_distance2(rest[v[1]], rest[v[2]], rest[v[3]])),
                  std::min(segment_distance2(rest[v[2]], rest[v[0]], rest[v[1]]),
                           segment_distance2(rest[v[3]], rest[v[0]], rest[v[1]])));
  } else {
    d2 = std::min(segment_distance2(rest[v[0]], rest[v[1]], rest[v[2]]),
                  std::min(segment_distance2(rest[v[0]], rest[v[2]], rest[v[3]]),
                           segment_distance2(rest[v[0]], rest[v[1]], rest[v[3]])));
  }
  return std::min(full, static_cast<float>(0.7 * std::sqrt(d2)));
}

/// Whether a vertex whose nearest point of a triangle lies on its border has a nearer point beyond that border: over
/// the next triangle, which is a pair of its own. Such a pair must not act. Its direction leans back while the vertex
/// nears the border and forward after it, and with the dashpot that would brake sliding layers (by 20 % of the
/// acceleration at 1 m/s).
bool SelfContact::elsewhere(const Candidate& pair, const float (&weight)[4], const Fixed4* fixed) const {
  struct Vec {
    float x, y, z;
    float dot(const Vec& o) const { return x * o.x + y * o.y + z * o.z; }
  };
  const auto from = [&](std::int32_t a, std::int32_t b) {  // in fixed-point units
    const auto diff = [](std::int32_t s, std::int32_t t) {
      return static_cast<float>(
          static_cast<std::int32_t>(static_cast<std::uint32_t>(s) - static_cast<std::uint32_t>(t)));
    };
    const Fixed4 &p = fixed[a], &q = fixed[b];
    return Vec{diff(q.x, p.x), diff(q.y, p.y), diff(q.z, p.z)};
  };
  int zeros = 0, zero = 0, one = 0;
  for (int k = 0; k < 3; ++k) {
    if (weight[k + 1] > -1e-6f)
      ++zeros, zero = k;
    else
      one = k;
  }
  if (zeros == 1) {
    const std::int32_t across = topology_->opposite[pair.face][zero];
    if (across < 0 || across == pair.v[0]) return false;
    const std::int32_t a = pair.v[1 + (zero + 1) % 3], b = pair.v[1 + (zero + 2) % 3];
    const Vec e = from(a, b), p = from(a, pair.v[0]), o = from(a, across);
    const float along = o.dot(e) / e.dot(e);
    return p.dot({o.x - along * e.x, o.y - along * e.y, o.z - along * e.z}) > 0.0f;
  }
  if (zeros == 2) {
    const std::int32_t corner = pair.v[1 + one];
    const Vec p = from(corner, pair.v[0]);
    for (std::int32_t k = topology_->face_of_vertex_start[corner]; k < topology_->face_of_vertex_start[corner + 1];
         ++k) {
      const auto& face = topology_->faces[topology_->face_of_vertex[k]];
      if (face[0] == pair.v[0] || face[1] == pair.v[0] || face[2] == pair.v[0]) continue;
      for (const std::int32_t other : face)
        if (other != corner && p.dot(from(corner, other)) > 0.0f) return true;
    }
  }
  return false;
}

void SelfContact::prepare(State& state, const Double4* x, const Double4* v, const Fixed4* fixed, double unit,
                          double block_seconds) const {
  if (!state.valid || state.elapsed + block_seconds > state.horizon)
    find_candidates(state, x, v, fixed, unit, block_seconds);
}

/// Marks the vertices that are not near their path any more, or not until the block's end. A vertex that has used a
/// part of its slack would be next. @return whether candidates are searched for all.
bool SelfContact::choose_strayed(State& state, const Double4* x, double block_seconds) const {
  const std::int32_t n = topology_->vertices;
  const double end = state.elapsed + block_seconds, soon = end + kSoon * kFrameSeconds;
  const double near = std::pow(kNear * static_cast<double>(slack_), 2);
  bool all = n < piecewise_ || end > state.renewal;
  if (!all) {
    const __m256d elapsed = _mm256_set1_pd(state.elapsed);
    std::int32_t count = 0;
    for (std::int32_t i = 0; i < n; ++i) {
      const __m256d off =
          _mm256_sub_pd(load(x[i]), _mm256_fmadd_pd(load(state.drift[i]), elapsed, load(state.start[i])));
      Double4 square;
      store(square, _mm256_mul_pd(off, off));
      scratch_.strayed[i] = square.x + square.y + square.z > near || state.until[i] < soon;
      count += scratch_.strayed[i];
    }
    all = 2 * count > n;
  }
  if (all) {
    std::fill(scratch_.strayed.begin(), scratch_.strayed.end(), std::uint8_t{1});
    std::fill(state.path.begin(), state.path.end(), 0.0f);
    state.elapsed = 0.0;
  }
  return all;
}

/// Moves the pairs with a marked vertex out of the candidates: to scratch_.old those whose side or slip is known.
void SelfContact::forget_strayed(State& state) const {
  Pairs& old = scratch_.old;
  const std::uint8_t* strayed = scratch_.strayed.data();
  old.clear();
  for (Pairs* list : {&state.vertex_triangle, &state.edge_edge}) {
    std::size_t kept = 0;
    for (std::size_t k = 0; k < list->size(); ++k) {
      const Candidate& c = list->candidate[k];
      if (strayed[c.v[0]] | strayed[c.v[1]] | strayed[c.v[2]] | strayed[c.v[3]]) {
        if (list->contact[k].met()) old.add(c, list->contact[k]);
        continue;
      }
      if (kept < k) {
        list->candidate[kept] = c;
        list->contact[kept] = list->contact[k];
      }
      ++kept;
    }
    list->candidate.resize(kept);
    list->contact.resize(kept);
    if (list == &state.vertex_triangle) scratch_.old_vertex_triangle = old.size();
  }
  std::vector<std::uint64_t>& table = scratch_.table;  // by key, open addressing
  std::size_t size = 64;
  while (size < 2 * old.size()) size *= 2;
  table.assign(size, kFree);
  for (std::size_t k = 0; k < old.size(); ++k) {
    const std::uint64_t key = key_of(old.candidate[k].v, k >= scratch_.old_vertex_triangle);
    std::size_t at = key & (size - 1);
    while (table[at] != kFree) at = (at + 1) & (size - 1);
    table[at] = (key & kTag) | k;
  }
}

/// @return whether the pair was known; then all but `due` is as it was.
bool SelfContact::recall(Candidate& c, Contact& contact, bool edges) const {
  const std::vector<std::uint64_t>& table = scratch_.table;
  const std::size_t last = table.size() - 1;
  const std::uint64_t key = key_of(c.v, edges);
  for (std::size_t at = key & last; table[at] != kFree; at = (at + 1) & last) {
    if ((table[at] ^ key) & kTag) continue;
    const auto k = static_cast<std::size_t>(table[at] & ~kTag);
    const Candidate& o = scratch_.old.candidate[k];
    if ((k >= scratch_.old_vertex_triangle) != edges || std::memcmp(o.v, c.v, sizeof c.v) != 0) continue;
    contact = scratch_.old.contact[k];
    c.present = o.present;
    c.distance = o.distance;
    return true;
  }
  return false;
}

/// Marks all vertices of a node.
void SelfContact::mark(std::int32_t node) const {
  const Node& at = scratch_.nodes[node];
  if (at.patch < 0) {
    mark(at.left);
    mark(at.right);
    return;
  }
  for (const auto& corner : scratch_.faces[patches_[at.patch].faces[0]].corner)
    for (const std::int32_t i : corner) scratch_.strayed[i] = 1;
}

/// After mark(): the marks of blocks and nodes.
void SelfContact::spread_marks() const {
  for (std::size_t index = scratch_.nodes.size(); index-- > 0;) {
    Node& node = scratch_.nodes[index];
    if (node.patch >= 0) {
      BoxBlock& block = scratch_.faces[patches_[node.patch].faces[0]];
      mark_lanes(block, 3);
      node.strayed = block.strayed != 0;
    } else {
      node.strayed = scratch_.nodes[node.left].strayed || scratch_.nodes[node.right].strayed;
    }
  }
}

void SelfContact::mark_lanes(BoxBlock& block, int corners) const {
  block.strayed = 0;
  for (int k = 0; k < corners; ++k)
    for (int lane = 0; lane < 8; ++lane)
      block.strayed |= static_cast<unsigned>(scratch_.strayed[block.corner[k][lane]]) << lane;
}

void SelfContact::find_candidates(State& state, const Double4* x, const Double4* v, const Fixed4* fixed, double unit,
                                  double block_seconds) const {
  const std::int32_t n = topology_->vertices;
  const bool all = choose_strayed(state, x, block_seconds);
  std::vector<std::uint8_t>& strayed = scratch_.strayed;
  double low[3] = {1e300, 1e300, 1e300}, fastest = 0.0;
  for (std::int32_t i = 0; i < n; ++i) {
    low[0] = std::min(low[0], x[i].x), low[1] = std::min(low[1], x[i].y), low[2] = std::min(low[2], x[i].z);
    fastest = std::max(fastest, v[i].x * v[i].x + v[i].y * v[i].y + v[i].z * v[i].z);
  }
  // A path is good for a frame, or longer where little moves: in a search for few vertices each for itself.
  const auto longest = [&](double speed) {
    return std::clamp(slack_ / std::max(speed, 1e-9), kFrameSeconds, kLongest);
  };
  const double common = longest(std::sqrt(fastest));
  if (all) state.renewal = n < piecewise_ ? common : kRenewal;
  state.horizon = kLongest;
  std::vector<Float4>&position = scratch_.position, &later = scratch_.later, &drift = scratch_.drift;
  for (std::int32_t i = 0; i < n; ++i) {
    Double4 &start = state.start[i], &u = state.drift[i];
    Double4 now = x[i];
    if (strayed[i]) {
      u = v[i];
      start = {x[i].x - state.elapsed * u.x, x[i].y - state.elapsed * u.y, x[i].z - state.elapsed * u.z, 0.0};
      const double speed = std::sqrt(u.x * u.x + u.y * u.y + u.z * u.z);
      const double mine = n < piecewise_ ? common : longest(speed);
      state.until[i] = std::min(state.elapsed + mine, state.renewal);
    } else {
      now = {start.x + state.elapsed * u.x, start.y + state.elapsed * u.y, start.z + state.elapsed * u.z, 0.0};
    }
    state.horizon = std::min(state.horizon, state.until[i]);
    const auto rest = static_cast<float>(state.until[i] - state.elapsed);
    position[i] = {static_cast<float>(now.x - low[0]), static_cast<float>(now.y - low[1]),
                   static_cast<float>(now.z - low[2]), 0.0f};
    drift[i] = {static_cast<float>(u.x), static_cast<float>(u.y), static_cast<float>(u.z), rest};
    later[i] = {position[i].x + rest * drift[i].x, position[i].y + rest * drift[i].y, position[i].z + rest * drift[i].z,
                0.0f};
  }
  Pending &pending_faces = scratch_.pending_faces, &pending_edges = scratch_.pending_edges;
  pending_faces.count = pending_edges.count = 0;
  const float unit_f = static_cast<float>(unit);
  // Measures the pending pairs and keeps those that can touch. What is not searched for may be off its path now, by a
  // part of its slack, and by all of it later. A pair that remembers its side is due at once: measured here without its
  // memory, the distance has no sign.
  const auto keep = [&](Pairs& out, auto edges, int least) {
    constexpr bool kEdges = decltype(edges)::value;
    constexpr int kSplit = kEdges ? 2 : 1;
    Pending& pending = kEdges ? pending_edges : pending_faces;
    if (pending.count < least) return;
    const F8 touching = splat(kEdges ? edge_thickness_ : thickness_),
             both_slack = splat((all ? 2.0f : 2.0f + 2.0f * kNear) * slack_);
    for (int first = 0; first < pending.count; first += 8) {
      PairBlock& block = pending.blocks[first / 8];
      const int lanes = std::min(8, pending.count - first);
      for (int lane = lanes; lane < 8; ++lane)
        for (auto& column : block.v) column[lane] = column[0];
      const Measured m = measure<kEdges>([&](int k, int lane) { return block.v[k][lane]; }, nullptr, fixed, unit_f);
      const F8 apart = (m.distance - touching) - both_slack;
      F8 out_of_reach = less(_mm256_setzero_ps(), apart);
      if (_mm256_movemask_ps(out_of_reach) != 0) {
        Vec8 u[4];
        F8 rest = splat(kLongest);  // until the first of the four is searched for again
        for (int k = 0; k < 4; ++k) {
          u[k] = load8(drift.data(), block.v[k]);
          rest = min8(rest, load_w8(drift.data(), block.v[k]));
        }
        F8 square = _mm256_setzero_ps();  // largest relative speed squared
        for (int p = 0; p < kSplit; ++p)
          for (int q = kSplit; q < 4; ++q) {
            const Vec8 parting = u[p] - u[q];
            square = max8(square, parting.x * parting.x + parting.y * parting.y + parting.z * parting.z);
          }
        out_of_reach = both(out_of_reach, less(square * rest * rest, apart * apart));
      }
      alignas(32) float distance[8];
      _mm256_store_ps(distance, m.distance);
      each_lane(~static_cast<unsigned>(_mm256_movemask_ps(out_of_reach)) & ((1u << lanes) - 1u), [&](int lane) {
        Candidate c{};
        for (int k = 0; k < 4; ++k) c.v[k] = block.v[k][lane];
        c.face = block.face[lane];
        c.present = -1.0f;
        Contact contact{{}, std::numeric_limits<float>::infinity(), {}};
        if (!recall(c, contact, kEdges)) c.distance = pair_distance(c.v, kEdges);
        const float paths = (state.path[c.v[0]] + state.path[c.v[1]]) + (state.path[c.v[2]] + state.path[c.v[3]]);
        c.due = contact.met() ? 0.0f : paths + (distance[lane] - c.distance);
        out.add(c, contact);
      });
    }
    pending.count = 0;
  };

  // Boxes around now and later, grown by slack and half the thickness: pairs whose boxes meet can come within
  // thickness.
  const F8 grown = splat(slack_ + 0.5f * thickness_);
  const auto fill = [&](BoxBlock& block, auto corners) {
    Vec8 low8 = load8(position.data(), block.corner[0]), high8 = low8;
    const auto add = [&](const Vec8& p) {
      low8 = {min8(low8.x, p.x), min8(low8.y, p.y), min8(low8.z, p.z)};
      high8 = {max8(high8.x, p.x), max8(high8.y, p.y), max8(high8.z, p.z)};
    };
    add(load8(later.data(), block.corner[0]));
    for (int k = 1; k < decltype(corners)::value; ++k) {
      add(load8(position.data(), block.corner[k]));
      add(load8(later.data(), block.corner[k]));
    }
    const F8 empty = _mm256_castsi256_ps(_mm256_load_si256(reinterpret_cast<const I8*>(block.id)));  // sign bit
    const F8 inverted = splat(1e30f), deflated = splat(-1e30f);
    const auto write = [&](float(&to)[8], F8 value, F8 none) {
      _mm256_store_ps(to, _mm256_blendv_ps(value, none, empty));
    };
    write(block.low[0], low8.x - grown, inverted), write(block.high[0], high8.x + grown, deflated);
    write(block.low[1], low8.y - grown, inverted), write(block.high[1], high8.y + grown, deflated);
    write(block.low[2], low8.z - grown, inverted), write(block.high[2], high8.z + grown, deflated);
    mark_lanes(block, decltype(corners)::value);
  };
  std::fill(scratch_.boxed.begin(), scratch_.boxed.end(), std::uint8_t{0});
  const auto box_patch = [&](std::int32_t index) {  // vertices and edges, when they are first asked for
    if (scratch_.boxed[index]) return;
    scratch_.boxed[index] = 1;
    for (std::int32_t b = patches_[index].vertices[0]; b < patches_[index].vertices[1]; ++b)
      fill(scratch_.vertices[b], std::integral_constant<int, 1>{});
    for (std::int32_t b = patches_[index].edges[0]; b < patches_[index].edges[1]; ++b)
      fill(scratch_.edges[b], std::integral_constant<int, 2>{});
  };
  struct Box {
    F8 low[3], high[3];  // one box in all lanes
  };
  const auto lane_box = [](const BoxBlock& block, int lane) {
    Box box;
    for (int k = 0; k < 3; ++k) box.low[k] = splat(block.low[k][lane]), box.high[k] = splat(block.high[k][lane]);
    return box;
  };
  const auto meet = [](const Box& box, const BoxBlock& block) {
    F8 apart = _mm256_setzero_ps();
    for (int k = 0; k < 3; ++k) {
      apart = _mm256_or_ps(apart, _mm256_cmp_ps(box.low[k], _mm256_load_ps(block.high[k]), _CMP_GT_OQ));
      apart = _mm256_or_ps(apart, _mm256_cmp_ps(_mm256_load_ps(block.low[k]), box.high[k], _CMP_GT_OQ));
    }
    return ~static_cast<unsigned>(_mm256_movemask_ps(apart)) & 0xffu;
  };
  // Boxes and cones, children first. Until the next search a normal turns by at most what its corners move against one
  // another, over the height of the face.
  std::vector<Node>& nodes = scratch_.nodes;
  constexpr float kFlat = 1.4f;  // rad
  for (std::size_t index = nodes.size(); index-- > 0;) {
    Node& node = nodes[index];
    Float4& sum = scratch_.sums[index];
    if (node.patch >= 0) {
      BoxBlock& block = scratch_.faces[patches_[node.patch].faces[0]];  // at most eight faces: one block
      fill(block, std::integral_constant<int, 3>{});
      for (int k = 0; k < 3; ++k) {
        node.low[k] = *std::min_element(block.low[k], block.low[k] + 8);
        node.high[k] = *std::max_element(block.high[k], block.high[k] + 8);
      }
      // Empty lanes repeat the first face: that changes the axis a little, and no bound.
      const Vec8 a = load8(position.data(), block.corner[1]) - load8(position.data(), block.corner[0]);
      const Vec8 c = load8(position.data(), block.corner[2]) - load8(position.data(), block.corner[0]);
      const Vec8 u = load8(drift.data(), block.corner[1]) - load8(drift.data(), block.corner[0]);
      const Vec8 w = load8(drift.data(), block.corner[2]) - load8(drift.data(), block.corner[0]);
      Vec8 m = cross(a, c);
      const F8 twice_area = max8(_mm256_sqrt_ps(dot(m, m)), splat(1e-20f));
      m = (splat(1.0f) / twice_area) * m;
      const Vec8 ac = c - a, uw = w - u;
      const F8 longest_edge = _mm256_sqrt_ps(max8(dot(a, a), max8(dot(c, c), dot(ac, ac))));
      const F8 parted = _mm256_sqrt_ps(max8(dot(u, u), max8(dot(w, w), dot(uw, uw))));
      F8 rest = _mm256_setzero_ps();
      for (const auto& corner : block.corner) rest = max8(rest, load_w8(drift.data(), corner));
      const F8 turning = fma(parted, rest, splat(2.0f * slack_)) * longest_edge / twice_area;
      node.strayed = block.strayed != 0;
      const auto total = [](F8 lanes) {
        alignas(32) float t[8];
        _mm256_store_ps(t, lanes);
        return ((t[0] + t[1]) + (t[2] + t[3])) + ((t[4] + t[5]) + (t[6] + t[7]));
      };
      sum = {total(m.x), total(m.y), total(m.z), 0.0f};
      const float scale = 1.0f / std::max(1e-20f, std::sqrt(sum.x * sum.x + sum.y * sum.y + sum.z * sum.z));
      node.axis[0] = sum.x * scale, node.axis[1] = sum.y * scale, node.axis[2] = sum.z * scale;
      const F8 cosine = dot(m, {splat(node.axis[0]), splat(node.axis[1]), splat(node.axis[2])});
      alignas(32) float cosines[8], turnings[8];
      _mm256_store_ps(cosines, cosine);
      _mm256_store_ps(turnings, turning);
      node.angle = std::acos(std::clamp(*std::min_element(cosines, cosines + 8), -1.0f, 1.0f)) +
                   *std::max_element(turnings, turnings + 8);
    } else {
      const Node &l = nodes[node.left], &r = nodes[node.right];
      node.strayed = l.strayed || r.strayed;
      const Float4 &sl = scratch_.sums[node.left], &sr = scratch_.sums[node.right];
      for (int k = 0; k < 3; ++k)
        node.low[k] = std::min(l.low[k], r.low[k]), node.high[k] = std::max(l.high[k], r.high[k]);
      sum = {sl.x + sr.x, sl.y + sr.y, sl.z + sr.z, 0.0f};
      const float scale = 1.0f / std::max(1e-20f, std::sqrt(sum.x * sum.x + sum.y * sum.y + sum.z * sum.z));
      node.axis[0] = sum.x * scale, node.axis[1] = sum.y * scale, node.axis[2] = sum.z * scale;
      if (l.angle > kFlat || r.angle > kFlat) {
        node.angle = 10.0f;
        continue;
      }
      const auto tilt = [&](const Node& child) {
        const float c = child.axis[0] * node.axis[0] + child.axis[1] * node.axis[1] + child.axis[2] * node.axis[2];
        return std::acos(std::clamp(c, -1.0f, 1.0f)) + child.angle;
      };
      node.angle = std::max(tilt(l), tilt(r));
    }
  }

  // Nothing was searched in a node that was flat. Where it is so no more, all of it is.
  const auto flat = [&](const Node& node) { return node.convex && node.angle < kFlat; };
  for (bool more = !all; more;) {
    more = false;
    for (std::size_t index = 0; index < nodes.size(); ++index)
      if (nodes[index].strayed && state.flat[index] && !flat(nodes[index])) {
        state.flat[index] = 0;
        mark(static_cast<std::int32_t>(index));
        more = true;
      }
    if (more) spread_marks();
  }
  for (std::size_t index = 0; index < nodes.size(); ++index)
    if (nodes[index].strayed) state.flat[index] = flat(nodes[index]);
  forget_strayed(state);
  const auto equal = [](std::int32_t i, const std::int32_t(&lanes)[8]) {
    const I8 same = _mm256_cmpeq_epi32(_mm256_set1_epi32(i), _mm256_load_si256(reinterpret_cast<const I8*>(lanes)));
    return static_cast<unsigned>(_mm256_movemask_ps(_mm256_castsi256_ps(same)));
  };
  const auto above = [](std::int32_t i, const std::int32_t(&lanes)[8]) {
    const I8 more = _mm256_cmpgt_epi32(_mm256_load_si256(reinterpret_cast<const I8*>(lanes)), _mm256_set1_epi32(i));
    return static_cast<unsigned>(_mm256_movemask_ps(_mm256_castsi256_ps(more)));
  };
  const auto vertices_against_faces = [&](const Patch& first, const Patch& second, const Box& second_box,
                                          bool second_strayed) {
    for (std::int32_t b = first.vertices[0]; b < first.vertices[1]; ++b) {
      const unsigned searched_lanes = second_strayed ? 0xffu : scratch_.vertices[b].strayed;
      if (searched_lanes == 0) continue;
      each_lane(meet(second_box, scratch_.vertices[b]) & searched_lanes, [&](int lane) {
        const Box box = lane_box(scratch_.vertices[b], lane);
        const std::int32_t i = scratch_.vertices[b].id[lane];
        const bool searched = (scratch_.vertices[b].strayed >> lane & 1u) != 0;
        for (std::int32_t c = second.faces[0]; c < second.faces[1]; ++c) {
          const BoxBlock& block = scratch_.faces[c];
          unsigned mask = meet(box, block);
          if (!searched) mask &= block.strayed;
          if (mask == 0) continue;
          for (int k = 0; k < 3; ++k) mask &= ~equal(i, block.corner[k]);
          each_lane(mask, [&](int other) {
            pending_faces.add({i, block.corner[0][other], block.corner[1][other], block.corner[2][other]},
                              block.id[other]);
          });
        }
      });
    }
  };
  const auto edges_against_edges = [&](const Patch& first, const Patch& second, const Box& first_box,
                                       const Box& second_box, bool second_strayed, bool same) {
    unsigned reached[4];  // of the second's edges
    for (std::int32_t c = second.edges[0]; c < second.edges[1]; ++c)
      reached[c - second.edges[0]] = meet(first_box, scratch_.edges[c]);
    for (std::int32_t b = first.edges[0]; b < first.edges[1]; ++b) {
      const unsigned searched_lanes = second_strayed ? 0xffu : scratch_.edges[b].strayed;
      if (searched_lanes == 0) continue;
      each_lane(meet(second_box, scratch_.edges[b]) & searched_lanes, [&](int lane) {
        const Box box = lane_box(scratch_.edges[b], lane);
        const std::int32_t e = scratch_.edges[b].id[lane];
        const bool searched = (scratch_.edges[b].strayed >> lane & 1u) != 0;
        const std::int32_t e0 = scratch_.edges[b].corner[0][lane], e1 = scratch_.edges[b].corner[1][lane];
        for (std::int32_t c = second.edges[0]; c < second.edges[1]; ++c) {
          const BoxBlock& block = scratch_.edges[c];
          unsigned mask = reached[c - second.edges[0]];
          if (mask == 0) continue;
          mask &= meet(box, block);
          if (!searched) mask &= block.strayed;
          if (mask == 0) continue;
          if (same) mask &= above(e, block.id);
          for (int k = 0; k < 2; ++k) mask &= ~(equal(e0, block.corner[k]) | equal(e1, block.corner[k]));
          each_lane(mask, [&](int other) {
            const std::int32_t g0 = block.corner[0][other], g1 = block.corner[1][other];
            if (block.id[other] < e)  // one order for a pair, so that its memory is found again
              pending_edges.add({g0, g1, e0, e1}, -1);
            else
              pending_edges.add({e0, e1, g0, g1}, -1);
          });
        }
      });
    }
  };
  const auto node_box = [](const Node& node) {
    Box box;
    for (int k = 0; k < 3; ++k) box.low[k] = splat(node.low[k]), box.high[k] = splat(node.high[k]);
    return box;
  };
  const auto leaves = [&](const Node& first, const Node& second, bool same) {
    const Patch &p = patches_[first.patch], &q = patches_[second.patch];
    box_patch(first.patch);
    box_patch(second.patch);
    const Box p_box = node_box(first), q_box = node_box(second);
    vertices_against_faces(p, q, q_box, second.strayed);
    if (!same) vertices_against_faces(q, p, p_box, first.strayed);
    keep(state.vertex_triangle, std::false_type{}, 64);
    edges_against_edges(p, q, p_box, q_box, second.strayed, same);
    keep(state.edge_edge, std::true_type{}, 64);
  };
  std::vector<std::array<std::int32_t, 2>>& met = scratch_.met;  // leaves
  met.clear();
  const auto pair = [&](auto&& self, std::int32_t i, std::int32_t j) -> void {
    const Node &a = nodes[i], &b = nodes[j];
    if (!a.strayed && !b.strayed) return;
    for (int k = 0; k < 3; ++k)
      if (a.low[k] > b.high[k] || b.low[k] > a.high[k]) return;
    if (a.patch >= 0 && b.patch >= 0) {
      met.push_back({i, j});
      return;
    }
    const auto extent = [](const Node& node) {
      return node.patch >= 0 ? -1.0f
                             : std::max(node.high[0] - node.low[0],
                                        std::max(node.high[1] - node.low[1], node.high[2] - node.low[2]));
    };
    if (extent(a) >= extent(b)) {
      self(self, a.left, j);
      self(self, a.right, j);
    } else {
      self(self, i, b.left);
      self(self, i, b.right);
    }
  };
  const auto alone = [&](auto&& self, std::int32_t i) -> void {
    const Node& a = nodes[i];
    if (!a.strayed || state.flat[i]) return;
    if (a.patch >= 0) {
      met.push_back({i, i});
      return;
    }
    self(self, a.left);
    self(self, a.right);
    pair(pair, a.left, a.right);
  };
  alone(alone, 0);
  // Their boxes are strewn over more memory than the near caches hold.
  const auto fetch = [&](std::int32_t node) {
    const Patch& patch = patches_[nodes[node].patch];
    const auto blocks = [](const std::vector<BoxBlock>& list, const std::int32_t(&range)[2]) {
      const auto* end = reinterpret_cast<const char*>(list.data() + range[1]);
      for (auto* line = reinterpret_cast<const char*>(list.data() + range[0]); line < end; line += 64)
        __builtin_prefetch(line);
    };
    blocks(scratch_.faces, patch.faces);
    blocks(scratch_.vertices, patch.vertices);
    blocks(scratch_.edges, patch.edges);
  };
  constexpr std::size_t kAhead = 2;
  for (std::size_t k = 0; k < met.size(); ++k) {
    if (k + kAhead < met.size()) {
      fetch(met[k + kAhead][0]);
      fetch(met[k + kAhead][1]);
    }
    leaves(nodes[met[k][0]], nodes[met[k][1]], met[k][0] == met[k][1]);
  }
  keep(state.vertex_triangle, std::false_type{}, 0);
  keep(state.edge_edge, std::true_type{}, 0);
  state.valid = true;
}

void SelfContact::select(State& state, const float* bound) const {
  const auto choose = [&](Pairs& list, std::vector<std::int32_t>& soon) {
    soon.clear();
    for (std::size_t k = 0; k < list.size(); ++k) {
      Candidate& c = list.candidate[k];
      const float bounds = (bound[c.v[0]] + bound[c.v[1]]) + (bound[c.v[2]] + bound[c.v[3]]);
      if (bounds >= c.due)
        soon.push_back(static_cast<std::int32_t>(k));
      else if (c.present >= 0.0f)
        let_go(c, list.contact[k]);
    }
  };
  choose(state.vertex_triangle, scratch_.soon_faces);
  choose(state.edge_edge, scratch_.soon_edges);
}

void SelfContact::let_go(Candidate& c, Contact& contact) {
  for (float& s : contact.slip) s = 0.0f;
  c.present = -1.0f;
  contact.mass = std::numeric_limits<float>::infinity();
}

void SelfContact::activate(State& state, const Fixed4* fixed, double unit, const float* moved,
                           const float* inverse_mass, float dt, float longest) const {
  std::vector<Active>& active = scratch_.active;
  std::vector<std::int32_t>& fast = scratch_.fast;
  active.clear();
  fast.clear();
  const float unit_f = static_cast<float>(unit);
  const float* path = state.path.data();
  const auto choose = [&](Pairs& list, const std::vector<std::int32_t>& soon, auto edges) {
    constexpr bool kEdges = decltype(edges)::value;
    Candidate* group[8];
    Contact* contacts[8];
    for (std::size_t first = 0; first < soon.size(); first += 8) {
      const int lanes = static_cast<int>(std::min<std::size_t>(8, soon.size() - first));
      for (int lane = 0; lane < 8; ++lane) {
        const auto k = static_cast<std::size_t>(soon[first + (lane < lanes ? lane : 0)]);
        group[lane] = &list.candidate[k], contacts[lane] = &list.contact[k];
      }
      const Stored m(measure<kEdges>(group, contacts, fixed, unit_f));
      // Most pairs are not near, and the branches of what follows cannot be foreseen: so by masks.
      float closing[8];
      unsigned near = 0, held = 0;
      for (int lane = 0; lane < lanes; ++lane) {
        Candidate& c = *group[lane];
        const float gap = m.distance[lane];
        c.due = (path[c.v[0]] + path[c.v[1]]) + (path[c.v[2]] + path[c.v[3]]) + (gap - c.distance);
        for (int k = 0; k < 3; ++k) contacts[lane]->normal[k] = m.normal[k][lane];
        // What the next step can close: twice the last one's motion, and a little for rest.
        closing[lane] = 2.0f * ((moved[c.v[0]] + moved[c.v[1]]) + (moved[c.v[2]] + moved[c.v[3]])) + 0.02f * c.distance;
        near |= static_cast<unsigned>(gap < c.distance + closing[lane]) << lane;
        held |= static_cast<unsigned>(c.present >= 0.0f) << lane;
      }
      const unsigned outside = near & ~m.inside;
      if constexpr (kEdges) {
        near &= ~outside;
      } else {
        each_lane(outside, [&](int lane) {
          const float weight[4] = {m.weight[0][lane], m.weight[1][lane], m.weight[2][lane], m.weight[3][lane]};
          if (elsewhere(*group[lane], weight, fixed)) near &= ~(1u << lane);
        });
      }
      each_lane(held & ~near, [&](int lane) { let_go(*group[lane], *contacts[lane]); });
      each_lane(near, [&](int lane) {
        Candidate& c = *group[lane];
        const float gap = m.distance[lane];
        // A pair that starts out closer than its distance (a state that was set so; a vertex that crossed over from the
        // next triangle) must not push at once: that would be energy from nothing, and kept creases buzzing. It starts
        // without force.
        c.present = c.present < 0.0f ? std::max(gap, 0.0f) : c.present + kRecovery * dt;
        c.present = std::min(c.present, c.distance);
        c.present = std::min(c.present, std::max(gap, 0.0f) + kYield * c.distance);
        Active a;
        a.gap = gap;
        a.least = 0.5f * c.distance;
        a.depth = c.present - gap;
        if (gap - a.least < closing[lane])
          fast.push_back(static_cast<std::int32_t>(active.size()));
        else if (a.depth <= 0.0f)
          return;
        a.contact = contacts[lane];
        for (int k = 0; k < 4; ++k) a.v[k] = c.v[k], a.weight[k] = m.weight[k][lane];
        active.push_back(a);
      });
    }
  };
  choose(state.vertex_triangle, scratch_.soon_faces, std::false_type{});
  choose(state.edge_edge, scratch_.soon_edges, std::true_type{});

  // Stiffness: Gershgorin over the pairs that share a vertex. With k_p = s min_i m_i / (2 W_i dt^2), W_i the sum of
  // |weight| of vertex i over its pairs, the rows of dt^2 M^-1 sum_p k_p g_p g_p^T sum to at most s.
  std::vector<float>& load = scratch_.load;
  load.assign(static_cast<std::size_t>(topology_->vertices), 0.0f);
  for (const Active& a : active)
    if (a.depth > 0.0f)
      for (int k = 0; k < 4; ++k) load[a.v[k]] += std::abs(a.weight[k]);
  // A spring may become softer while it is compressed, never stiffer, and does not follow the varying step: anything
  // else would be a pump.
  const float per_dt = 1.0f / longest;
  for (Active& a : active) {
    float worst = 0.0f;
    for (int k = 0; k < 4; ++k)
      worst = std::max(worst, 2.0f * std::max(load[a.v[k]], kLeastLoad) * inverse_mass[a.v[k]]);
    const float mass = worst > 0.0f ? 1.0f / worst : 0.0f;
    Contact& c = *a.contact;
    c.mass = a.depth > 0.0f ? std::min(c.mass, mass) : mass;
    a.stiffness = spring_ * c.mass * per_dt * per_dt;
    a.damping = kDashpot * c.mass * per_dt;
  }
}

void SelfContact::add_forces(State& state, const Float4* v, float dt, Float4* forces) const {
  std::int64_t touching = 0;
  for (const Active& a : scratch_.active) {
    Contact& c = *a.contact;
    if (a.depth <= 0.0f) {
      for (float& s : c.slip) s = 0.0f;
      continue;
    }
    const auto velocity = [&](int k) { return _mm_load_ps(&v[a.v[k]].x); };
    __m128 u = _mm_mul_ps(_mm_set1_ps(a.weight[0]), velocity(0));
    for (int k = 1; k < 4; ++k) u = _mm_fmadd_ps(_mm_set1_ps(a.weight[k]), velocity(k), u);
    const __m128 n = _mm_setr_ps(c.normal[0], c.normal[1], c.normal[2], 0.0f);
    const float approach = _mm_cvtss_f32(_mm_dp_ps(u, n, 0x71));
    const float normal_force = std::max(0.0f, a.stiffness * a.depth - a.damping * approach);
    if (normal_force > 0.0f) ++touching;
    // Tangential spring with slider; its stretch is kept in the tangent plane as that turns.
    const __m128 tangential = _mm_sub_ps(u, _mm_mul_ps(_mm_set1_ps(approach), n));
    __m128 slip = _mm_setr_ps(c.slip[0], c.slip[1], c.slip[2], 0.0f);
    slip = _mm_sub_ps(slip, _mm_mul_ps(_mm_dp_ps(slip, n, 0x7f), n));
    slip = _mm_fmadd_ps(_mm_set1_ps(dt), tangential, slip);
    const float limit = friction_ * normal_force;
    const auto length = [](__m128 a4) { return std::sqrt(_mm_cvtss_f32(_mm_dp_ps(a4, a4, 0x71))); };
    const float stretch = length(slip);
    if (a.stiffness * stretch > limit) slip = _mm_mul_ps(slip, _mm_set1_ps(limit / (a.stiffness * stretch)));
    __m128 pull = _mm_fmadd_ps(_mm_set1_ps(a.stiffness), slip, _mm_mul_ps(_mm_set1_ps(a.damping), tangential));
    const float size = length(pull);
    if (size > limit) pull = _mm_mul_ps(pull, _mm_set1_ps(limit / size));
    alignas(16) float stored[4];
    _mm_store_ps(stored, slip);
    for (int k = 0; k < 3; ++k) c.slip[k] = stored[k];
    const __m128 force = _mm_sub_ps(_mm_mul_ps(_mm_set1_ps(normal_force), n), pull);
    for (int k = 0; k < 4; ++k) {
      float* to = &forces[a.v[k]].x;
      _mm_store_ps(to, _mm_fmadd_ps(_mm_set1_ps(a.weight[k]), force, _mm_load_ps(to)));
    }
  }
  state.touching = touching;
}

void SelfContact::stop(const Double4* x, double dt, double floor, double ground_friction, const float* inverse_mass,
                       Double4* v) const {
  // The ground's friction changes velocities, too, all the more as the impulses press on the ground. So the ground
  // comes next, and then the pairs are stopped once more, without pressing.
  stop_pairs(x, dt, floor, inverse_mass, v, false);
  for (const std::int32_t index : scratch_.fast)
    for (const std::int32_t i : scratch_.active[index].v)
      if (inverse_mass[i] != 0.0f && x[i].z + dt * v[i].z < floor)
        store(v[i], meet_ground(x[i].z, dt, floor, ground_friction, load(v[i])));
  stop_pairs(x, dt, floor, inverse_mass, v, true);
}

void SelfContact::stop_pairs(const Double4* x, double dt, double floor, const float* inverse_mass, Double4* v,
                             bool grounded) const {
  constexpr int kPasses = 30;
  const double per_dt = 1.0 / dt;
  for (int pass = 0; pass < kPasses; ++pass) {
    bool changed = false;
    for (const std::int32_t index : scratch_.fast) {
      const Active& a = scratch_.active[index];
      const double nx = a.contact->normal[0], ny = a.contact->normal[1], nz = a.contact->normal[2];
      double approach = 0.0, inverse = 0.0;
      for (int k = 0; k < 4; ++k) {
        const std::int32_t i = a.v[k];
        const Double4& u = v[i];
        const double w = a.weight[k];
        // The ground comes after this and takes what is left of a downward velocity; here it counts as a wall.
        const double lowest = std::min(0.0, (floor - x[i].z) * per_dt);
        const bool blocked = u.z <= lowest && w * nz < 0.0;
        approach += w * (u.x * nx + u.y * ny + std::max(u.z, lowest) * nz);
        inverse += w * w * inverse_mass[i] * (nx * nx + ny * ny + (blocked ? 0.0 : nz * nz));
      }
      const double wanted = std::min(0.0, (static_cast<double>(a.least) - a.gap) * per_dt);
      if (approach >= wanted - 1e-9 || inverse <= 1e-12) continue;
      const double impulse = (wanted - approach) / inverse;
      for (int k = 0; k < 4; ++k) {
        const double s = impulse * a.weight[k] * inverse_mass[a.v[k]];
        v[a.v[k]].x += s * nx;
        v[a.v[k]].y += s * ny;
        v[a.v[k]].z += s * nz;
        if (grounded && inverse_mass[a.v[k]] != 0.0f)
          v[a.v[k]].z = std::max(v[a.v[k]].z, std::min(0.0, (floor - x[a.v[k]].z) * per_dt));
      }
      changed = true;
    }
    if (!changed) break;
  }
}

}  // namespace weft::cloth
