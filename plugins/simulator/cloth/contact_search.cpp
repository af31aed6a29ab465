// More than 700 lines: one algorithm in one class, whose parts share the paths, the marks and the tree.
#include "contact_search.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <type_traits>

#include "distances.hpp"
#include "weft/types.hpp"

namespace weft::cloth {
namespace {

// Slack of the candidates as a part of the mean edge. With more slack a search finds more pairs, all of which have to
// be visited; with less, searches are more frequent. Between 0.02 and 0.06 the cost hardly differs.
constexpr float kSlack = 0.05f;
// Longest time that candidates are valid, s, and longest time between searches for all vertices where a search is for
// few. (When the latter was a second, layers at rest had more than twice the candidates, for all that could touch in
// it.)
constexpr double kLongest = 1.0, kRenewal = 0.05;
// A search for few vertices also takes those that have used this part of their slack, or whose path ends within this
// many frames. They would need a search soon.
constexpr float kNear = 0.25f;
constexpr double kSoon = 0.4;
// A path is expected to last this many times as long as the present acceleration would have it. (With 1, cloth that
// shakes is searched two times as often.)
constexpr double kTrust = 3.0;
// Entries of the table of remembered pairs: the upper half of a pair's key, and its place in the list. The last place
// is never used.
constexpr std::uint64_t kTag = 0xffffffff00000000ull, kFree = ~0ull;
// A node whose normals keep within this angle of its axis is flat, rad.
constexpr float kFlat = 1.4f;

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

struct Box {
  F8 low[3], high[3];  // one box in all lanes
};
[[gnu::always_inline]] inline Box lane_box(const BoxBlock& block, int lane) {
  Box box;
  for (int k = 0; k < 3; ++k) box.low[k] = splat(block.low[k][lane]), box.high[k] = splat(block.high[k][lane]);
  return box;
}
[[gnu::always_inline]] inline Box node_box(const PatchNode& node) {
  Box box;
  for (int k = 0; k < 3; ++k) box.low[k] = splat(node.low[k]), box.high[k] = splat(node.high[k]);
  return box;
}
/// Lanes of the block whose boxes meet the box.
[[gnu::always_inline]] inline unsigned meet(const Box& box, const BoxBlock& block) {
  F8 apart = _mm256_setzero_ps();
  for (int k = 0; k < 3; ++k) {
    apart = _mm256_or_ps(apart, _mm256_cmp_ps(box.low[k], _mm256_load_ps(block.high[k]), _CMP_GT_OQ));
    apart = _mm256_or_ps(apart, _mm256_cmp_ps(_mm256_load_ps(block.low[k]), box.high[k], _CMP_GT_OQ));
  }
  return ~static_cast<unsigned>(_mm256_movemask_ps(apart)) & 0xffu;
}
/// Lanes that are equal to i.
[[gnu::always_inline]] inline unsigned equal(std::int32_t i, const std::int32_t (&lanes)[8]) {
  const I8 same = _mm256_cmpeq_epi32(_mm256_set1_epi32(i), _mm256_load_si256(reinterpret_cast<const I8*>(lanes)));
  return static_cast<unsigned>(_mm256_movemask_ps(_mm256_castsi256_ps(same)));
}
/// Lanes that are above i.
[[gnu::always_inline]] inline unsigned above(std::int32_t i, const std::int32_t (&lanes)[8]) {
  const I8 more = _mm256_cmpgt_epi32(_mm256_load_si256(reinterpret_cast<const I8*>(lanes)), _mm256_set1_epi32(i));
  return static_cast<unsigned>(_mm256_movemask_ps(_mm256_castsi256_ps(more)));
}

}  // namespace

/// One search, for all vertices or for those that have strayed from their paths.
class ContactSearch::Search {
 public:
  Search(const ContactSearch& of, State& state, const Double4* x, const Double4* v, const Fixed4* fixed, double unit)
      : topology_(*of.topology_),
        of_(of),
        tree_(of.tree_),
        scratch_(of.scratch_),
        state_(state),
        x_(x),
        v_(v),
        fixed_(fixed),
        unit_(static_cast<float>(unit)),
        grown_(splat(of.slack_ + 0.5f * of.thickness_)) {}

  void run(double block_seconds);

