#pragma once
#include <array>
#include <optional>
#include <vector>

#include "weft/types.hpp"

namespace weft {

/// Finds the nearest point of a triangle mesh: a tree of boxes over the faces, built once.
class NearestSurface {
 public:
  struct Hit {
    Vec3 point;
    Vec3 weights;  ///< of the face's corners; they add up to 1
    int face = -1;
    double distance = 0.0;
  };
  /// @param faces at least one.
  NearestSurface(std::vector<Vec3> positions, std::vector<std::array<int, 3>> faces);
  /// @param facing if given, only faces whose normal does not look the other way, where there are any. So the layers of
  /// a thin garment are kept apart.
  Hit nearest(const Vec3& p, const std::optional<Vec3>& facing = std::nullopt) const;
  const std::array<int, 3>& face(int f) const { return faces_[static_cast<std::size_t>(f)]; }

 private:
  struct Node {
    Vec3 low, high;
    int begin, end;   // in order_, of a leaf
    int left, right;  // -1: a leaf
  };
  int build(int begin, int end);
  void search(int node, const Vec3& p, const Vec3* facing, Hit& best) const;

  std::vector<Vec3> positions_;
  std::vector<std::array<int, 3>> faces_;
  std::vector<int> order_;
  std::vector<Node> nodes_;
};

/// The one-sided Hausdorff distance, sampled: the largest distance of the vertices, edge midpoints and face centres of
/// a mesh from a surface, m.
double distance_from_surface(const std::vector<Vec3>& positions, const std::vector<std::array<int, 3>>& faces,
                             const NearestSurface& surface);

}  // namespace weft
