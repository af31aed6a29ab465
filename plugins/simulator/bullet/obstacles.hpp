#pragma once
#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "weft/garment.hpp"
#include "weft/obstacle.hpp"

namespace weft::bullet {

struct Substep;

/// Contact of the cloth with the scene's obstacles: position corrections within a substep, as on the ground. Vertices
/// keep the thickness; so do edges where they are nearest to an obstacle between their ends, and faces that the corner of
/// a box presses into. After a push of d along the normal at most mu d of the tangential move is taken back (Coulomb).
/// Contacts follow from the positions alone: what is remembered tells which points cannot touch.
class ObstacleContact {
 public:
  ObstacleContact(const Garment& garment, std::vector<Obstacle> obstacles, double thickness, double friction);

  /// Discards what is remembered, because positions will be set from outside.
  void forget() { anchor_.clear(); }
  /// Begins a substep: chooses the points that can touch in it.
  void begin(const Substep& substep);
  /// Pushes the cloth out of the obstacles.
  void push(Substep& substep);
  /// Friction of all pushes since begin().
  void rub(Substep& substep) const;

 private:
  struct Point {
    std::int32_t obstacle;
    std::int32_t v[3];
    int corners;
    double weight[3] = {1.0, 0.0, 0.0};
    Eigen::Vector3d normal = Eigen::Vector3d::Zero();  ///< of the last push
    double push = 0.0;                                 ///< m, in this substep
  };
  void choose(const Substep& substep, double reach);
  /// The point's distance and weights at the positions x. @return false if it does not touch between its corners.
  bool measure(const Point& point, const std::vector<Eigen::Vector3d>& x, double (&weight)[3],
               ObstacleDistance& at) const;

  std::vector<Obstacle> obstacles_;
  double thickness_, friction_;
  Faces faces_;
  Edges edges_;
  std::vector<Eigen::Vector3d> anchor_;  ///< positions that points_ were chosen at; empty: choose again
  std::vector<Point> points_;
};

}  // namespace weft::bullet
