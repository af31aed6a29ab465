#include "meshes/nearest_surface.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <limits>

#include "weft/error.hpp"

namespace weft {
namespace {

/// Barycentric weights of the point of triangle a b c nearest to p (Ericson 2005, Real-Time Collision Detection,
/// 5.1.5).
Vec3 nearest_weights(const Vec3& p, const Vec3& a, const Vec3& b, const Vec3& c) {
  const Vec3 ab = b - a, ac = c - a, ap = p - a;
  const double d1 = ab.dot(ap), d2 = ac.dot(ap);
  if (d1 <= 0.0 && d2 <= 0.0) return Vec3(1.0, 0.0, 0.0);
  const Vec3 bp = p - b;
  const double d3 = ab.dot(bp), d4 = ac.dot(bp);
  if (d3 >= 0.0 && d4 <= d3) return Vec3(0.0, 1.0, 0.0);
  const double vc = d1 * d4 - d3 * d2;
  if (vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0) {
    const double v = d1 / (d1 - d3);
    return Vec3(1.0 - v, v, 0.0);
  }
  const Vec3 cp = p - c;
  const double d5 = ab.dot(cp), d6 = ac.dot(cp);
  if (d6 >= 0.0 && d5 <= d6) return Vec3(0.0, 0.0, 1.0);
  const double vb = d5 * d2 - d1 * d6;
  if (vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0) {
    const double w = d2 / (d2 - d6);
    return Vec3(1.0 - w, 0.0, w);
  }
  const double va = d3 * d6 - d5 * d4;
  if (va <= 0.0 && d4 - d3 >= 0.0 && d5 - d6 >= 0.0) {
    const double w = (d4 - d3) / ((d4 - d3) + (d5 - d6));
    return Vec3(0.0, 1.0 - w, w);
  }
  const double sum = va + vb + vc;
  return Vec3(va, vb, vc) / sum;
}

double distance2_to_box(const Vec3& p, const Vec3& low, const Vec3& high) {
  return (low - p).cwiseMax(p - high).cwiseMax(0.0).squaredNorm();
}

}  // namespace

NearestSurface::NearestSurface(std::vector<Vec3> positions, std::vector<std::array<int, 3>> faces)
    : positions_(std::move(positions)), faces_(std::move(faces)), order_(faces_.size()) {
  if (faces_.empty()) throw ShapeError("nearest_surface: a mesh without faces");
  for (std::size_t i = 0; i < order_.size(); ++i) order_[i] = static_cast<int>(i);
  build(0, static_cast<int>(order_.size()));
}

int NearestSurface::build(int begin, int end) {
  constexpr int kLeafFaces = 6;
  const auto corner = [this](int i, int k) -> const Vec3& {
    const auto& t = faces_[static_cast<std::size_t>(order_[static_cast<std::size_t>(i)])];
    return positions_[static_cast<std::size_t>(t[static_cast<std::size_t>(k)])];
  };
  Node node{corner(begin, 0), corner(begin, 0), begin, end, -1, -1};
  for (int i = begin; i < end; ++i) {
    for (int k = 0; k < 3; ++k) {
      node.low = node.low.cwiseMin(corner(i, k));
      node.high = node.high.cwiseMax(corner(i, k));
    }
  }
  const int self = static_cast<int>(nodes_.size());
  nodes_.push_back(node);
  if (end - begin <= kLeafFaces) return self;
  Index axis = 0;
  (node.high - node.low).maxCoeff(&axis);
  const int middle = begin + (end - begin) / 2;
  const auto centre = [&](int f) {
    const auto& t = faces_[static_cast<std::size_t>(f)];
    double sum = 0.0;
    for (const int v : t) sum += positions_[static_cast<std::size_t>(v)](axis);
    return sum;
  };
  std::nth_element(order_.begin() + begin, order_.begin() + middle, order_.begin() + end,
                   [&](int l, int r) { return centre(l) < centre(r); });
  const int left = build(begin, middle);
  const int right = build(middle, end);
  nodes_[static_cast<std::size_t>(self)].left = left;
  nodes_[static_cast<std::size_t>(self)].right = right;
  return self;
}

void NearestSurface::search(int n, const Vec3& p, const Vec3* facing, Hit& best) const {
  const Node& node = nodes_[static_cast<std::size_t>(n)];
  const auto too_far = [&](const Node& box) {
    return distance2_to_box(p, box.low, box.high) >= best.distance * best.distance;
  };
  if (node.left < 0) {
    for (int i = node.begin; i < node.end; ++i) {
      const int f = order_[static_cast<std::size_t>(i)];
      const auto& t = faces_[static_cast<std::size_t>(f)];
      const Vec3 &a = positions_[static_cast<std::size_t>(t[0])], &b = positions_[static_cast<std::size_t>(t[1])],
                 &c = positions_[static_cast<std::size_t>(t[2])];
      if (facing != nullptr && (b - a).cross(c - a).dot(*facing) < 0.0) continue;
      const Vec3 weights = nearest_weights(p, a, b, c);
      const Vec3 point = weights(0) * a + weights(1) * b + weights(2) * c;
      const double distance = (p - point).norm();
      if (distance < best.distance) best = {point, weights, f, distance};
    }
    return;
  }
  const Node &left = nodes_[static_cast<std::size_t>(node.left)], &right = nodes_[static_cast<std::size_t>(node.right)];
  const bool left_first = distance2_to_box(p, left.low, left.high) <= distance2_to_box(p, right.low, right.high);
  for (const int child : {left_first ? node.left : node.right, left_first ? node.right : node.left}) {
    if (!too_far(nodes_[static_cast<std::size_t>(child)])) search(child, p, facing, best);
  }
}

NearestSurface::Hit NearestSurface::nearest(const Vec3& p, const std::optional<Vec3>& facing) const {
  Hit best;
  best.distance = std::numeric_limits<double>::infinity();
  if (facing) search(0, p, &*facing, best);
  if (best.face < 0) search(0, p, nullptr, best);
  return best;
}

double distance_from_surface(const std::vector<Vec3>& positions, const std::vector<std::array<int, 3>>& faces,
                             const NearestSurface& surface) {
  double largest = 0.0;
  const auto sample = [&](const Vec3& p) { largest = std::max(largest, surface.nearest(p).distance); };
  for (const auto& t : faces) {
    const Vec3 &a = positions[static_cast<std::size_t>(t[0])], &b = positions[static_cast<std::size_t>(t[1])],
               &c = positions[static_cast<std::size_t>(t[2])];
    for (const Vec3& p : {a, b, c, Vec3((a + b) / 2.0), Vec3((b + c) / 2.0), Vec3((c + a) / 2.0)}) sample(p);
    sample((a + b + c) / 3.0);
  }
  return largest;
}

}  // namespace weft
