#pragma once
#include <cstdint>
#include <vector>

#include "simd.hpp"
#include "topology.hpp"
#include "weft/material.hpp"
#include "weft/obstacle.hpp"

namespace weft::cloth {

/// Contact of the cloth with the scene's obstacles, at the cloth's thickness from their surface.
///
/// Three kinds of points touch: vertices, edges where the distance along them is least (nearest_in_edge: cloth that bends
/// over a convex edge between its vertices), and faces that the corner of a box presses into (nearest_in_face). Where an
/// obstacle is flat only vertices do.
///
/// A point below the contact distance has a normal spring and dashpot, which never pull, and a tangential spring with a
/// slider at mu times the normal force [Cundall and Strack 1979], as in contact of the cloth with itself. So resting
/// cloth sticks without creep and slides at exactly mu, on meshes with scaled inertia, too, where forces go through
/// p(W L) and an impulse on one vertex would not. Under the cloth's own weight a spring gives by some micrometres. What
/// arrives faster than kEntry, or has sunk in by a part kDeep of the thickness, is stopped by an impulse with Coulomb
/// friction.
class ObstacleContact {
 public:
  /// The memory of a point. It counts only if the point was in contact in the substep before.
  struct Memory {
    float slip[3] = {0.0f, 0.0f, 0.0f};  ///< m, stretch of the tangential spring
    float mass = 0.0f;                   ///< kg, least effective mass since contact began; sets the spring
    std::uint32_t last = 0;              ///< substep
  };
  /// The whole changing state; snapshots copy it.
  struct State {
    std::vector<Memory> memory;  ///< [obstacles * (V + E + F)]
    std::uint32_t substep = 1;
  };

  ObstacleContact(const Topology& topology, const std::vector<Obstacle>& obstacles, const Fabric& fabric);

  /// Whether the short waves of the cloth have scaled inertia.
  void set_scaled(bool scaled);
  /// Empty, with room for a cloth that touches everywhere, so that the frame loop does not allocate.
  void clear(State& state);
  /// Chooses the points that can touch within a block. @param reach [V] m, what the vertices can move in it.
  void prepare(const Double4* x, const float* reach);
  /// Measures these points. @param dt, longest s: this substep, and the longest one there can be.
  void activate(State& state, const Double4* x, const Double4* v, const float* inverse_mass, double dt, double longest);
  /// Adds the forces of the points in contact.
  void add_forces(State& state, const Double4* v, double dt, Float4* forces);
  /// Stops what has sunk in too deep. @param entering also what arrives at a surface. @return whether there was any.
  bool stop(double dt, const float* inverse_mass, bool entering, Double4* v) const;
  /// Longest substep (s) at which a vertex under acceleration g (m/s^2) sinks in by a small part of the thickness.
  double longest_step(double g) const;

 private:
  /// Vertices, edges and faces of the mesh by one number.
  struct Primitive {
    std::int32_t v[3];
    std::int32_t corners;
    std::int32_t number;
  };
  struct Point {
    std::int32_t v[3];
    int corners;
    double weight[3];
    double normal[3];
    double gap;  ///< m, from the contact distance; negative: in contact
    double friction, mass, stiffness, damping;
    std::int32_t memory;
  };
  /// What can touch one obstacle within a block.
  struct Near {
    std::vector<std::int32_t> vertices;  ///< that can touch
    std::vector<std::int32_t> measured;  ///< those, and the corners of `others`
    std::vector<Primitive> others;       ///< edges and faces
  };
  void add_point(std::size_t obstacle, const Primitive& p, const double (&weight)[3], const ObstacleDistance& at,
                 const Double4* v, double dt);
  void set_stiffness(const State& state, const float* inverse_mass, double dt, double longest);

  const Topology* topology_;
  std::vector<Obstacle> obstacles_;
  double thickness_, friction_, spring_ = 0.0, dashpot_ = 0.0;
  std::int32_t primitives_;        ///< V + E + F
  std::vector<Primitive> others_;  ///< all edges, then all faces
  std::vector<Near> near_;
  std::vector<Point> points_;
  std::vector<ObstacleDistance> at_;  ///< [V] of the obstacle that is being looked at
  std::vector<std::uint8_t> flat_;    ///< [V] flat_side()
  std::vector<std::uint8_t> listed_;  ///< [V]
  std::vector<float> load_;           ///< [V] sum of |weight| over its points
};

}  // namespace weft::cloth