 private:
  bool choose_strayed(double block_seconds);
  double distance2_from_path(std::int32_t i) const;
  double life_of(std::int32_t i, double distance2, double speed) const;
  void take_paths();
  void bound_nodes();
  void bound_leaf(PatchNode& node, Float4& sum);
  void bound_inner(PatchNode& node, Float4& sum);
  void mark(std::int32_t node);
  void spread_marks();
  void mark_lanes(BoxBlock& block, int corners);
  void mark_what_is_flat_no_more();
  bool flat_around(std::int32_t patch) const;
  bool one_sheet(std::int32_t first, std::int32_t second) const;
  void forget_strayed();
  bool recall(Candidate& pair, Contact& contact, bool edges) const;
  template <int kCorners>
  void fill(BoxBlock& block);
  void box_patch(std::int32_t index);
  void meet_within(std::int32_t node);
  void meet_between(std::int32_t first, std::int32_t second);
  void fetch(std::int32_t node);
  void search_leaves(const PatchNode& first, const PatchNode& second, bool same);
  void vertices_against_faces(const Patch& first, const Patch& second, const Box& second_box, bool second_strayed);
  void edges_against_edges(const Patch& first, const Patch& second, const Box& first_box, const Box& second_box,
                           bool second_strayed, bool same);
  template <bool kEdges>
  void keep(Pairs& out, int least);
  template <bool kEdges>
  void keep_block(Pairs& out, PairBlock& block, int lanes);

