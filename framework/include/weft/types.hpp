#pragma once
#include <Eigen/Core>
#include <cstddef>
#include <string>
#include <vector>

/// Types that cross the plugin interfaces. SI units; z is up; the work surface is z = 0.
namespace weft {

using Index = Eigen::Index;
using Vec2 = Eigen::Matrix<double, 2, 1, Eigen::DontAlign>;
using Vec3 = Eigen::Matrix<double, 3, 1, Eigen::DontAlign>;
using Vector = Eigen::VectorXd;
/// Column-major: column i is instance i.
using Matrix = Eigen::MatrixXd;
using ConstVec = Eigen::Ref<const Vector>;
using ConstMatrix = Eigen::Ref<const Matrix>;
/// [n, 3] m, row per vertex.
using Positions = Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor>;
/// [n, 2] m, row per vertex: rest coordinates, x = warp, y = weft.
using RestPositions = Eigen::Matrix<double, Eigen::Dynamic, 2, Eigen::RowMajor>;
/// [f, 4] m, row per face: its rest frame [2, 2]. The edges from corner 0 to corners 1 and 2, each as (warp, weft).
using RestFrames = Eigen::Matrix<double, Eigen::Dynamic, 4, Eigen::RowMajor>;
/// [e, 2] vertex indices, first < second.
using Edges = Eigen::Matrix<int, Eigen::Dynamic, 2, Eigen::RowMajor>;
/// [f, 3] vertex indices, counter-clockwise seen from above in the rest shape.
using Faces = Eigen::Matrix<int, Eigen::Dynamic, 3, Eigen::RowMajor>;
/// Row-major: one row per segment, per frame, ...
using RowMatrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
/// m_i of eq. 1: [k, C], one row per segment. The arc has C = 5 per-frame deltas, constant within a segment.
using Controls = RowMatrix;

/// The size of a type that crosses an interface. The loader compares the sizes of a plugin with those of the program.
struct TypeSize {
  const char* type;
  std::size_t bytes;
};

/// Length of a simulation frame, s.
inline constexpr double kFrameSeconds = 1.0 / 60.0;
/// Frames per segment: the control update interval of the paper, section 2.1.
inline constexpr Index kFramesPerSegment = 12;

/// Closed box; lower and upper have the same length and lower <= upper.
struct Box {
  Vector lower;
  Vector upper;
  Index dim() const { return lower.size(); }
  Vector clamp(ConstVec x) const { return x.cwiseMax(lower).cwiseMin(upper); }
};

/// The fixed inputs of a manipulation (section 2.1): the paper's g_0, d and h.
struct Manipulation {
  std::vector<Index> grasp_vertices;  ///< vertices held by hand 1 and hand 2
  Positions grasp_points;             ///< [2, 3] m: g_0^1, g_0^2
  Vec2 displacement = Vec2::Zero();   ///< d, m, XY: displacement of the grasp points' midpoint
  double drop_height = 0.05;          ///< h, m: height of the grasp points at theta = 180 deg
  double contact_height = 0.0;        ///< m: the targets stay above it (mid-surface resting on the ground)
  /// [G] in (0, 1]: the progress at which each hand opens, at the end of that segment, while the others go on; 1: at the
  /// release. Empty: all of them at the release. At least one hand has 1.
  Vector opens_at;
};

}  // namespace weft
