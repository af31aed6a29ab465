#pragma once
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "simd.hpp"
#include "topology.hpp"
#include "weft/material.hpp"

namespace weft::cloth {

/// Velocity of a vertex at height z that would go below the ground in the step x += dt v. The normal impulse is what
/// keeps it above; the tangential one is at most mu times it, against the motion, and takes all of it where it can:
/// sticking is exactly at rest.
inline __m256d meet_ground(double z, double dt, double floor, double mu, __m256d v) {
  const __m128d xy = _mm256_castpd256_pd128(v);
  const double vx = _mm_cvtsd_f64(xy), vy = _mm_cvtsd_f64(_mm_unpackhi_pd(xy, xy));
  const double vz = _mm_cvtsd_f64(_mm256_extractf128_pd(v, 1));
  const double allowed = z > floor ? (floor - z) / dt : 0.0;  // <= 0
  const double stopped = std::max(0.0, allowed - vz);
  const double sliding = std::sqrt(vx * vx + vy * vy);
  const double left = sliding <= mu * stopped ? 0.0 : 1.0 - mu * stopped / sliding;
  // In registers: three numbers stored and read again as one vector would stall the load.
  return _mm256_blend_pd(_mm256_mul_pd(v, _mm256_set1_pd(left)), _mm256_set1_pd(std::max(vz, allowed)), 4);
}

/// Contact of the cloth with itself: vertex-triangle and edge-edge pairs.
///
/// Three levels, each reused as long as motion allows. All bounds are path lengths, not speeds:
///   candidates  pairs that can come within thickness while every vertex keeps near the straight path that it was on
///   when
///               they were found: neighbours that move together do not count
///   due         a candidate is measured again only when its vertices may have moved as far as its last free gap
///   active      pairs in contact: measured in every substep. (Keeping normals for a few substeps delays the forces
///   that
///               turn with the cloth, which is negative damping: 2 to 5 % of folds never came to rest.)
/// Force of an active pair with gap g below its distance d: normal spring and dashpot, never pulling, and a tangential
/// spring with a slider at mu times the normal force (Cundall & Strack 1979): resting layers stick without creep, and
/// slide at exactly mu. The spring is as stiff as the substep allows, some micrometres deep under a layer's weight.
/// A pair that would come closer than half its distance within a substep is stopped by an inelastic impulse, so that no
/// pair passes through. The side of a pair is remembered as long as it is a candidate.
class SelfContact {
 public:
  /// What is looked at for every pair in every block. Half a cache line.
  struct Candidate {
    std::int32_t v[4];  ///< vertex, triangle | edge, edge
    std::int32_t face;  ///< of the triangle, or -1
    float due;          ///< measure when the sum of the four path bounds reaches this, m
    float distance;     ///< m, contact distance of this pair
    float present;      ///< m, <= distance: what is left of it after an overload; negative: not active
  };
  /// What a pair remembers of its contact.
  struct Contact {
    float normal[3];  ///< last direction from the second to the first; zero: unknown
    float mass;       ///< kg, least effective mass since it is in contact; sets the spring
    float slip[3];    ///< m, stretch of the tangential spring
    float unused = 0.0f;
    bool met() const { return normal[0] != 0.0f || normal[1] != 0.0f || normal[2] != 0.0f; }
  };
  static_assert(sizeof(Candidate) == 32 && sizeof(Contact) == 32);
  struct Pairs {
    std::vector<Candidate> candidate;
    std::vector<Contact> contact;  ///< of the candidates
    std::size_t size() const { return candidate.size(); }
    void clear() { candidate.clear(), contact.clear(); }
    void reserve(std::size_t n) { candidate.reserve(n), contact.reserve(n); }
    void add(const Candidate& c, const Contact& m) { candidate.push_back(c), contact.push_back(m); }
  };
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
  /// All that changes; copied by snapshots.
  struct State {
    bool valid = false;
    Pairs vertex_triangle, edge_edge;
    std::vector<float> path;  ///< [padded(V)] m moved since all candidates were found
    // The candidates are good while every vertex is within `slack` of start + drift * elapsed, and elapsed <= its
    // until.
    std::vector<Double4> start, drift;  ///< [V] m, m/s
    std::vector<double> until;          ///< [V] s
    double elapsed = 0.0;               ///< s, since all candidates were found
    double horizon = 0.0;               ///< s, the least `until`
    double renewal = 0.0;               ///< s: no longer than this without a search for all
    std::vector<std::uint8_t> flat;     ///< [nodes] no two parts of the node can touch, nothing was searched in it
    std::int64_t touching = 0;          ///< active pairs with force in the last substep
  };

  /// @param spring part of the explicit limit dt^2 lambda = 4 that the springs of contact take.
  /// @param piecewise from this number of vertices on, candidates are found anew only for vertices that have left
  /// their path. On fewer a search for all is as fast.
  SelfContact(const Topology& topology, const Fabric& fabric, float spring, std::int32_t piecewise = 2000);

