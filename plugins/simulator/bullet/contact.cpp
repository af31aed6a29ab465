#include "contact.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numeric>

namespace weft::bullet {
namespace {

using Eigen::Vector3d;

// Pairs are looked for this far beyond the thickness, m: less finds them more often, more finds more of them.
constexpr double kReach = 0.012;
// An overlap goes at this speed, m/s.
constexpr double kRise = 0.05;
// Part of the starting gap that a certificate keeps.
constexpr double kKeep = 0.25;
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

}  // namespace

SelfContact::SelfContact(const Garment& garment, double thickness, double self_friction, bool self)
    : thickness_(thickness),
      self_friction_(self_friction),
      self_(self),
      faces_(garment.faces),
      edges_(edges_of(garment.faces)) {
  const Index n = garment.vertex_count();
  lifted_.assign(n, 0.0);
  rest_.resize(n);
  for (Index i = 0; i < n; ++i) rest_[i] = {garment.rest(i, 0), garment.rest(i, 1), 0.0};
  piece_.resize(n);
  std::iota(piece_.begin(), piece_.end(), 0);
  const auto root = [&](std::int32_t i) {
    while (piece_[i] != i) i = piece_[i] = piece_[piece_[i]];
    return i;
  };
  for (Index e = 0; e < edges_.rows(); ++e) piece_[root(edges_(e, 0))] = root(edges_(e, 1));
  for (Index i = 0; i < n; ++i) piece_[i] = root(static_cast<std::int32_t>(i));
  std::vector<Vector3d> centres(faces_.rows());
  for (Index f = 0; f < faces_.rows(); ++f)
    centres[f] = (rest_[faces_(f, 0)] + rest_[faces_(f, 1)] + rest_[faces_(f, 2)]) / 3.0;
  face_tree_ = make_tree(centres);
  centres.resize(edges_.rows());
  for (Index e = 0; e < edges_.rows(); ++e) centres[e] = 0.5 * (rest_[edges_(e, 0)] + rest_[edges_(e, 1)]);
  edge_tree_ = make_tree(centres);
}

/// Halves at the median of the longer side, in rest coordinates: neighbours there stay neighbours.
SelfContact::Tree SelfContact::make_tree(const std::vector<Vector3d>& centres) {
  Tree tree;
  std::vector<std::int32_t> order(centres.size());
  std::iota(order.begin(), order.end(), 0);
  struct Task {
    std::size_t begin, end;
    std::int32_t node;
  };
  tree.nodes.push_back({});
  std::vector<Task> tasks{{0, order.size(), 0}};
  while (!tasks.empty()) {
    const Task task = tasks.back();
    tasks.pop_back();
    if (task.end - task.begin == 1) {
      tree.nodes[task.node] = {-1, order[task.begin]};
      continue;
    }
    Vector3d low = centres[order[task.begin]], high = low;
    for (std::size_t k = task.begin; k < task.end; ++k) {
      low = low.cwiseMin(centres[order[k]]);
      high = high.cwiseMax(centres[order[k]]);
    }
    const int axis = (high - low).x() >= (high - low).y() ? 0 : 1;
    const std::size_t middle = (task.begin + task.end) / 2;
    std::nth_element(order.begin() + task.begin, order.begin() + middle, order.begin() + task.end,
                     [&](std::int32_t a, std::int32_t b) {
                       return centres[a][axis] != centres[b][axis] ? centres[a][axis] < centres[b][axis] : a < b;
                     });
    const auto left = static_cast<std::int32_t>(tree.nodes.size());
    tree.nodes[task.node] = {left, left + 1};
    tree.nodes.push_back({});
    tree.nodes.push_back({});
    tasks.push_back({task.begin, middle, left});
    tasks.push_back({middle, task.end, left + 1});
  }
  tree.boxes.resize(tree.nodes.size());
  return tree;
}

template <class BoxOf>
void SelfContact::refit(Tree& tree, const BoxOf& box_of) {
  for (std::size_t k = tree.nodes.size(); k-- > 0;) {
    const Node& node = tree.nodes[k];
    if (node.left < 0) {
      tree.boxes[k] = box_of(node.right);
    } else {
      const Box &a = tree.boxes[node.left], &b = tree.boxes[node.right];
      tree.boxes[k] = {a.low.cwiseMin(b.low), a.high.cwiseMax(b.high)};
    }
  }
}

template <class Visit>
void SelfContact::overlapping(const Tree& tree, const Box& box, std::vector<std::int32_t>& stack, const Visit& visit) {
  stack.assign(1, 0);
  while (!stack.empty()) {
    const std::int32_t k = stack.back();
    stack.pop_back();
    const Box& other = tree.boxes[k];
    if ((box.low.array() > other.high.array()).any() || (box.high.array() < other.low.array()).any()) continue;
    const Node& node = tree.nodes[k];
    if (node.left < 0) {
      visit(node.right);
    } else {
      stack.push_back(node.left);
      stack.push_back(node.right);
    }
  }
}

double SelfContact::rest_distance(const Pair& pair) const {
  if (piece_[pair.node[0]] != piece_[pair.node[2]]) return std::numeric_limits<double>::infinity();
  double weight[4];
  return difference(rest_, pair.node, pair.edges, weight).norm();
}

void SelfContact::begin_frame(const std::vector<Vector3d>& positions) {
  travelled_ = 0.0;
  if (self_) find_pairs(positions);
}

/// All pairs within reach, in an order that depends on their vertices only, so that moving the world changes nothing.
void SelfContact::find_pairs(const std::vector<Vector3d>& x) {
  found_at_ = travelled_;
  pairs_.clear();
  const double far = thickness_ + kReach;
  const auto face_box = [&](std::int32_t f) {
    const Vector3d &a = x[faces_(f, 0)], &b = x[faces_(f, 1)], &c = x[faces_(f, 2)];
    return Box{a.cwiseMin(b).cwiseMin(c), a.cwiseMax(b).cwiseMax(c)};
  };
  const auto edge_box = [&](std::int32_t e) {
    const Vector3d &a = x[edges_(e, 0)], &b = x[edges_(e, 1)];
    return Box{a.cwiseMin(b), a.cwiseMax(b)};
  };
  refit(face_tree_, face_box);
  refit(edge_tree_, edge_box);
  std::vector<std::int32_t> stack, found;
  const auto add = [&](Pair pair) {
    double weight[4];
    const double distance = difference(x, pair.node, pair.edges, weight).norm();
    if (distance > far) return;
    // Neighbours that the flat sheet has closer than the thickness are no layers.
    pair.target = std::min(thickness_, 0.9 * rest_distance(pair));
    pair.wake = travelled_;
    pairs_.push_back(pair);
  };
  const Vector3d margin = Vector3d::Constant(far);
  for (std::int32_t v = 0; v < static_cast<std::int32_t>(x.size()); ++v) {
    found.clear();
    overlapping(face_tree_, {x[v] - margin, x[v] + margin}, stack, [&](std::int32_t f) {
      if (faces_(f, 0) != v && faces_(f, 1) != v && faces_(f, 2) != v) found.push_back(f);
    });
    std::sort(found.begin(), found.end());
    for (const std::int32_t f : found) add({{v, faces_(f, 0), faces_(f, 1), faces_(f, 2)}, false, 0.0, 0.0});
  }
  for (std::int32_t e = 0; e < static_cast<std::int32_t>(edges_.rows()); ++e) {
    found.clear();
    const Box box = edge_box(e);
    const int a = edges_(e, 0), b = edges_(e, 1);
    overlapping(edge_tree_, {box.low - margin, box.high + margin}, stack, [&](std::int32_t other) {
      const int c = edges_(other, 0), d = edges_(other, 1);
      if (other > e && a != c && a != d && b != c && b != d) found.push_back(other);
    });
    std::sort(found.begin(), found.end());
    for (const std::int32_t other : found) add({{a, b, edges_(other, 0), edges_(other, 1)}, true, 0.0, 0.0});
  }
}

void SelfContact::resolve(Substep& substep, int passes) {
  std::fill(lifted_.begin(), lifted_.end(), 0.0);
  if (self_) make_contacts(substep);
  for (int k = 0; k < passes; ++k) {
    push_apart(substep);
    push_off_ground(substep);
  }
  rub(substep);
  certify(substep);
}

void SelfContact::make_contacts(const Substep& substep) {
  contacts_.clear();
  // Two vertices come closer by no more than the size of the box of all moves.
  Vector3d low = substep.end[0] - substep.start[0], high = low;
  for (std::size_t i = 1; i < substep.end.size(); ++i) {
    const Vector3d move = substep.end[i] - substep.start[i];
    low = low.cwiseMin(move);
    high = high.cwiseMax(move);
  }
  // Corrections to come included.
  const double range = 1.5 * (high - low).norm() + 1e-7;
  if (travelled_ + range - found_at_ > kReach) find_pairs(substep.start);
  for (Pair& pair : pairs_) {
    if (pair.wake > travelled_ + range) continue;
    Contact contact;
    const Vector3d way = difference(substep.start, pair.node, pair.edges, contact.weight);
    contact.gap = way.norm();
    pair.wake = travelled_ + contact.gap - pair.target;
    // The same bound for this pair alone.
    double closing = 0.0;
    for (int k = 1; k < 4; ++k)
      closing = std::max(closing, (substep.end[pair.node[k]] - substep.start[pair.node[k]] - substep.end[pair.node[0]] +
                                   substep.start[pair.node[0]])
                                      .squaredNorm());
    if (contact.gap - pair.target > 3.0 * std::sqrt(closing) + 1e-7 || contact.gap < 1e-9) continue;
    contact.pair = &pair;
    contact.normal = way / contact.gap;
    contact.wanted = std::min(pair.target, contact.gap + kRise * substep.seconds);
    contact.mobility = 0.0;
    for (int k = 0; k < 4; ++k)
      contact.mobility += contact.weight[k] * contact.weight[k] * (*substep.inverse_mass)[pair.node[k]];
    if (contact.mobility > 0.0) contacts_.push_back(contact);
  }
  travelled_ += range;
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

void SelfContact::push_off_ground(Substep& substep) {
  if (!std::isfinite(substep.floor)) return;
  for (std::size_t i = 0; i < substep.end.size(); ++i) {
    if ((*substep.inverse_mass)[i] == 0.0) continue;
    // From below the ground a vertex rises slowly.
    const double lowest = std::min(substep.floor, substep.start[i].z() + kRise * substep.seconds);
    const double lack = lowest - substep.end[i].z();
    if (lack <= 0.0) continue;
    substep.end[i].z() = lowest;
    lifted_[i] += lack;
  }
}

/// Coulomb friction: what was pushed by d along the normal is pulled back by at most mu d across it.
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
  constexpr std::array<std::array<int, 2>, 4> between_edges{{{0, 2}, {0, 3}, {1, 2}, {1, 3}}};
  constexpr std::array<std::array<int, 2>, 3> to_face{{{0, 1}, {0, 2}, {0, 3}}};
  const auto lacks = [&](const Contact& contact, const auto& combinations, const auto& act) {
    bool any = false;
    for (const auto& [a, b] : combinations) {
      const auto i = contact.pair->node[a], j = contact.pair->node[b];
      const double lack = kKeep * contact.gap - contact.normal.dot(x[i] - x[j]);
      if (lack > 1e-12) {
        any = true;
        act(i, j, lack);
      }
    }
    return any;
  };
  const auto sweep = [&](const auto& act) {
    Index count = 0;
    for (const Contact& contact : contacts_)
      count +=
          contact.pair->edges ? lacks(contact, between_edges, act(contact)) : lacks(contact, to_face, act(contact));
    return count;
  };
  Index left = contacts_.empty() ? 0 : 1;
  for (int pass = 0; pass < kCertifyPasses && left > 0; ++pass) {
    left = sweep([&](const Contact& contact) {
      return [&](std::int32_t i, std::int32_t j, double lack) {
        const double both = w[i] + w[j];
        if (both == 0.0) return;
        x[i] += (lack * w[i] / both) * contact.normal;
        x[j] -= (lack * w[j] / both) * contact.normal;
      };
    });
    if (left > 0) push_off_ground(substep);
  }
  for (int pass = 0; pass < kTogetherPasses && left > 0; ++pass) {
    left = 0;
    for (const Contact& contact : contacts_) {
      const auto nothing = [](std::int32_t, std::int32_t, double) {};
      if (!(contact.pair->edges ? lacks(contact, between_edges, nothing) : lacks(contact, to_face, nothing))) continue;
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
    if (left > 0) push_off_ground(substep);
  }
  if (left > 0) uncertified_ += left;
  push_off_ground(substep);
}

}  // namespace weft::bullet
