#include "patches.hpp"

#include <algorithm>
#include <array>
#include <cstddef>
#include <iterator>
#include <utility>

#include "distances.hpp"

namespace weft::cloth {
namespace {

using Point = std::array<double, 2>;

double turn(const Point& o, const Point& a, const Point& b) {
  return (a[0] - o[0]) * (b[1] - o[1]) - (a[1] - o[1]) * (b[0] - o[0]);
}

/// Counter-clockwise, by Andrew's monotone chain.
std::vector<Point> convex_hull(std::vector<Point> points) {
  std::sort(points.begin(), points.end());
  points.erase(std::unique(points.begin(), points.end()), points.end());
  std::vector<Point> hull;
  for (int side = 0; side < 2; ++side) {
    const std::size_t start = hull.size();
    for (const Point& p : points) {
      while (hull.size() >= start + 2 && turn(hull[hull.size() - 2], hull.back(), p) <= 0.0) hull.pop_back();
      hull.push_back(p);
    }
    hull.pop_back();
    std::reverse(points.begin(), points.end());
  }
  return hull;
}

/// The corners of some faces in one plane, in the order of the faces.
using Layout = std::vector<std::array<Point, 3>>;

/// Whether every edge of the mesh's border among these faces lies at the hull.
bool border_is_at(const std::vector<Point>& hull, const Topology& topology, const std::vector<std::int32_t>& faces,
                  const Layout& layout) {
  const double near = 0.5 * topology.max_edge;
  for (std::size_t i = 0; i < faces.size(); ++i)
    for (int k = 0; k < 3; ++k) {
      if (topology.opposite[faces[i]][k] >= 0) continue;
      const Point &a = layout[i][(k + 1) % 3], &b = layout[i][(k + 2) % 3];
      const Point middle{0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])};
      double best = 1e300;
      for (std::size_t j = 0; j < hull.size(); ++j)
        best = std::min(best, segment_distance2(middle, hull[j], hull[(j + 1) % hull.size()]));
      if (best > near * near) return false;
    }
  return true;
}

bool without_border(const Topology& topology, const std::vector<std::int32_t>& faces) {
  return std::all_of(faces.begin(), faces.end(), [&](std::int32_t f) {
    return std::all_of(topology.opposite[f].begin(), topology.opposite[f].end(), [](std::int32_t v) { return v >= 0; });
  });
}

/// Whether shared vertices connect the faces.
bool connected(const Topology& topology, const std::vector<std::int32_t>& faces) {
  std::vector<std::int32_t> sorted(faces), seen(faces.size(), 0), stack{0};
  std::sort(sorted.begin(), sorted.end());
  std::size_t reached = 1;
  seen[0] = 1;
  while (!stack.empty()) {
    const std::int32_t f = sorted[stack.back()];
    stack.pop_back();
    for (const std::int32_t v : topology.faces[f])
      for (std::int32_t k = topology.face_of_vertex_start[v]; k < topology.face_of_vertex_start[v + 1]; ++k) {
        const auto at = std::lower_bound(sorted.begin(), sorted.end(), topology.face_of_vertex[k]) - sorted.begin();
        if (at == static_cast<std::ptrdiff_t>(sorted.size()) || sorted[at] != topology.face_of_vertex[k] || seen[at])
          continue;
        seen[at] = 1;
        ++reached;
        stack.push_back(static_cast<std::int32_t>(at));
      }
  }
  return reached == faces.size();
}

