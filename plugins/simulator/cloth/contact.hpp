#pragma once
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "contact_search.hpp"
#include "simd.hpp"
#include "topology.hpp"
#include "weft/material.hpp"

namespace weft::cloth {

/// Ground contact of a vertex at height z that would go below the ground in the step x += dt v. The normal impulse
/// keeps it just above. The tangential impulse opposes the motion and is at most mu times the normal one. Where it can,
/// it takes all of the motion, so that a sticking vertex is exactly at rest.
inline __m256d meet_ground(double z, double dt, double floor, double mu, __m256d v) {
  const __m128d xy = _mm256_castpd256_pd128(v);
  const double vx = _mm_cvtsd_f64(xy), vy = _mm_cvtsd_f64(_mm_unpackhi_pd(xy, xy));
  const double vz = _mm_cvtsd_f64(_mm256_extractf128_pd(v, 1));
  const double allowed = z > floor ? (floor - z) / dt : 0.0;  // <= 0
  const double grip = mu * std::max(0.0, allowed - vz), sliding2 = vx * vx + vy * vy;
  const double left = sliding2 <= grip * grip ? 0.0 : 1.0 - grip / std::sqrt(sliding2);  // most vertices stick
  // In registers: three numbers stored and read again as one vector would stall the load.
  return _mm256_blend_pd(_mm256_mul_pd(v, _mm256_set1_pd(left)), _mm256_set1_pd(std::max(vz, allowed)), 4);
}

/// Contact of the cloth with itself: vertex-triangle and edge-edge pairs.
///
/// Three levels, each reused as long as motion allows. All bounds are path lengths, not speeds:
///   candidates  pairs that can come within thickness on the paths of their vertices (ContactSearch)
///   due         a candidate is measured again only when its vertices may have moved as far as its last free gap
///   active      pairs in contact: measured in every substep. (Keeping normals for a few substeps delays the forces
///               that turn with the cloth, which is negative damping: 2 to 5 % of folds never came to rest.)
/// An active pair with gap g below its distance d has a normal spring and dashpot, which never pull. It also has a
/// tangential spring with a slider at mu times the normal force (Cundall & Strack 1979): resting layers stick without
/// creep, and slide at exactly mu. The spring is as stiff as the substep allows; under a layer's weight it gives by
/// some micrometres. A pair that would come closer than half its distance within a substep is stopped by an inelastic
/// impulse, so that no pair passes through. The side of a pair is remembered as long as it is a candidate.
class SelfContact {
 public:
  /// A pair in one substep.
  struct Active {
    std::int32_t v[4];
    float weight[4];  ///< point on the first minus point on the second = sum weight x
    float gap;        ///< m, negative on the wrong side
    float depth;      ///< m, Candidate::present - gap
    float least;      ///< m, half of Candidate::distance
    float stiffness;  ///< N/m
    float damping;    ///< N s/m
    Contact* contact;
  };
  /// The whole changing state; snapshots copy it.
  struct State : ContactSearch::State {
    std::int64_t touching = 0;  ///< active pairs with force in the last substep
  };

  /// @param tree of the topology. @param spring part of the explicit limit dt^2 lambda = 4 that the springs of contact take.
  /// @param yield a pair pressed deeper than this part (below 0.5) of its distance yields: it keeps the gap it has.
  /// @param piecewise see ContactSearch.
  SelfContact(const Topology& topology, const PatchTree& tree, const Fabric& fabric, float spring, float yield,
              std::int32_t piecewise = 2000);

  /// Makes sure that the candidates are valid for the next block (ContactSearch).
  void prepare(State& state, const Double4* x, const Double4* v, const Fixed4* fixed, double unit,
               double block_seconds) const {
    search_.prepare(state, x, v, fixed, unit, block_seconds);
  }
  double slack() const { return search_.slack(); }  ///< m, see ContactSearch::State
  /// Chooses the candidates that can touch until the paths reach `bound` [V] m.
  void select(State& state, const float* bound) const;
  /// Measures the selected candidates; those in contact, or close to it, become active, with their stiffness.
  /// @param moved [V] m, in the last substep. @param dt, longest s: this substep, and the longest one there can be.
  void activate(State& state, const Fixed4* fixed, double unit, const float* moved, const float* inverse_mass, float dt,
                float longest) const;
  /// Adds the forces of the active pairs.
  void add_forces(State& state, const Float4* v, float dt, Float4* forces) const;
  bool has_fast() const { return !scratch_.fast.empty(); }
  /// Applies inelastic impulses to the velocities, so that in the step x += dt v no pair comes closer than half its
  /// distance. No vertex goes below floor (m) in that step.
  void stop(const Double4* x, double dt, double floor, double ground_friction, const float* inverse_mass,
            Double4* v) const;
  /// Longest substep (s) at which a layer under acceleration g (m/s^2) sinks in by at most this part of the thickness.
  double longest_step(double g, double part) const;
  void set_spring(float part) { spring_ = part; }  ///< see the constructor
  /// Empty, with room for a fully folded cloth, so that the frame loop does not allocate.
  void clear(State& state) const;

 private:
  /// Room for activate(), kept so that the frame loop does not allocate.
  struct Scratch {
    std::vector<float> load;
    std::vector<std::int32_t> soon_faces, soon_edges;  ///< candidates selected for the block
    std::vector<Active> active;
    std::vector<std::int32_t> fast;               ///< active pairs that may come closer than half their distance
    std::vector<std::uint32_t> changed, visited;  ///< [V], [fast] count of visits at the last impulse, the last visit
  };
  template <bool kEdges>
  void activate_pairs(State& state, const std::vector<std::int32_t>& soon, const Fixed4* fixed, double unit,
                      const float* moved, float dt) const;
  void set_stiffness(const float* inverse_mass, float longest) const;
  /// Passes over the fast pairs. A pair whose vertices have not changed since it was visited is skipped.
  /// @param grounded impulses do not press vertices into the ground.
  void stop_pairs(const Double4* x, double dt, double floor, const float* inverse_mass, Double4* v,
                  bool grounded) const;
  static void let_go(Candidate& pair, Contact& contact);
  bool elsewhere(const Candidate& pair, const float (&weight)[4], const Fixed4* fixed) const;

  const Topology* topology_;
  float thickness_ = 0.0f;
  float friction_ = 0.0f;
  float spring_ = 0.0f;
  float yield_ = 0.0f;
  ContactSearch search_;
  mutable Scratch scratch_;
};

}  // namespace weft::cloth