  /// Makes sure that the candidates are good for the next block, else finds them anew.
  void prepare(State& state, const Double4* x, const Double4* v, const Fixed4* fixed, double unit,
               double block_seconds) const;
  double slack() const { return slack_; }  ///< m, see State
  /// Chooses the candidates that can touch until the paths reach `bound` [V] m.
  void select(State& state, const float* bound) const;
  /// Measures the selected candidates; those in contact, or close to it, become active, with their stiffness.
  /// @param moved [V] m, in the last substep. @param dt, longest s: this substep, and the longest one there can be.
  void activate(State& state, const Fixed4* fixed, double unit, const float* moved, const float* inverse_mass, float dt,
                float longest) const;
  /// Adds the forces of the active pairs.
  void add_forces(State& state, const Float4* v, float dt, Float4* forces) const;
  bool has_fast() const { return !scratch_.fast.empty(); }
  /// Inelastic impulses on the velocities so that the pairs that may come closer than half their distance do not, in
  /// the step x += dt v, in which no vertex goes below floor (m).
  void stop(const Double4* x, double dt, double floor, double ground_friction, const float* inverse_mass,
            Double4* v) const;
  /// Longest substep (s) at which a layer under acceleration g (m/s^2) sinks in by at most this part of the thickness.
  double longest_step(double g, double part) const;
  /// Empty, with room for a fully folded cloth, so that the frame loop does not allocate.
  void clear(State& state) const;

 private:
  /// Boxes of eight primitives, lane by lane; empty lanes are inverted.
  struct alignas(32) BoxBlock {
    float low[3][8], high[3][8];
    std::int32_t corner[3][8];  ///< vertices of the primitive; those that it has not, and empty lanes, repeat others
    std::int32_t id[8];         ///< vertex, edge or face; -1: empty lane
    unsigned strayed;           ///< lanes with a vertex that candidates are searched for
  };
  /// A patch of at most eight neighbouring faces, with the vertices and edges that it owns (each belongs to one patch).
  struct Patch {
    std::int32_t faces[2], vertices[2], edges[2];  ///< [begin, end) in blocks
  };
  /// Tree of boxes over the patches, split in rest space. Children come after their parent.
  struct Node {
    float low[3], high[3];
    float axis[3];             ///< mean normal of the faces
    float angle;               ///< rad, largest angle between it and a face's normal; above pi: no cone
    std::int32_t left, right;  ///< children, or -1
    std::int32_t patch;        ///< of a leaf
    /// The rest shape is one piece, nearly convex: while its normals stay within a cone below 90 degrees it projects
    /// one to one along the axis, and no two of its parts can touch [Volino and Magnenat-Thalmann 1994].
    bool convex;
    bool strayed;  ///< has a vertex that candidates are searched for
  };
  /// Eight pairs that a search has found and not yet measured.
  struct alignas(32) PairBlock {
    std::int32_t v[4][8];  ///< as in Candidate
    std::int32_t face[8];
  };
  /// Two patches of eight faces have at most 24 edges and 24 vertices each, and lists are emptied from 64 pairs on.
  static constexpr int kMostPending = 1024;
  struct Pending {
    std::vector<PairBlock> blocks;  ///< [kMostPending / 8]
    int count = 0;
    void add(const std::array<std::int32_t, 4>& v, std::int32_t face) {
      PairBlock& block = blocks[static_cast<std::size_t>(count) / 8];
      const int lane = count++ % 8;
      for (int k = 0; k < 4; ++k) block.v[k][lane] = v[k];
      block.face[lane] = face;
    }
  };
  /// Room for find_candidates() and activate(), kept so that the frame loop does not allocate.
  struct Scratch {
    std::vector<BoxBlock> faces, vertices, edges;
    std::vector<Node> nodes;
    std::vector<Float4> sums;         ///< [nodes] sums of unit normals
    std::vector<std::uint8_t> boxed;  ///< [patches] vertex and edge boxes are those of this search
    Pairs old;                        ///< first vertices and triangles, then edges
    std::size_t old_vertex_triangle = 0;
    std::vector<std::uint8_t> strayed;  ///< [V] candidates are searched for it
    Pending pending_faces, pending_edges;
    std::vector<std::uint64_t> table;
    std::vector<std::array<std::int32_t, 2>> met;  ///< leaves whose boxes meet
    // The paths, relative to the lowest corner, m: now; at the end; m/s, with s until then as w.
    std::vector<Float4> position, later, drift;
    std::vector<float> load;
    std::vector<std::int32_t> soon_faces, soon_edges;  ///< candidates selected for the block
    std::vector<Active> active;
    std::vector<std::int32_t> fast;  ///< active pairs that may come closer than half their distance
  };
  /// @param grounded impulses do not press vertices into the ground.
  void stop_pairs(const Double4* x, double dt, double floor, const float* inverse_mass, Double4* v,
                  bool grounded) const;
  void make_patches();
  bool nearly_convex(const std::vector<std::int32_t>& faces) const;
  void find_candidates(State& state, const Double4* x, const Double4* v, const Fixed4* fixed, double unit,
                       double block_seconds) const;
  bool choose_strayed(State& state, const Double4* x, double block_seconds) const;
  void forget_strayed(State& state) const;
  bool recall(Candidate& pair, Contact& contact, bool edges) const;
  void mark(std::int32_t node) const;
  void spread_marks() const;
  void mark_lanes(BoxBlock& block, int corners) const;
  static void let_go(Candidate& pair, Contact& contact);
  bool elsewhere(const Candidate& pair, const float (&weight)[4], const Fixed4* fixed) const;
  float pair_distance(const std::int32_t (&v)[4], bool edges) const;

  const Topology* topology_;
  float thickness_ = 0.0f;
  float edge_thickness_ = 0.0f;
  float friction_ = 0.0f;
  float spring_ = 0.0f;
  float slack_ = 0.0f;
  std::int32_t piecewise_ = 0;
  std::vector<Patch> patches_;
  mutable Scratch scratch_;
};

}  // namespace weft::cloth
