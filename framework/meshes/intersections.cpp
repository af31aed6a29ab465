#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <vector>

#include "meshes/intersections.hpp"
#include "sdk/disjoint_sets.hpp"
#include "weft/error.hpp"
#include "weft/mesh.hpp"

namespace weft {
namespace {

// Exact predicates on a grid: the positions are rounded once to 2^-39 of the mesh's extent (2e-12 m for 1 m), so that
// differences fit in 40 bits and a 3x3 determinant in 123. All tests then agree with one another, also for coplanar
// layers, where floating-point signs are noise.
__extension__ using Wide = __int128;
using Point = std::array<std::int64_t, 3>;
constexpr double kGrid = 549755813888.0;  // 2^39

/// Sign of the volume of the tetrahedron a b c d.
int orientation(const Point& a, const Point& b, const Point& c, const Point& d) {
  std::array<std::int64_t, 3> u, v, w;
  for (std::size_t k = 0; k < 3; ++k) {
    u[k] = a[k] - d[k];
    v[k] = b[k] - d[k];
    w[k] = c[k] - d[k];
  }
  const Wide det = (Wide(v[1]) * w[2] - Wide(v[2]) * w[1]) * u[0] + (Wide(v[2]) * w[0] - Wide(v[0]) * w[2]) * u[1] +
                   (Wide(v[0]) * w[1] - Wide(v[1]) * w[0]) * u[2];
  return det > 0 ? 1 : det < 0 ? -1 : 0;
}

/// The segment p q passes from one side of triangle a b c to the other, through its inside or border.
bool crosses(const Point& p, const Point& q, const Point& a, const Point& b, const Point& c) {
  const int side_p = orientation(a, b, c, p);
  if (side_p == 0) return false;
  if (orientation(a, b, c, q) != -side_p) return false;
  const int ab = orientation(p, q, a, b);
  const int bc = orientation(p, q, b, c);
  if (ab * bc < 0) return false;
  const int ca = orientation(p, q, c, a);
  return ab * ca >= 0 && bc * ca >= 0;
}

struct Box3 {
  Point low, high;
  void add(const Point& p) {
    for (std::size_t k = 0; k < 3; ++k) {
      low[k] = std::min(low[k], p[k]);
      high[k] = std::max(high[k], p[k]);
    }
  }
  void add(const Box3& b) {
    add(b.low);
    add(b.high);
  }
  bool meets(const Box3& b) const {
    for (std::size_t k = 0; k < 3; ++k) {
      if (low[k] > b.high[k] || b.low[k] > high[k]) return false;
    }
    return true;
  }
};

/// Tree of boxes over triangles: median split along the longest axis, so that no mesh can make it degenerate.
class Tree {
 public:
  explicit Tree(std::vector<Box3> boxes) : boxes_(std::move(boxes)), order_(boxes_.size()) {
    for (std::size_t i = 0; i < order_.size(); ++i) order_[i] = static_cast<int>(i);
    nodes_.reserve(2 * boxes_.size() / kLeaf + 2);
    build(0, order_.size());
  }

  template <class Visit>
  void query(const Box3& box, Visit&& visit) const {
    int stack[128];
    int depth = 0;
    stack[depth++] = 0;
    while (depth > 0) {
      const Node& node = nodes_[static_cast<std::size_t>(stack[--depth])];
      if (!node.box.meets(box)) continue;
      if (node.right < 0) {
        for (std::size_t i = node.begin; i < node.end; ++i) {
          if (boxes_[static_cast<std::size_t>(order_[i])].meets(box)) visit(order_[i]);
        }
      } else {
        stack[depth++] = node.left;
        stack[depth++] = node.right;
      }
    }
  }

 private:
  static constexpr std::size_t kLeaf = 8;
  struct Node {
    Box3 box;
    std::size_t begin, end;
    int left, right;
  };