  const Topology& topology_;
  const ContactSearch& of_;
  PatchTree& tree_;
  Scratch& scratch_;
  State& state_;
  const Double4 *x_, *v_;
  const Fixed4* fixed_;
  float unit_;
  F8 grown_;  ///< m, growth of the boxes around paths: two boxes meet where a pair can come within thickness
  bool all_ = true;
  double shortest_ = 0.0;  ///< s, of a path
};

ContactSearch::ContactSearch(const Topology& topology, const PatchTree& tree, float thickness, float edge_thickness,
                             std::int32_t piecewise)
    : topology_(&topology),
      thickness_(thickness),
      edge_thickness_(edge_thickness),
      slack_(kSlack * static_cast<float>(topology.mean_edge)),
      piecewise_(piecewise),
      tree_(tree) {
  scratch_.sums.resize(tree_.nodes.size());
  scratch_.least_cosine.resize(tree_.nodes.size());
  scratch_.boxed.resize(tree_.patches.size());
}

void ContactSearch::clear(State& state) const {
  const std::size_t n = topology_->vertices;
  state.valid = false;
  state.vertex_triangle.clear();
  state.edge_edge.clear();
  state.vertex_triangle.reserve(16 * n);
  state.edge_edge.reserve(32 * n);
  state.path.assign(padded(n), 0.0f);
  state.start.assign(n, Double4{});
  state.drift.assign(n, Double4{});
  state.since.assign(n, 0.0);
  state.until.assign(n, 0.0);
  state.elapsed = state.horizon = state.renewal = 0.0;
  state.flat.assign(tree_.nodes.size(), 0);
  state.flat_around.assign(tree_.patches.size(), 0);
  scratch_.old.reserve(48 * n);
  scratch_.pending_faces.blocks.resize(kMostPending / 8);
  scratch_.pending_edges.blocks.resize(kMostPending / 8);
  scratch_.table.reserve(128 * n);
  scratch_.met.reserve(16 * tree_.nodes.size());
  scratch_.position.resize(n);
  scratch_.later.resize(n);
  scratch_.drift.resize(n);
  scratch_.strayed.resize(n);
  scratch_.life.resize(n);
}

/// Pairs that lie near one another in the rest shape must not repel there: their distance is at most 0.7 of what
/// separates them at rest, which leaves room for compression.
float ContactSearch::pair_distance(const std::int32_t (&v)[4], bool edges) const {
  const float full = edges ? edge_thickness_ : thickness_;
  if (topology_->component[v[0]] != topology_->component[v[3]]) return full;
  if (topology_->frames) {
    constexpr double kPart = 0.7;
    return std::min(
        full, static_cast<float>(kPart * topology_->frames->distance({v[0], v[1], v[2], v[3]}, edges, full / kPart)));
  }
  const auto rest = [&](std::int32_t i) {
    return std::array<double, 2>{topology_->place[i][0], topology_->place[i][1]};
  };
  const double far = 2.0 * full;
  double low[2][2], high[2][2];  // boxes of first and second
  const int split = edges ? 2 : 1;
  for (int k = 0; k < 2; ++k) {
    for (int side = 0; side < 2; ++side) low[side][k] = 1e30, high[side][k] = -1e30;
    for (int i = 0; i < 4; ++i) {
      const int side = i >= split;
      low[side][k] = std::min(low[side][k], topology_->place[v[i]][k]);
      high[side][k] = std::max(high[side][k], topology_->place[v[i]][k]);
    }
    if (low[0][k] > high[1][k] + far || low[1][k] > high[0][k] + far) return full;
  }
  double d2;
  if (edges) {
    d2 = std::min(std::min(segment_distance2(rest(v[0]), rest(v[2]), rest(v[3])),
                           segment_distance2(rest(v[1]), rest(v[2]), rest(v[3]))),
                  std::min(segment_distance2(rest(v[2]), rest(v[0]), rest(v[1])),
                           segment_distance2(rest(v[3]), rest(v[0]), rest(v[1]))));
  } else {
    d2 = std::min(segment_distance2(rest(v[0]), rest(v[1]), rest(v[2])),
                  std::min(segment_distance2(rest(v[0]), rest(v[2]), rest(v[3])),
                           segment_distance2(rest(v[0]), rest(v[1]), rest(v[3]))));
  }
  return std::min(full, static_cast<float>(0.7 * std::sqrt(d2)));
}

/// Measures the pending pairs, when there are at least `least`, and keeps those that can touch.
template <bool kEdges>
[[gnu::always_inline]] inline void ContactSearch::Search::keep(Pairs& out, int least) {
  Pending& pending = kEdges ? scratch_.pending_edges : scratch_.pending_faces;
  if (pending.count < least) return;
  for (int first = 0; first < pending.count; first += 8)
    keep_block<kEdges>(out, pending.blocks[first / 8], std::min(8, pending.count - first));
  pending.count = 0;
}

/// A vertex outside this search may be off its path, by a part of its slack now and by all of it later. A pair that
/// remembers its side is due at once: the distance measured here, without its memory, has no sign.
template <bool kEdges>
void ContactSearch::Search::keep_block(Pairs& out, PairBlock& block, int lanes) {
  constexpr int kSplit = kEdges ? 2 : 1;
  const Float4* drift = scratch_.drift.data();
  const F8 touching = splat(kEdges ? of_.edge_thickness_ : of_.thickness_),
           both_slack = splat((all_ ? 2.0f : 2.0f + 2.0f * kNear) * of_.slack_);
  for (int lane = lanes; lane < 8; ++lane)
    for (auto& column : block.v) column[lane] = column[0];
  const Measured m = measure<kEdges>([&](int k, int lane) { return block.v[k][lane]; }, nullptr, fixed_, unit_);
  const F8 apart = (m.distance - touching) - both_slack;
  F8 out_of_reach = less(_mm256_setzero_ps(), apart);
  if (_mm256_movemask_ps(out_of_reach) != 0) {
    Vec8 u[4];
    F8 rest = splat(kLongest);  // until the first of the four is searched for again
    for (int k = 0; k < 4; ++k) {
      u[k] = load8(drift, block.v[k]);
      rest = min8(rest, load_w8(drift, block.v[k]));
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
    if (!recall(c, contact, kEdges)) c.distance = of_.pair_distance(c.v, kEdges);
    const float paths = (state_.path[c.v[0]] + state_.path[c.v[1]]) + (state_.path[c.v[2]] + state_.path[c.v[3]]);
    c.due = contact.met() ? 0.0f : paths + (distance[lane] - c.distance);
    out.add(c, contact);
  });
}

void ContactSearch::prepare(State& state, const Double4* x, const Double4* v, const Fixed4* fixed, double unit,
                            double block_seconds) const {
  if (!state.valid || state.elapsed + block_seconds > state.horizon)
    Search(*this, state, x, v, fixed, unit).run(block_seconds);
}

// ---------------------------------------------------------------------------------------------------------------------

void ContactSearch::Search::run(double block_seconds) {
  all_ = choose_strayed(block_seconds);
  take_paths();
  scratch_.pending_faces.count = scratch_.pending_edges.count = 0;
  std::fill(scratch_.boxed.begin(), scratch_.boxed.end(), std::uint8_t{0});
  bound_nodes();
  mark_what_is_flat_no_more();
  forget_strayed();
  const std::vector<PatchNode>& nodes = tree_.nodes;
  std::vector<std::array<std::int32_t, 2>>& met = scratch_.met;
  met.clear();
  meet_within(0);
  constexpr std::size_t kAhead = 2;
  for (std::size_t k = 0; k < met.size(); ++k) {
    if (k + kAhead < met.size()) {
      fetch(met[k + kAhead][0]);
      fetch(met[k + kAhead][1]);
    }
    search_leaves(nodes[met[k][0]], nodes[met[k][1]], met[k][0] == met[k][1]);
  }
  keep<false>(state_.vertex_triangle, 0);
  keep<true>(state_.edge_edge, 0);
  state_.valid = true;
}

/// Squared distance of a vertex from where its path has it now, m^2.
double ContactSearch::Search::distance2_from_path(std::int32_t i) const {
  const __m256d off = _mm256_sub_pd(
      load(x_[i]), _mm256_fmadd_pd(load(state_.drift[i]), _mm256_set1_pd(state_.elapsed), load(state_.start[i])));
  Double4 square;
  store(square, _mm256_mul_pd(off, off));
  return square.x + square.y + square.z;
}

/// How long a vertex will keep to a path that begins now, s. Off a path of length t by d, it would have left it at
/// t sqrt(slack / d), as a constant acceleration has it. Most accelerations change sign before.
double ContactSearch::Search::life_of(std::int32_t i, double distance2, double speed) const {
  const double longest = std::clamp(of_.slack_ / std::max(speed, 1e-9), kFrameSeconds, kLongest);
  const double age = state_.elapsed - state_.since[i];
  if (!(age > 0.0)) return longest;
  return std::clamp(kTrust * age * std::sqrt(of_.slack_ / std::max(std::sqrt(distance2), 1e-12)), shortest_, longest);
}

/// Marks the vertices that are off their path, or will be by the block's end. Takes those with it that have used a part
/// of their slack, since they would be next. Begins the paths of all of these. @return whether candidates are searched
/// for all.
bool ContactSearch::Search::choose_strayed(double block_seconds) {
  const std::int32_t n = topology_.vertices;
  const double end = state_.elapsed + block_seconds;
  const double near = std::pow(kNear * static_cast<double>(of_.slack_), 2);
  shortest_ = block_seconds;
  bool all = n < of_.piecewise_ || end > state_.renewal;
  double common = kLongest;
  std::int32_t count = 0;
  for (std::int32_t i = 0; i < n; ++i) {
    const double off = distance2_from_path(i);
    const Double4& u = v_[i];
    scratch_.life[i] = static_cast<float>(life_of(i, off, std::sqrt(u.x * u.x + u.y * u.y + u.z * u.z)));
    common = std::min(common, static_cast<double>(scratch_.life[i]));
    scratch_.strayed[i] = off > near || state_.until[i] < end + kSoon * (state_.until[i] - state_.since[i]);
    count += scratch_.strayed[i];
  }
  all = all || 2 * count > n;
  if (all) {
    std::fill(scratch_.strayed.begin(), scratch_.strayed.end(), std::uint8_t{1});
    std::fill(state_.path.begin(), state_.path.end(), 0.0f);
    state_.elapsed = 0.0;
    state_.renewal = n < of_.piecewise_ ? common : kRenewal;
    if (n < of_.piecewise_) std::fill(scratch_.life.begin(), scratch_.life.end(), static_cast<float>(common));
  }
  return all;
}

/// Computes where every vertex is on its path now and at the path's end. Vertices of this search begin a new path.
void ContactSearch::Search::take_paths() {
  const std::int32_t n = topology_.vertices;
  double low[3] = {1e300, 1e300, 1e300};
  for (std::int32_t i = 0; i < n; ++i)
    low[0] = std::min(low[0], x_[i].x), low[1] = std::min(low[1], x_[i].y), low[2] = std::min(low[2], x_[i].z);
  state_.horizon = kLongest;
  std::vector<Float4>&position = scratch_.position, &later = scratch_.later, &drift = scratch_.drift;
  for (std::int32_t i = 0; i < n; ++i) {
    Double4 &start = state_.start[i], &u = state_.drift[i];
    Double4 now = x_[i];
    if (scratch_.strayed[i]) {
      u = v_[i];
      start = {x_[i].x - state_.elapsed * u.x, x_[i].y - state_.elapsed * u.y, x_[i].z - state_.elapsed * u.z, 0.0};
      state_.since[i] = state_.elapsed;
      state_.until[i] = std::min(state_.elapsed + static_cast<double>(scratch_.life[i]), state_.renewal);
    } else {
      now = {start.x + state_.elapsed * u.x, start.y + state_.elapsed * u.y, start.z + state_.elapsed * u.z, 0.0};
    }
    state_.horizon = std::min(state_.horizon, state_.until[i]);
    const auto rest = static_cast<float>(state_.until[i] - state_.elapsed);
    position[i] = {static_cast<float>(now.x - low[0]), static_cast<float>(now.y - low[1]),
                   static_cast<float>(now.z - low[2]), 0.0f};
    drift[i] = {static_cast<float>(u.x), static_cast<float>(u.y), static_cast<float>(u.z), rest};
    later[i] = {position[i].x + rest * drift[i].x, position[i].y + rest * drift[i].y, position[i].z + rest * drift[i].z,
                0.0f};
  }
}

/// Boxes around the paths, now and later.
template <int kCorners>
void ContactSearch::Search::fill(BoxBlock& block) {
  Vec8 low8 = load8(scratch_.position.data(), block.corner[0]), high8 = low8;
  const auto add = [&](const Vec8& p) {
    low8 = {min8(low8.x, p.x), min8(low8.y, p.y), min8(low8.z, p.z)};
    high8 = {max8(high8.x, p.x), max8(high8.y, p.y), max8(high8.z, p.z)};
  };
  add(load8(scratch_.later.data(), block.corner[0]));
  for (int k = 1; k < kCorners; ++k) {
    add(load8(scratch_.position.data(), block.corner[k]));
    add(load8(scratch_.later.data(), block.corner[k]));
  }
  const F8 empty = _mm256_castsi256_ps(_mm256_load_si256(reinterpret_cast<const I8*>(block.id)));  // sign bit
  const F8 inverted = splat(1e30f), deflated = splat(-1e30f);
  const auto write = [&](float(&to)[8], F8 value, F8 none) {
    _mm256_store_ps(to, _mm256_blendv_ps(value, none, empty));
  };
  write(block.low[0], low8.x - grown_, inverted), write(block.high[0], high8.x + grown_, deflated);
  write(block.low[1], low8.y - grown_, inverted), write(block.high[1], high8.y + grown_, deflated);
  write(block.low[2], low8.z - grown_, inverted), write(block.high[2], high8.z + grown_, deflated);
  mark_lanes(block, kCorners);
}

/// Boxes of a patch's vertices and edges, computed when they are first needed.
void ContactSearch::Search::box_patch(std::int32_t index) {
  if (scratch_.boxed[index]) return;
  scratch_.boxed[index] = 1;
  const Patch& patch = tree_.patches[index];
  for (std::int32_t b = patch.vertices[0]; b < patch.vertices[1]; ++b) fill<1>(tree_.vertices[b]);
  for (std::int32_t b = patch.edges[0]; b < patch.edges[1]; ++b) fill<2>(tree_.edges[b]);
}

/// Box and cone of a patch. Until the next search a normal turns by at most the relative motion of its corners over the
/// height of the face.
void ContactSearch::Search::bound_leaf(PatchNode& node, Float4& sum) {
  const Float4 *position = scratch_.position.data(), *drift = scratch_.drift.data();
  BoxBlock& block = tree_.faces[tree_.patches[node.patch].faces[0]];  // at most eight faces: one block
  fill<3>(block);
  for (int k = 0; k < 3; ++k) {
    node.low[k] = *std::min_element(block.low[k], block.low[k] + 8);
    node.high[k] = *std::max_element(block.high[k], block.high[k] + 8);
  }
  // Empty lanes repeat the first face: that changes the axis a little, and no bound.
  const Vec8 a = load8(position, block.corner[1]) - load8(position, block.corner[0]);
  const Vec8 c = load8(position, block.corner[2]) - load8(position, block.corner[0]);
  const Vec8 u = load8(drift, block.corner[1]) - load8(drift, block.corner[0]);
  const Vec8 w = load8(drift, block.corner[2]) - load8(drift, block.corner[0]);
  Vec8 m = cross(a, c);
  const F8 twice_area = max8(_mm256_sqrt_ps(dot(m, m)), splat(1e-20f));
  m = (splat(1.0f) / twice_area) * m;
  const Vec8 ac = c - a, uw = w - u;
  const F8 longest_edge = _mm256_sqrt_ps(max8(dot(a, a), max8(dot(c, c), dot(ac, ac))));
  const F8 parted = _mm256_sqrt_ps(max8(dot(u, u), max8(dot(w, w), dot(uw, uw))));
  F8 rest = _mm256_setzero_ps();
  for (const auto& corner : block.corner) rest = max8(rest, load_w8(drift, corner));
  const F8 turning = fma(parted, rest, splat(2.0f * of_.slack_)) * longest_edge / twice_area;
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
}

void ContactSearch::Search::bound_inner(PatchNode& node, Float4& sum) {
  const PatchNode &l = tree_.nodes[node.left], &r = tree_.nodes[node.right];
  node.strayed = l.strayed || r.strayed;
  const Float4 &sl = scratch_.sums[node.left], &sr = scratch_.sums[node.right];
  for (int k = 0; k < 3; ++k) node.low[k] = std::min(l.low[k], r.low[k]), node.high[k] = std::max(l.high[k], r.high[k]);
  sum = {sl.x + sr.x, sl.y + sr.y, sl.z + sr.z, 0.0f};
  const float scale = 1.0f / std::max(1e-20f, std::sqrt(sum.x * sum.x + sum.y * sum.y + sum.z * sum.z));
  node.axis[0] = sum.x * scale, node.axis[1] = sum.y * scale, node.axis[2] = sum.z * scale;
  if (l.angle > kFlat || r.angle > kFlat) {
    node.angle = 10.0f;
    return;
  }
  const auto tilt = [&](const PatchNode& child) {
    const float c = child.axis[0] * node.axis[0] + child.axis[1] * node.axis[1] + child.axis[2] * node.axis[2];
    return std::acos(std::clamp(c, -1.0f, 1.0f)) + child.angle;
  };
  node.angle = std::max(tilt(l), tilt(r));
}

/// Boxes and cones, children first.
void ContactSearch::Search::bound_nodes() {
  for (std::size_t index = tree_.nodes.size(); index-- > 0;) {
    PatchNode& node = tree_.nodes[index];
    if (node.patch >= 0)
      bound_leaf(node, scratch_.sums[index]);
    else
      bound_inner(node, scratch_.sums[index]);
  }
}

/// Marks all vertices of a node.
void ContactSearch::Search::mark(std::int32_t node) {
  const PatchNode& at = tree_.nodes[node];
  if (at.patch < 0) {
    mark(at.left);
    mark(at.right);
    return;
  }
  for (const auto& corner : tree_.faces[tree_.patches[at.patch].faces[0]].corner)
    for (const std::int32_t i : corner) scratch_.strayed[i] = 1;
}

/// After mark(): the marks of blocks and nodes.
void ContactSearch::Search::spread_marks() {
  for (std::size_t index = tree_.nodes.size(); index-- > 0;) {
    PatchNode& node = tree_.nodes[index];
    if (node.patch >= 0) {
      BoxBlock& block = tree_.faces[tree_.patches[node.patch].faces[0]];
      mark_lanes(block, 3);
      node.strayed = block.strayed != 0;
    } else {
      node.strayed = tree_.nodes[node.left].strayed || tree_.nodes[node.right].strayed;
    }
  }
}

void ContactSearch::Search::mark_lanes(BoxBlock& block, int corners) {
  block.strayed = 0;
  for (int k = 0; k < corners; ++k)
    for (int lane = 0; lane < 8; ++lane)
      block.strayed |= static_cast<unsigned>(scratch_.strayed[block.corner[k][lane]]) << lane;
}

/// Whether all normals around a patch lie in one cone below 90 degrees (PatchNode::convex), so that no two parts of it
/// and its neighbours can touch.
bool ContactSearch::Search::flat_around(std::int32_t patch) const {
  if (!tree_.round[patch]) return false;
  const std::int32_t *begin = tree_.around.data() + tree_.around_start[patch],
                     *end = tree_.around.data() + tree_.around_start[patch + 1];
  float x = 0.0f, y = 0.0f, z = 0.0f;
  for (const std::int32_t* leaf = begin; leaf != end; ++leaf) {
    const Float4& sum = scratch_.sums[*leaf];
    x += sum.x, y += sum.y, z += sum.z;
  }
  const float length = std::sqrt(x * x + y * y + z * z);
  return std::all_of(begin, end, [&](std::int32_t leaf) {
    const float(&axis)[3] = tree_.nodes[leaf].axis;
    return x * axis[0] + y * axis[1] + z * axis[2] > scratch_.least_cosine[leaf] * length;
  });
}

/// Whether two leaves are neighbours in a part of the cloth that is flat.
bool ContactSearch::Search::one_sheet(std::int32_t first, std::int32_t second) const {
  const std::int32_t p = tree_.nodes[first].patch, q = tree_.nodes[second].patch;
  if (!state_.flat_around[p] && !state_.flat_around[q]) return false;
  const auto begin = tree_.near.begin() + tree_.near_start[p], end = tree_.near.begin() + tree_.near_start[p + 1];
  return std::find(begin, end, second) != end;
}

/// A node, or a patch with its neighbours, is not searched while it is flat. When it stops being flat, all of its
/// vertices join the search.
void ContactSearch::Search::mark_what_is_flat_no_more() {
  std::vector<PatchNode>& nodes = tree_.nodes;
  const auto flat = [&](const PatchNode& node) { return node.convex && node.angle < kFlat; };
  for (std::size_t index = 0; index < nodes.size(); ++index)
    if (nodes[index].patch >= 0)
      scratch_.least_cosine[index] = nodes[index].angle < kFlat ? std::cos(kFlat - nodes[index].angle) : 2.0f;
  for (bool more = !all_; more;) {
    more = false;
    for (std::size_t index = 0; index < nodes.size(); ++index) {
      const std::int32_t patch = nodes[index].patch;
      if (nodes[index].strayed && state_.flat[index] && !flat(nodes[index])) {
        state_.flat[index] = 0;
        mark(static_cast<std::int32_t>(index));
        more = true;
      }
      if (patch >= 0 && state_.flat_around[patch] && !flat_around(patch)) {
        state_.flat_around[patch] = 0;
        mark(static_cast<std::int32_t>(index));
        more = true;
      }
    }
    if (more) spread_marks();
  }
  for (std::size_t index = 0; index < nodes.size(); ++index) {
    if (nodes[index].strayed) state_.flat[index] = flat(nodes[index]);
    if (nodes[index].strayed && nodes[index].patch >= 0)
      state_.flat_around[nodes[index].patch] = flat_around(nodes[index].patch);
  }
}

/// Moves the pairs with a marked vertex out of the candidates. Those whose side or slip is known go to scratch_.old.
void ContactSearch::Search::forget_strayed() {
  Pairs& old = scratch_.old;
  const std::uint8_t* strayed = scratch_.strayed.data();
  old.clear();
  for (Pairs* list : {&state_.vertex_triangle, &state_.edge_edge}) {
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
    if (list == &state_.vertex_triangle) scratch_.old_vertex_triangle = old.size();
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

/// @return whether the pair was known; then everything but `due` is restored.
bool ContactSearch::Search::recall(Candidate& c, Contact& contact, bool edges) const {
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

/// Collects the leaves below a node that meet, or may meet themselves.
void ContactSearch::Search::meet_within(std::int32_t index) {
  const PatchNode& node = tree_.nodes[index];
  if (!node.strayed || state_.flat[index]) return;
  if (node.patch >= 0) {
    if (!state_.flat_around[node.patch]) scratch_.met.push_back({index, index});
    return;
  }
  meet_within(node.left);
  meet_within(node.right);
  meet_between(node.left, node.right);
}

/// Collects the leaves below one node that meet those below another.
void ContactSearch::Search::meet_between(std::int32_t first, std::int32_t second) {
  const PatchNode &a = tree_.nodes[first], &b = tree_.nodes[second];
  if (!a.strayed && !b.strayed) return;
  for (int k = 0; k < 3; ++k)
    if (a.low[k] > b.high[k] || b.low[k] > a.high[k]) return;
  if (a.patch >= 0 && b.patch >= 0) {
    if (!one_sheet(first, second)) scratch_.met.push_back({first, second});
    return;
  }
  const auto extent = [](const PatchNode& node) {
    return node.patch >= 0
               ? -1.0f
               : std::max(node.high[0] - node.low[0], std::max(node.high[1] - node.low[1], node.high[2] - node.low[2]));
  };
  if (extent(a) >= extent(b)) {
    meet_between(a.left, second);
    meet_between(a.right, second);
  } else {
    meet_between(first, b.left);
    meet_between(first, b.right);
  }
}

/// The boxes of leaves are spread over more memory than the near caches hold.
void ContactSearch::Search::fetch(std::int32_t node) {
  const Patch& patch = tree_.patches[tree_.nodes[node].patch];
  const auto blocks = [](const std::vector<BoxBlock>& list, const std::int32_t(&range)[2]) {
    const auto* end = reinterpret_cast<const char*>(list.data() + range[1]);
    for (auto* line = reinterpret_cast<const char*>(list.data() + range[0]); line < end; line += 64)
      __builtin_prefetch(line);
  };
  blocks(tree_.faces, patch.faces);
  blocks(tree_.vertices, patch.vertices);
  blocks(tree_.edges, patch.edges);
}

void ContactSearch::Search::search_leaves(const PatchNode& first, const PatchNode& second, bool same) {
  const Patch &p = tree_.patches[first.patch], &q = tree_.patches[second.patch];
  box_patch(first.patch);
  box_patch(second.patch);
  const Box p_box = node_box(first), q_box = node_box(second);
  vertices_against_faces(p, q, q_box, second.strayed);
  if (!same) vertices_against_faces(q, p, p_box, first.strayed);
  keep<false>(state_.vertex_triangle, 64);
  edges_against_edges(p, q, p_box, q_box, second.strayed, same);
  keep<true>(state_.edge_edge, 64);
}

void ContactSearch::Search::vertices_against_faces(const Patch& first, const Patch& second, const Box& second_box,
                                                   bool second_strayed) {
  for (std::int32_t b = first.vertices[0]; b < first.vertices[1]; ++b) {
    const unsigned searched_lanes = second_strayed ? 0xffu : tree_.vertices[b].strayed;
    if (searched_lanes == 0) continue;
    each_lane(meet(second_box, tree_.vertices[b]) & searched_lanes, [&](int lane) {
      const Box box = lane_box(tree_.vertices[b], lane);
      const std::int32_t i = tree_.vertices[b].id[lane];
      const bool searched = (tree_.vertices[b].strayed >> lane & 1u) != 0;
      for (std::int32_t c = second.faces[0]; c < second.faces[1]; ++c) {
        const BoxBlock& block = tree_.faces[c];
        unsigned mask = meet(box, block);
        if (!searched) mask &= block.strayed;
        if (mask == 0) continue;
        for (int k = 0; k < 3; ++k) mask &= ~equal(i, block.corner[k]);
        each_lane(mask, [&](int other) {
          scratch_.pending_faces.add({i, block.corner[0][other], block.corner[1][other], block.corner[2][other]},
                                     block.id[other]);
        });
      }
    });
  }
}

void ContactSearch::Search::edges_against_edges(const Patch& first, const Patch& second, const Box& first_box,
                                                const Box& second_box, bool second_strayed, bool same) {
  unsigned reached[4];  // of the second's edges
  for (std::int32_t c = second.edges[0]; c < second.edges[1]; ++c)
    reached[c - second.edges[0]] = meet(first_box, tree_.edges[c]);
  for (std::int32_t b = first.edges[0]; b < first.edges[1]; ++b) {
    const unsigned searched_lanes = second_strayed ? 0xffu : tree_.edges[b].strayed;
    if (searched_lanes == 0) continue;
    each_lane(meet(second_box, tree_.edges[b]) & searched_lanes, [&](int lane) {
      const Box box = lane_box(tree_.edges[b], lane);
      const std::int32_t e = tree_.edges[b].id[lane];
      const bool searched = (tree_.edges[b].strayed >> lane & 1u) != 0;
      const std::int32_t e0 = tree_.edges[b].corner[0][lane], e1 = tree_.edges[b].corner[1][lane];
      for (std::int32_t c = second.edges[0]; c < second.edges[1]; ++c) {
        const BoxBlock& block = tree_.edges[c];
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
            scratch_.pending_edges.add({g0, g1, e0, e1}, -1);
          else
            scratch_.pending_edges.add({e0, e1, g0, g1}, -1);
        });
      }
    });
  }
}

}  // namespace weft::cloth