/// Lays faces with rest frames out in one plane, each unfolded from a neighbour among them.
/// @return nothing when they do not hang together, or a vertex has several places: a tube, or a curved part.
Layout unfolded(const Topology& topology, const std::vector<std::int32_t>& faces) {
  std::vector<std::int32_t> sorted = faces;
  std::sort(sorted.begin(), sorted.end());
  const auto index_of = [&](std::int32_t f) {
    const auto at = std::lower_bound(sorted.begin(), sorted.end(), f);
    return at != sorted.end() && *at == f ? at - sorted.begin() : -1;
  };
  Layout placed(faces.size());
  std::vector<std::uint8_t> done(faces.size(), 0);
  std::vector<std::pair<std::int32_t, Point>> places;  // of each vertex, as often as it was placed
  std::vector<std::ptrdiff_t> queue{0};
  placed[0] = topology.corner[sorted[0]];
  done[0] = 1;
  for (std::size_t next = 0; next < queue.size(); ++next) {
    const std::int32_t f = sorted[queue[next]];
    const auto& own = placed[queue[next]];
    for (int k = 0; k < 3; ++k) places.emplace_back(topology.faces[f][k], own[k]);
    // From the face's frame to the plane: the turn that takes its first edge there.
    const auto &p = topology.corner[f][0], &q = topology.corner[f][1];
    const double ux = q[0] - p[0], uy = q[1] - p[1], vx = own[1][0] - own[0][0], vy = own[1][1] - own[0][1];
    const double size2 = ux * ux + uy * uy, c = (ux * vx + uy * vy) / size2, s = (ux * vy - uy * vx) / size2;
    for (int k = 0; k < 3; ++k) {
      const std::int32_t g = topology.neighbour[f][k];
      const std::ptrdiff_t at = g < 0 ? -1 : index_of(g);
      if (at < 0 || done[at]) continue;
      for (int j = 0; j < 3; ++j) {
        const std::int32_t v = topology.faces[g][j];
        if (v == topology.opposite[f][k]) {
          const double x = topology.beyond[f][k][0] - p[0], y = topology.beyond[f][k][1] - p[1];
          placed[at][j] = {own[0][0] + c * x - s * y, own[0][1] + s * x + c * y};
        } else {
          placed[at][j] = own[topology.faces[f][0] == v ? 0 : topology.faces[f][1] == v ? 1 : 2];
        }
      }
      done[at] = 1;
      queue.push_back(at);
    }
  }
  if (queue.size() != faces.size()) return {};
  std::sort(places.begin(), places.end());
  const double close = 0.1 * topology.mean_edge;
  for (std::size_t k = 1; k < places.size(); ++k) {
    if (places[k].first != places[k - 1].first) continue;
    const double dx = places[k].second[0] - places[k - 1].second[0], dy = places[k].second[1] - places[k - 1].second[1];
    if (dx * dx + dy * dy > close * close) return {};
  }
  Layout layout;
  for (const std::int32_t f : faces) layout.push_back(placed[index_of(f)]);
  return layout;
}

Layout layout_of(const Topology& topology, const std::vector<std::int32_t>& faces) {
  if (topology.frames) return unfolded(topology, faces);
  Layout layout;
  for (const std::int32_t f : faces) layout.push_back(topology.corner[f]);
  return layout;
}

/// One connected piece whose area fills its convex hull to 85 %, without cuts: every border edge lies at the hull.
bool nearly_convex(const Topology& topology, const std::vector<std::int32_t>& faces) {
  const Layout layout = layout_of(topology, faces);
  if (layout.empty()) return false;
  std::vector<Point> points;
  double area = 0.0, hull_area = 0.0;
  for (std::size_t i = 0; i < faces.size(); ++i) {
    area += topology.area[faces[i]];
    points.insert(points.end(), layout[i].begin(), layout[i].end());
  }
  const std::vector<Point> hull = convex_hull(std::move(points));
  for (std::size_t k = 0; k < hull.size(); ++k)
    hull_area += 0.5 * turn({0.0, 0.0}, hull[k], hull[(k + 1) % hull.size()]);
  if (topology.frames && area > 1.02 * hull_area) return false;  // what is unfolded covers itself
  return area >= 0.85 * hull_area && border_is_at(hull, topology, faces, layout) && connected(topology, faces);
}