  int build(std::size_t begin, std::size_t end) {
    Box3 box = boxes_[static_cast<std::size_t>(order_[begin])];
    for (std::size_t i = begin; i < end; ++i) box.add(boxes_[static_cast<std::size_t>(order_[i])]);
    const int self = static_cast<int>(nodes_.size());
    nodes_.push_back({box, begin, end, -1, -1});
    if (end - begin <= kLeaf) return self;
    std::size_t axis = 0;
    for (std::size_t k = 1; k < 3; ++k) {
      if (box.high[k] - box.low[k] > box.high[axis] - box.low[axis]) axis = k;
    }
    const std::size_t middle = begin + (end - begin) / 2;
    const auto at = [this](std::size_t i) { return order_.begin() + static_cast<std::ptrdiff_t>(i); };
    std::nth_element(at(begin), at(middle), at(end), [this, axis](int l, int r) {
      const Box3& a = boxes_[static_cast<std::size_t>(l)];
      const Box3& b = boxes_[static_cast<std::size_t>(r)];
      return a.low[axis] + a.high[axis] < b.low[axis] + b.high[axis];
    });
    const int left = build(begin, middle);
    const int right = build(middle, end);
    nodes_[static_cast<std::size_t>(self)].left = left;
    nodes_[static_cast<std::size_t>(self)].right = right;
    return self;
  }

  std::vector<Box3> boxes_;
  std::vector<int> order_;
  std::vector<Node> nodes_;
};

/// Calls found(edge, face) for each, edge by edge, until it returns false.
template <class Found>
void visit_intersections(const Positions& positions, const Faces& faces, Found&& found) {
  if (faces.rows() == 0) return;
  if (!positions.allFinite()) throw Error("count_intersections: a position is not finite");
  if (faces.minCoeff() < 0 || faces.maxCoeff() >= positions.rows()) {
    throw ShapeError("count_intersections: a face names a vertex outside [0, " + std::to_string(positions.rows() - 1) +
                     "]");
  }
  const Eigen::RowVector3d low = positions.colwise().minCoeff();
  const double extent = (positions.colwise().maxCoeff() - low).maxCoeff();
  if (!(extent > 0.0)) return;
  const double scale = (kGrid - 1.0) / extent;
  if (!std::isfinite(scale)) throw Error("count_intersections: the mesh is too small or too large");
  std::vector<Point> points(static_cast<std::size_t>(positions.rows()));
  for (Index v = 0; v < positions.rows(); ++v) {
    for (Index k = 0; k < 3; ++k) {
      points[static_cast<std::size_t>(v)][static_cast<std::size_t>(k)] =
          std::llround((positions(v, k) - low(k)) * scale);
    }
  }
  const auto point = [&points](int v) -> const Point& { return points[static_cast<std::size_t>(v)]; };

  std::vector<Box3> boxes;
  boxes.reserve(static_cast<std::size_t>(faces.rows()));
  for (Index f = 0; f < faces.rows(); ++f) {
    Box3 box{point(faces(f, 0)), point(faces(f, 0))};
    box.add(point(faces(f, 1)));
    box.add(point(faces(f, 2)));
    boxes.push_back(box);
  }
  const Tree tree(std::move(boxes));
  const auto edges = edges_of(faces);
  bool more = true;
  for (Index e = 0; e < edges.rows() && more; ++e) {
    const int p = edges(e, 0);
    const int q = edges(e, 1);
    Box3 box{point(p), point(p)};
    box.add(point(q));
    tree.query(box, [&](int f) {
      const int a = faces(f, 0);
      const int b = faces(f, 1);
      const int c = faces(f, 2);
      if (a == p || a == q || b == p || b == q || c == p || c == q) return;
      if (more && crosses(point(p), point(q), point(a), point(b), point(c))) more = found({{p, q}, f});
    });
  }
}

}  // namespace

Index count_intersections(const Positions& positions, const Faces& faces) {
  Index count = 0;
  visit_intersections(positions, faces, [&](const Intersection&) {
    ++count;
    return true;
  });
  return count;
}

std::vector<Intersection> find_intersections(const Positions& positions, const Faces& faces, std::size_t most) {
  std::vector<Intersection> all;
  if (most == 0) return all;
  visit_intersections(positions, faces, [&](const Intersection& one) {
    all.push_back(one);
    return all.size() < most;
  });
  if (all.empty()) return all;
  DisjointSets pieces(positions.rows());
  for (Index f = 0; f < faces.rows(); ++f)
    for (const int corner : {1, 2}) pieces.unite(faces(f, 0), faces(f, corner));
  for (Intersection& one : all) one.between_pieces = pieces.root(one.edge[0]) != pieces.root(faces(one.face, 0));
  return all;
}

}  // namespace weft
