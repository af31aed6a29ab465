#pragma once
#include <Eigen/Core>
#include <cstdint>
#include <utility>
#include <vector>

#include "weft/garment.hpp"

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
/// normal n is the direction between the closest points at the start of the substep, where nothing intersects. It asks
///  - that the closest points end at least the thickness apart along n (if they start closer: no closer, and rising
///    slowly, so that an overlap is no source of speed);
///  - Coulomb: the tangential move of the closest points relative to one another is taken back by at most mu times the
///    normal correction;
///  - the certificate: every vertex of the one stays on its side of every vertex of the other along n. Along n, the
///    distance between two vertices that move straight is linear in time and positive at the start, so a plane
///    separates the two throughout the substep: a pair with a certificate has not crossed. Where corrections fail to
///    restore a certificate, the vertices of the pair move as one, which keeps all their distances.
class SelfContact {
 public:
  /// @param thickness m, distance of mid-surfaces. @param self whether layers of cloth see one another.
  SelfContact(const Garment& garment, double thickness, double self_friction, bool self);

  /// Positions are to be set from outside: what was known of distances is void.
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
    std::int64_t order;  ///< of the contacts: vertex-face pairs by vertex and face, then edges
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
    std::vector<double> wake;  ///< per pair, of travelled_: before, it cannot touch
    double horizon = 0.0;      ///< of travelled_: beyond, pairs that are not listed may touch
  };

  void make_patches(const Garment& garment);
  void find_pairs(Neighbours& neighbours, double travelled, const std::vector<Eigen::Vector3d>& x) const;
  double rest_distance(const Pair& pair) const;
  void make_contacts(const Substep& substep);
  void add_contacts(std::size_t neighbours, double range, const Substep& substep);
  void push_apart(Substep& substep);
  void push_off_ground(Substep& substep);
  void rub(Substep& substep);
  void certify(Substep& substep);

  double thickness_, self_friction_;
  bool self_;
  Faces faces_;
  Eigen::Matrix<int, Eigen::Dynamic, 2, Eigen::RowMajor> edges_;
  std::vector<Eigen::Vector3d> rest_;
  std::vector<std::int32_t> piece_;  ///< connected component of each vertex
  std::vector<Patch> patches_;
  std::vector<Neighbours> neighbours_;  ///< of all patches a <= b, in this order
  // Per neighbours_, m. Apart from them because every substep goes through all.
  std::vector<double> travelled_;  ///< bound on the way of any vertex of a relative to any of b, since forget()
  std::vector<double> alarm_;      ///< of travelled_: before, nothing there can touch

  std::vector<Eigen::Vector3d> before_;                      ///< start of the substep before; empty: unknown
  std::vector<Contact> found_;                               ///< by neighbours
  std::vector<std::pair<std::int64_t, std::size_t>> order_;  ///< of found_
  std::vector<Contact> contacts_;
  std::vector<double> lifted_;  ///< m, by the ground in this substep
  Index touching_ = 0, uncertified_ = 0;
};

}  // namespace weft::bullet