class Builder {
 public:
  Builder(const Topology& topology, PatchTree& tree)
      : topology_(topology),
        tree_(tree),
        order_(topology.faces.size()),
        vertex_taken_(topology.vertices, 0),
        edge_taken_(topology.edges.size(), 0) {
    for (std::size_t f = 0; f < order_.size(); ++f) order_[f] = static_cast<std::int32_t>(f);
    std::stable_sort(order_.begin(), order_.end(),
                     [&](std::int32_t f, std::int32_t g) { return topology_.part[f] < topology_.part[g]; });
    chain(0);
    look_around();
  }

 private:
  /// Three times a coordinate of the face's centre, m.
  double centre(std::int32_t face, int axis) const {
    double sum = 0.0;
    for (const std::int32_t v : topology_.faces[face]) sum += topology_.place[v][axis];
    return sum;
  }

  std::int32_t add_node() {
    PatchNode node{};
    node.left = node.right = node.patch = -1;
    tree_.nodes.push_back(node);
    return static_cast<std::int32_t>(tree_.nodes.size()) - 1;
  }

  /// Parts hang in a chain: a node over the first and the rest of them.
  std::int32_t chain(std::int32_t begin) {
    const auto face_total = static_cast<std::int32_t>(order_.size());
    std::int32_t end = begin;
    while (end < face_total && topology_.part[order_[end]] == topology_.part[order_[begin]]) ++end;
    if (end == face_total) return split(begin, end);
    const std::int32_t node = add_node();
    const std::int32_t left = split(begin, end);
    const std::int32_t right = chain(end);
    tree_.nodes[node].left = left, tree_.nodes[node].right = right;
    return node;
  }

  std::int32_t split(std::int32_t begin, std::int32_t end) {
    const std::int32_t node = add_node();
    const std::vector<std::int32_t> faces(order_.begin() + begin, order_.begin() + end);
    tree_.nodes[node].convex = nearly_convex(topology_, faces);
    if (end - begin <= 8) {
      tree_.nodes[node].patch = static_cast<std::int32_t>(tree_.patches.size());
      add_patch(faces);
      return node;
    }
    const std::int32_t middle = part(begin, end);
    const std::int32_t left = split(begin, middle);
    const std::int32_t right = split(middle, end);
    tree_.nodes[node].left = left, tree_.nodes[node].right = right;
    return node;
  }

  /// Sorts the faces into two halves along the longer side of their box. @return where the second half begins.
  std::int32_t part(std::int32_t begin, std::int32_t end) {
    double low[3] = {1e300, 1e300, 1e300}, high[3] = {-1e300, -1e300, -1e300};
    for (std::int32_t k = begin; k < end; ++k)
      for (int axis = 0; axis < 3; ++axis) {
        low[axis] = std::min(low[axis], centre(order_[k], axis));
        high[axis] = std::max(high[axis], centre(order_[k], axis));
      }
    int axis = high[0] - low[0] >= high[1] - low[1] ? 0 : 1;
    if (high[2] - low[2] > high[axis] - low[axis]) axis = 2;  // never of a chart
    // Whole patches of eight on the left, so that few lanes stay empty.
    const std::int32_t half = ((end - begin) / 2 + 7) / 8 * 8;
    const std::int32_t middle = begin + std::min(half, end - begin - 1);
    std::nth_element(order_.begin() + begin, order_.begin() + middle, order_.begin() + end,
                     [&](std::int32_t f, std::int32_t g) {
                       const double p = centre(f, axis), q = centre(g, axis);
                       return p != q ? p < q : f < g;
                     });
    return middle;
  }

