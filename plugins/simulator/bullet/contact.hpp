#pragma once
#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <utility>
#include <vector>

#include "obstacles.hpp"
#include "weft/rest_shape.hpp"

namespace weft::bullet {

/// Positions of one substep, as the contacts read and move them. No Bullet type: bullet.cpp copies in and out.
struct Substep {
  double seconds = 0.0;
  double floor = 0.0;                                 ///< m, lowest z of a free vertex; -inf: no ground
  double friction = 0.0;                              ///< cloth on ground
  std::vector<Eigen::Vector3d> start;                 ///< m
  std::vector<Eigen::Vector3d> end;                   ///< m: predicted and linked on entry
  const std::vector<double>* inverse_mass = nullptr;  ///< 1/kg, zero for held and pinned vertices
};

/// Contact of the cloth with itself and with the ground: position corrections within a substep.
///
/// Every vertex-face and edge-edge pair that may come closer than the thickness in this substep is a contact. Its
/// normal n is the direction between the closest points at the start of the substep, where nothing intersects. A
/// contact enforces
///  - the gap: the closest points end at least the thickness apart along n. Points that start closer do not approach,
///    and separate slowly, so that an overlap adds no speed;
///  - Coulomb friction: the tangential move of the closest points relative to one another is taken back by at most mu
///    times the normal correction;
///  - the certificate: every vertex of one primitive stays on its side of every vertex of the other along n. Along n,
///    the distance between two vertices that move straight is linear in time and positive at the start. So a
///    plane separates the two throughout the substep, and a pair with a certificate has not crossed. Where corrections
///    fail to restore a certificate, the vertices of the pair move as one, which keeps all their distances.
class SelfContact {
 public:
  /// @param thickness m, distance of mid-surfaces. @param self whether layers of cloth touch one another.
  /// @param obstacles empty, or those of the scene.
  SelfContact(const Garment& garment, double thickness, double self_friction, bool self, ObstacleContact obstacles);

  /// Discards all bounds on distances, because positions will be set from outside.
  void forget();
  /// Corrects substep.end.
  void resolve(Substep& substep, int passes);

  Index touching() const { return touching_; }        ///< self-contacts that pushed in the last substep
  Index uncertified() const { return uncertified_; }  ///< pairs left without a certificate since construction

 private:
  /// A vertex and a face (v, f0, f1, f2), or two edges (a0, a1, b0, b1).
  struct Pair {
    std::int32_t node[4];
    bool edges;
    double target;       ///< m
    std::int64_t order;  ///< sort key: vertex-face pairs by vertex and face, then edges
  };
  struct Contact {
    const Pair* pair;
    double weight[4];  ///< of the closest points' difference
    Eigen::Vector3d normal;
    double gap;         ///< m, at the start
    double wanted;      ///< m, at the end
    double mobility;    ///< sum of weight^2 / mass, 1/kg
    double push = 0.0;  ///< m, sum of the corrections of the gap
  };
  /// A piece of the sheet that moves as a piece. Every vertex, face and edge belongs to one patch.
  struct Patch {
    std::vector<std::int32_t> vertices, faces, edges;
    std::vector<std::int32_t> reach;  ///< the vertices, and those of its faces and edges
  };
  /// Two patches, or one with itself: the pairs between them that are close.
  struct Neighbours {
    std::int32_t a, b;
    std::vector<Pair> pairs;
    std::vector<double> wake;  ///< per pair: it cannot touch before travelled_ reaches this
    double horizon = 0.0;      ///< beyond this travelled_, pairs that are not listed may touch
  };

  void make_patches(const Garment& garment);
  void find_pairs(Neighbours& neighbours, double travelled, const std::vector<Eigen::Vector3d>& x) const;
  double rest_distance(const Pair& pair) const;
  void make_contacts(const Substep& substep);
  void add_contacts(std::size_t neighbours, double range, const Substep& substep);
  void push_apart(Substep& substep);
  /// Off the ground and the obstacles.
  void push_off(Substep& substep);
  void rub(Substep& substep);
  void certify(Substep& substep);

  double thickness_, self_friction_;
  bool self_;
  ObstacleContact obstacles_;
  Faces faces_;
  Eigen::Matrix<int, Eigen::Dynamic, 2, Eigen::RowMajor> edges_;
  std::vector<Eigen::Vector3d> rest_;  ///< m, in the plane; with frames as the garment was drawn
  std::optional<RestShape> frames_;    ///< of a garment that has some
  std::vector<std::int32_t> piece_;    ///< connected component of each vertex
  std::vector<Patch> patches_;
  std::vector<Neighbours> neighbours_;  ///< of all patches a <= b, in this order
  // Per entry of neighbours_, m. Stored apart, because every substep visits all of them.
  std::vector<double> travelled_;  ///< bound on the relative motion of any vertex of a and any of b, since forget()
  std::vector<double> alarm_;      ///< no pair there can touch before travelled_ reaches this

  std::vector<Eigen::Vector3d> before_;                      ///< start of the previous substep; empty: unknown
  std::vector<Contact> found_;                               ///< by neighbours
  std::vector<std::pair<std::int64_t, std::size_t>> order_;  ///< of found_
  std::vector<Contact> contacts_;
  std::vector<double> lifted_;  ///< m, lift by the ground in this substep
  Index touching_ = 0, uncertified_ = 0;
};

}  // namespace weft::bullet
