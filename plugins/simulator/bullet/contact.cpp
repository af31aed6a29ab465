#include "contact.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numeric>
#include <span>

namespace weft::bullet {
namespace {

using Eigen::Vector3d;

// Pairs are searched for up to this far beyond the thickness, m. With less, searches are more frequent; with more, they
// find more pairs.
constexpr double kReach = 0.012;
// An overlap is undone at this speed, m/s.
constexpr double kRise = 0.05;
// Part of the starting gap that a certificate keeps.
constexpr double kKeep = 0.25;
// A pair closer than this many times its approach in a substep is a contact, since corrections move vertices further
// than predicted.
constexpr double kLookAhead = 3.0;
constexpr double kSlack = 2e-7;       // m, so that rounding wakes no pair too late
constexpr double kTouching = 1e-9;    // m: closer than this a pair has no normal
constexpr double kCertified = 1e-12;  // m, rounding of a certificate
// Smaller patches give tighter bounds on their relative motion, but there are more pairs of patches to visit.
constexpr Index kPatchVertices = 32;
constexpr Index kMostPatches = 64;   // up to twice as many, by halving
constexpr int kCertifyPasses = 4;    // that push along the normal
constexpr int kTogetherPasses = 40;  // that make pairs move as one

/// Weights of the closest point of a triangle to p [Ericson 2005, Real-Time Collision Detection, sec. 5.1.5].
std::array<double, 3> closest_on_triangle(const Vector3d& p, const Vector3d& a, const Vector3d& b, const Vector3d& c) {
  const Vector3d ab = b - a, ac = c - a, ap = p - a;
  const double d1 = ab.dot(ap), d2 = ac.dot(ap);
  if (d1 <= 0 && d2 <= 0) return {1, 0, 0};
  const Vector3d bp = p - b;
  const double d3 = ab.dot(bp), d4 = ac.dot(bp);
  if (d3 >= 0 && d4 <= d3) return {0, 1, 0};
  const double vc = d1 * d4 - d3 * d2;
  if (vc <= 0 && d1 >= 0 && d3 <= 0) {
    const double t = d1 / (d1 - d3);
    return {1 - t, t, 0};
  }
  const Vector3d cp = p - c;
  const double d5 = ab.dot(cp), d6 = ac.dot(cp);
  if (d6 >= 0 && d5 <= d6) return {0, 0, 1};
  const double vb = d5 * d2 - d1 * d6;
  if (vb <= 0 && d2 >= 0 && d6 <= 0) {
    const double t = d2 / (d2 - d6);
    return {1 - t, 0, t};
  }
  const double va = d3 * d6 - d5 * d4;
  if (va <= 0 && d4 - d3 >= 0 && d5 - d6 >= 0) {
    const double t = (d4 - d3) / ((d4 - d3) + (d5 - d6));
    return {0, 1 - t, t};
  }
  const double whole = va + vb + vc;
  return {va / whole, vb / whole, vc / whole};
}

/// Where on p0 p1 and q0 q1 the closest points lie [Ericson 2005, sec. 5.1.9].
std::array<double, 2> closest_on_segments(const Vector3d& p0, const Vector3d& p1, const Vector3d& q0,
                                          const Vector3d& q1) {
  const Vector3d d1 = p1 - p0, d2 = q1 - q0, r = p0 - q0;
  const double a = d1.squaredNorm(), e = d2.squaredNorm(), f = d2.dot(r), c = d1.dot(r), b = d1.dot(d2);
  const double denominator = a * e - b * b;
  double s = denominator > 1e-12 * a * e ? std::clamp((b * f - c * e) / denominator, 0.0, 1.0) : 0.5;
  double t = (b * s + f) / e;
  if (t < 0.0) {
    t = 0.0;
    s = std::clamp(-c / a, 0.0, 1.0);
  } else if (t > 1.0) {
    t = 1.0;
    s = std::clamp((b - c) / a, 0.0, 1.0);
  }
  return {s, t};
}

/// x = sum of weight * node: the difference of the closest points.
template <class Points>
Vector3d difference(const Points& x, const std::int32_t* node, bool edges, double* weight) {
  const Vector3d &a = x[node[0]], &b = x[node[1]], &c = x[node[2]], &d = x[node[3]];
  if (edges) {
    const auto [s, t] = closest_on_segments(a, b, c, d);
    weight[0] = 1 - s;
    weight[1] = s;
    weight[2] = t - 1;
    weight[3] = -t;
    return (1 - s) * a + s * b - (1 - t) * c - t * d;
  }
  const auto w = closest_on_triangle(a, b, c, d);
  weight[0] = 1;
  for (int k = 0; k < 3; ++k) weight[k + 1] = -w[k];
  return a - w[0] * b - w[1] * c - w[2] * d;
}

struct Box {
  Vector3d low, high;
};
template <class Vertices>
Box box_of(const Vertices& vertices, const std::vector<Vector3d>& x) {
  Box box{x[vertices[0]], x[vertices[0]]};
  for (const auto v : vertices) {
    box.low = box.low.cwiseMin(x[v]);
    box.high = box.high.cwiseMax(x[v]);
  }
  return box;
}
double distance(const Box& p, const Box& q) {
  return (p.low - q.high).cwiseMax(q.low - p.high).cwiseMax(Vector3d::Zero()).norm();
}
/// Whether they are within `far` of one another along every axis: cheaper than distance().
bool near_along_axes(const Box& p, const Box& q, double far) {
  return ((p.low - q.high).array() <= far).all() && ((q.low - p.high).array() <= far).all();
}
/// The primitives within `far` of a box, with their own boxes. @param corners vertices of a primitive
template <class Corners>
std::vector<std::pair<std::int32_t, Box>> near_box(const std::vector<std::int32_t>& primitives, const Corners& corners,
                                                   const Box& box, double far, const std::vector<Vector3d>& x) {
  std::vector<std::pair<std::int32_t, Box>> found;
  for (const auto p : primitives) {
    const Box own = box_of(corners(p), x);
    if (distance(own, box) <= far) found.emplace_back(p, own);
  }
  return found;
}

}  // namespace

SelfContact::SelfContact(const Garment& garment, double thickness, double self_friction, bool self,
                         ObstacleContact obstacles)
    : thickness_(thickness),
      self_friction_(self_friction),
      self_(self),
      obstacles_(std::move(obstacles)),
      faces_(garment.faces),
      edges_(edges_of(garment.faces)) {
  const Index n = garment.vertex_count();
  lifted_.assign(n, 0.0);
  rest_.resize(n);
  if (garment.has_frames()) frames_.emplace(garment);
  for (Index i = 0; i < n; ++i) {
    if (frames_)
      rest_[i] = garment.positions.row(i).transpose();
    else
      rest_[i] = {garment.rest(i, 0), garment.rest(i, 1), 0.0};
  }
  piece_.resize(n);
  std::iota(piece_.begin(), piece_.end(), 0);
  const auto root = [&](std::int32_t i) {
    while (piece_[i] != i) i = piece_[i] = piece_[piece_[i]];
    return i;
  };
  for (Index e = 0; e < edges_.rows(); ++e) piece_[root(edges_(e, 0))] = root(edges_(e, 1));
  for (Index i = 0; i < n; ++i) piece_[i] = root(static_cast<std::int32_t>(i));
  make_patches(garment);
}

/// Halves the vertices at the median of the longest side: neighbours at rest stay neighbours.
void SelfContact::make_patches(const Garment& garment) {
  const Index n = garment.vertex_count();
  const std::size_t most = std::max<Index>(kPatchVertices, n / kMostPatches + 1);
  std::vector<std::int32_t> order(n);
  std::iota(order.begin(), order.end(), 0);
  std::vector<std::int32_t> patch_of(n);
  const auto split = [&](const auto& self, std::size_t begin, std::size_t end) -> void {
    if (end - begin <= most) {
      Patch patch;
      patch.vertices.assign(order.begin() + begin, order.begin() + end);
      std::sort(patch.vertices.begin(), patch.vertices.end());
      for (const auto v : patch.vertices) patch_of[v] = static_cast<std::int32_t>(patches_.size());
      patches_.push_back(std::move(patch));
      return;
    }
    Vector3d low = rest_[order[begin]], high = low;
    for (std::size_t k = begin; k < end; ++k) {
      low = low.cwiseMin(rest_[order[k]]);
      high = high.cwiseMax(rest_[order[k]]);
    }
    int axis = (high - low).x() >= (high - low).y() ? 0 : 1;
    if ((high - low).z() > (high - low)[axis]) axis = 2;  // never of a chart
    const std::size_t middle = (begin + end) / 2;
    std::nth_element(order.begin() + begin, order.begin() + middle, order.begin() + end,
                     [&](std::int32_t a, std::int32_t b) {
                       return rest_[a][axis] != rest_[b][axis] ? rest_[a][axis] < rest_[b][axis] : a < b;
                     });
    self(self, begin, middle);
    self(self, middle, end);
  };
  split(split, 0, order.size());
  for (Index f = 0; f < faces_.rows(); ++f)
    patches_[patch_of[faces_.row(f).minCoeff()]].faces.push_back(static_cast<std::int32_t>(f));
  for (Index e = 0; e < edges_.rows(); ++e)
    patches_[patch_of[edges_.row(e).minCoeff()]].edges.push_back(static_cast<std::int32_t>(e));
  for (Patch& patch : patches_) {
    patch.reach = patch.vertices;
    for (const auto f : patch.faces)
      for (int k = 0; k < 3; ++k) patch.reach.push_back(faces_(f, k));
    for (const auto e : patch.edges)
      for (int k = 0; k < 2; ++k) patch.reach.push_back(edges_(e, k));
    std::sort(patch.reach.begin(), patch.reach.end());
    patch.reach.erase(std::unique(patch.reach.begin(), patch.reach.end()), patch.reach.end());
  }
  const auto count = static_cast<std::int32_t>(patches_.size());
  for (std::int32_t a = 0; a < count; ++a)
    for (std::int32_t b = a; b < count; ++b) neighbours_.push_back({a, b, {}});
  forget();
}

void SelfContact::forget() {
  before_.clear();
  obstacles_.forget();
  travelled_.assign(neighbours_.size(), 0.0);
  alarm_.assign(neighbours_.size(), -std::numeric_limits<double>::infinity());
  for (Neighbours& one : neighbours_) one.horizon = alarm_.front();
}

double SelfContact::rest_distance(const Pair& pair) const {
  if (piece_[pair.node[0]] != piece_[pair.node[2]]) return std::numeric_limits<double>::infinity();
  // Beyond 10/9 of the thickness it makes no difference.
  if (frames_)
    return frames_->distance({pair.node[0], pair.node[1], pair.node[2], pair.node[3]}, pair.edges, 1.2 * thickness_);
  double weight[4];
  return difference(rest_, pair.node, pair.edges, weight).norm();
}

/// All pairs within reach between the two patches.
void SelfContact::find_pairs(Neighbours& neighbours, double travelled, const std::vector<Vector3d>& x) const {
  neighbours.pairs.clear();
  neighbours.wake.clear();
  const Patch &a = patches_[neighbours.a], &b = patches_[neighbours.b];
  const Box box_a = box_of(a.reach, x), box_b = box_of(b.reach, x);
  const double far = thickness_ + kReach;
  // Patches far from one another have no pairs until they come near.
  const double clear = std::max(far, distance(box_a, box_b));
  neighbours.horizon = travelled + clear - thickness_;
  if (clear > far) return;

  const auto add = [&](Pair pair) {
    double weight[4];
    if (difference(x, pair.node, pair.edges, weight).norm() > far) return;
    // Primitives that are closer than the thickness in the flat sheet are neighbours, not layers.
    pair.target = std::min(thickness_, 0.9 * rest_distance(pair));
    neighbours.pairs.push_back(pair);
  };
  const auto vertex = [](std::int32_t v) { return std::array<std::int32_t, 1>{v}; };
  const auto face = [&](std::int32_t f) {
    return std::array<std::int32_t, 3>{faces_(f, 0), faces_(f, 1), faces_(f, 2)};
  };
  const auto edge = [&](std::int32_t e) { return std::array<std::int32_t, 2>{edges_(e, 0), edges_(e, 1)}; };

  const auto add_vertices_and_faces = [&](const Patch& p, const Box& box_p, const Patch& q, const Box& box_q) {
    const auto faces = near_box(q.faces, face, box_p, far, x);
    for (const auto& [v, box_v] : near_box(p.vertices, vertex, box_q, far, x))
      for (const auto& [f, box_f] : faces) {
        const auto c = face(f);
        if (c[0] != v && c[1] != v && c[2] != v && near_along_axes(box_v, box_f, far))
          add({{v, c[0], c[1], c[2]}, false, 0.0, (std::int64_t{v} << 31) | f});
      }
  };
  const bool same = neighbours.a == neighbours.b;
  add_vertices_and_faces(a, box_a, b, box_b);
  if (!same) add_vertices_and_faces(b, box_b, a, box_a);

  const auto edges = near_box(b.edges, edge, box_a, far, x);
  for (const auto& [e, box_e] : near_box(a.edges, edge, box_b, far, x))
    for (const auto& [other, box_other] : edges) {
      if (same && other <= e) continue;
      const auto low = std::min(e, other), high = std::max(e, other);
      const auto c = edge(low), d = edge(high);
      if (c[0] != d[0] && c[0] != d[1] && c[1] != d[0] && c[1] != d[1] && near_along_axes(box_e, box_other, far))
        add({{c[0], c[1], d[0], d[1]}, true, 0.0, (std::int64_t{1} << 62) | (std::int64_t{low} << 31) | high});
    }
  neighbours.wake.assign(neighbours.pairs.size(), travelled);
}

void SelfContact::resolve(Substep& substep, int passes) {
  std::fill(lifted_.begin(), lifted_.end(), 0.0);
  if (self_) make_contacts(substep);
  obstacles_.begin(substep);
  for (int k = 0; k < passes; ++k) {
    push_apart(substep);
    push_off(substep);
  }
  rub(substep);
  obstacles_.rub(substep);
  certify(substep);
}

/// The contacts depend only on the positions at the start and end of this substep. Earlier substeps tell which pairs
/// need no measuring: a gap shrinks by at most the relative motion of the two patches. That motion is at most the size
/// of the box of their vertices' moves.
void SelfContact::make_contacts(const Substep& substep) {
  found_.clear();
  const Index count = patches_.size();
  // A row per patch, the box of its vertices' moves: since the start of the substep before, and predicted for this one.
  Eigen::ArrayXXd moved(count, 6), predicted(count, 6);
  const auto bounds = [&](const auto& move, auto& rows) {
    for (Index p = 0; p < count; ++p) {
      const auto& reach = patches_[p].reach;
      Vector3d low = move(reach[0]), high = low;
      for (const auto v : reach) {
        const Vector3d d = move(v);
        low = low.cwiseMin(d);
        high = high.cwiseMax(d);
      }
      rows.row(p) << low.transpose().array(), high.transpose().array();
    }
  };
  if (before_.empty()) before_ = substep.start;
  bounds([&](std::int32_t v) -> Vector3d { return substep.start[v] - before_[v]; }, moved);
  bounds([&](std::int32_t v) -> Vector3d { return substep.end[v] - substep.start[v]; }, predicted);
  before_ = substep.start;
  std::size_t first = 0;
  for (Index a = 0; a < count; ++a) {
    const Index n = count - a;
    const auto sizes = [&](const Eigen::ArrayXXd& rows) {
      Eigen::ArrayXd square = Eigen::ArrayXd::Zero(n);
      for (int k = 0; k < 3; ++k)
        square += (rows.col(3 + k).tail(n).max(rows(a, 3 + k)) - rows.col(k).tail(n).min(rows(a, k))).square();
      return Eigen::ArrayXd(square.sqrt());
    };
    const Eigen::ArrayXd way = sizes(moved), range = sizes(predicted);
    for (Index k = 0; k < n; ++k) {
      const std::size_t at = first + k;
      travelled_[at] += way[k];
      if (!(travelled_[at] + kLookAhead * range[k] + kSlack < alarm_[at])) add_contacts(at, range[k], substep);
    }
    first += n;
  }
  order_.clear();
  for (std::size_t k = 0; k < found_.size(); ++k) order_.emplace_back(found_[k].pair->order, k);
  std::sort(order_.begin(), order_.end());
  contacts_.clear();
  for (const auto& [order, k] : order_) contacts_.push_back(found_[k]);
}

/// @param range m, bound on the relative move of any two vertices of the patches in this substep.
void SelfContact::add_contacts(std::size_t at, double range, const Substep& substep) {
  Neighbours& neighbours = neighbours_[at];
  const double travelled = travelled_[at], soon = travelled + kLookAhead * range + kSlack;
  if (!(soon < neighbours.horizon)) find_pairs(neighbours, travelled, substep.start);
  double alarm = neighbours.horizon;
  for (std::size_t p = 0; p < neighbours.pairs.size(); ++p) {
    double& wake = neighbours.wake[p];
    if (wake > soon) {
      alarm = std::min(alarm, wake);
      continue;
    }
    const Pair& pair = neighbours.pairs[p];
    Contact contact;
    const Vector3d way = difference(substep.start, pair.node, pair.edges, contact.weight);
    contact.gap = way.norm();
    wake = travelled + contact.gap - pair.target;
    alarm = std::min(alarm, wake);
    // How far the four vertices approach one another, with corrections to come.
    double closing = 0.0;
    for (int k = 1; k < 4; ++k)
      closing = std::max(closing, (substep.end[pair.node[k]] - substep.start[pair.node[k]] - substep.end[pair.node[0]] +
                                   substep.start[pair.node[0]])
                                      .squaredNorm());
    if (contact.gap - pair.target > kLookAhead * std::sqrt(closing) + 0.5 * kSlack || contact.gap < kTouching) continue;
    contact.pair = &pair;
    contact.normal = way / contact.gap;
    contact.wanted = std::min(pair.target, contact.gap + kRise * substep.seconds);
    contact.mobility = 0.0;
    for (int k = 0; k < 4; ++k)
      contact.mobility += contact.weight[k] * contact.weight[k] * (*substep.inverse_mass)[pair.node[k]];
    if (contact.mobility > 0.0) found_.push_back(contact);
  }
  alarm_[at] = alarm;
}

void SelfContact::push_apart(Substep& substep) {
  auto& x = substep.end;
  const auto& w = *substep.inverse_mass;
  for (Contact& contact : contacts_) {
    const auto& node = contact.pair->node;
    double gap = 0.0;
    for (int k = 0; k < 4; ++k) gap += contact.weight[k] * contact.normal.dot(x[node[k]]);
    const double lack = contact.wanted - gap;
    if (lack <= 0.0) continue;
    contact.push += lack;
    for (int k = 0; k < 4; ++k)
      x[node[k]] += (lack / contact.mobility * contact.weight[k] * w[node[k]]) * contact.normal;
  }
}

void SelfContact::push_off(Substep& substep) {
  obstacles_.push(substep);
  if (!std::isfinite(substep.floor)) return;
  for (std::size_t i = 0; i < substep.end.size(); ++i) {
    if ((*substep.inverse_mass)[i] == 0.0) continue;
    // A vertex below the ground rises slowly.
    const double lowest = std::min(substep.floor, substep.start[i].z() + kRise * substep.seconds);
    const double lack = lowest - substep.end[i].z();
    if (lack <= 0.0) continue;
    substep.end[i].z() = lowest;
    lifted_[i] += lack;
  }
}

/// Coulomb friction: after a push of d along the normal, at most mu d of the tangential move is taken back.
void SelfContact::rub(Substep& substep) {
  auto& x = substep.end;
  const auto& w = *substep.inverse_mass;
  touching_ = 0;
  for (const Contact& contact : contacts_) {
    if (contact.push <= 0.0) continue;
    ++touching_;
    const auto& node = contact.pair->node;
    Vector3d slip = Vector3d::Zero();
    for (int k = 0; k < 4; ++k) slip += contact.weight[k] * (x[node[k]] - substep.start[node[k]]);
    slip -= contact.normal.dot(slip) * contact.normal;
    const double size = slip.norm();
    if (size == 0.0) continue;
    const double part = std::min(1.0, self_friction_ * contact.push / size);
    for (int k = 0; k < 4; ++k) x[node[k]] -= (part / contact.mobility * contact.weight[k] * w[node[k]]) * slip;
  }
  for (std::size_t i = 0; i < x.size(); ++i) {
    if (lifted_[i] <= 0.0) continue;
    const double dx = x[i].x() - substep.start[i].x(), dy = x[i].y() - substep.start[i].y();
    const double size = std::sqrt(dx * dx + dy * dy), most = substep.friction * lifted_[i];
    const double left = size <= most ? 0.0 : 1.0 - most / size;
    x[i].x() = substep.start[i].x() + left * dx;
    x[i].y() = substep.start[i].y() + left * dy;
  }
}

void SelfContact::certify(Substep& substep) {
  auto& x = substep.end;
  const auto& w = *substep.inverse_mass;
  using Sides = std::array<int, 2>;  // of Pair::node
  static constexpr std::array<Sides, 4> edge_edge{{{0, 2}, {0, 3}, {1, 2}, {1, 3}}};
  static constexpr std::array<Sides, 3> vertex_face{{{0, 1}, {0, 2}, {0, 3}}};
  // Calls push(i, j, lack) for every two vertices that are too close along the normal. @return whether any are.
  const auto for_each_lack = [&](const Contact& contact, const auto& push) {
    bool any = false;
    for (const auto& [a, b] : contact.pair->edges ? std::span<const Sides>(edge_edge) : vertex_face) {
      const auto i = contact.pair->node[a], j = contact.pair->node[b];
      const double lack = kKeep * contact.gap - contact.normal.dot(x[i] - x[j]);
      if (!(lack > kCertified)) continue;
      any = true;
      push(i, j, lack);
    }
    return any;
  };

  Index left = contacts_.size();
  for (int pass = 0; pass < kCertifyPasses && left > 0; ++pass) {
    left = 0;
    for (const Contact& contact : contacts_)
      left += for_each_lack(contact, [&](std::int32_t i, std::int32_t j, double lack) {
        const double both = w[i] + w[j];
        if (both == 0.0) return;
        x[i] += (lack * w[i] / both) * contact.normal;
        x[j] -= (lack * w[j] / both) * contact.normal;
      });
    if (left > 0) push_off(substep);
  }
  for (int pass = 0; pass < kTogetherPasses && left > 0; ++pass) {
    left = 0;
    for (const Contact& contact : contacts_) {
      if (!for_each_lack(contact, [](std::int32_t, std::int32_t, double) {})) continue;
      ++left;
      // The mean move, or that of the held vertices.
      Vector3d sum = Vector3d::Zero();
      double mass = 0.0, held = 0.0;
      for (const auto i : contact.pair->node) held += w[i] == 0.0 ? 1.0 : 0.0;
      for (const auto i : contact.pair->node) {
        const double m = held > 0.0 ? (w[i] == 0.0 ? 1.0 : 0.0) : 1.0 / w[i];
        sum += m * (x[i] - substep.start[i]);
        mass += m;
      }
      const Vector3d move = sum / mass;
      for (const auto i : contact.pair->node)
        if (w[i] != 0.0) x[i] = substep.start[i] + move;
    }
    if (left > 0) push_off(substep);
  }
  uncertified_ += left;
  push_off(substep);
}

}  // namespace weft::bullet