  void add_patch(const std::vector<std::int32_t>& faces) {
    std::vector<std::int32_t> vertices, edges;
    for (const std::int32_t f : faces) {
      for (int k = 0; k < 3; ++k) {
        const std::int32_t v = topology_.faces[f][k], w = topology_.faces[f][(k + 1) % 3];
        if (!vertex_taken_[v]) vertex_taken_[v] = 1, vertices.push_back(v);
        const std::array<std::int32_t, 2> edge{std::min(v, w), std::max(v, w)};
        const auto at = static_cast<std::int32_t>(
            std::lower_bound(topology_.edges.begin(), topology_.edges.end(), edge) - topology_.edges.begin());
        if (!edge_taken_[at]) edge_taken_[at] = 1, edges.push_back(at);
      }
    }
    Patch patch;
    emit(tree_.faces, faces, patch.faces, [&](std::int32_t f, int c) { return topology_.faces[f][c]; });
    emit(tree_.vertices, vertices, patch.vertices, [](std::int32_t v, int) { return v; });
    emit(tree_.edges, edges, patch.edges, [&](std::int32_t e, int c) { return topology_.edges[e][c % 2]; });
    tree_.patches.push_back(patch);
  }

  /// Appends primitives in blocks of eight. @param corner (primitive, k): its k-th vertex.
  template <class Corner>
  static void emit(std::vector<BoxBlock>& blocks, const std::vector<std::int32_t>& ids, std::int32_t (&range)[2],
                   Corner&& corner) {
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
  }

  /// Lists the leaves around each patch.
  void look_around() {
    std::vector<std::int32_t> leaf_of_face(topology_.faces.size());
    std::vector<std::vector<std::int32_t>> faces_of(tree_.patches.size());
    for (std::size_t n = 0; n < tree_.nodes.size(); ++n) {
      if (tree_.nodes[n].patch < 0) continue;
      const Patch& patch = tree_.patches[tree_.nodes[n].patch];
      for (std::int32_t b = patch.faces[0]; b < patch.faces[1]; ++b)
        for (const std::int32_t f : tree_.faces[b].id) {
          if (f < 0) continue;
          leaf_of_face[f] = static_cast<std::int32_t>(n);
          faces_of[tree_.nodes[n].patch].push_back(f);
        }
    }
    const auto neighbours = [&](const std::vector<std::int32_t>& leaves) {
      std::vector<std::int32_t> near;
      for (const std::int32_t leaf : leaves)
        for (const std::int32_t f : faces_of[tree_.nodes[leaf].patch])
          for (const std::int32_t v : topology_.faces[f])
            for (std::int32_t k = topology_.face_of_vertex_start[v]; k < topology_.face_of_vertex_start[v + 1]; ++k)
              near.push_back(leaf_of_face[topology_.face_of_vertex[k]]);
      std::sort(near.begin(), near.end());
      near.erase(std::unique(near.begin(), near.end()), near.end());
      return near;
    };
    const auto put = [](std::vector<std::int32_t>& starts, std::vector<std::int32_t>& list,
                        const std::vector<std::int32_t>& more) {
      if (starts.empty()) starts.push_back(0);
      list.insert(list.end(), more.begin(), more.end());
      starts.push_back(static_cast<std::int32_t>(list.size()));
    };
    for (const auto& own : faces_of) {
      const std::vector<std::int32_t> near = neighbours({leaf_of_face[own[0]]}), around = neighbours(near);
      std::vector<std::int32_t> faces;
      for (const std::int32_t leaf : around) {
        const auto& more = faces_of[tree_.nodes[leaf].patch];
        faces.insert(faces.end(), more.begin(), more.end());
      }
      tree_.round.push_back(without_border(topology_, faces) || nearly_convex(topology_, faces));
      put(tree_.near_start, tree_.near, near);
      put(tree_.around_start, tree_.around, around);
    }
  }

  const Topology& topology_;
  PatchTree& tree_;
  std::vector<std::int32_t> order_;  ///< faces; a node's are next to each other
  std::vector<std::uint8_t> vertex_taken_, edge_taken_;
};

}  // namespace

PatchTree::PatchTree(const Topology& topology) { Builder(topology, *this); }

}  // namespace weft::cloth
