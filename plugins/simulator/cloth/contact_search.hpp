#pragma once
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "patches.hpp"
#include "simd.hpp"
#include "topology.hpp"

namespace weft::cloth {

/// The data of a pair that every block reads. Half a cache line.
struct Candidate {
  std::int32_t v[4];  ///< vertex, triangle | edge, edge
  std::int32_t face;  ///< of the triangle, or -1
  float due;          ///< measure when the sum of the four path bounds reaches this, m
  float distance;     ///< m, contact distance of this pair
  float present;      ///< m, <= distance: the part left after an overload; negative: not active
};

/// The memory of a pair that touched.
struct Contact {
  float normal[3];  ///< last direction from the second to the first; zero: unknown
  float mass;       ///< kg, least effective mass since contact began; sets the spring
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

/// Finds the vertex-triangle and edge-edge pairs that can come within thickness while every vertex stays near the
/// straight path that it was on at the search. Neighbours that move together are no such pairs. The memory of a pair
/// outlasts a search.
class ContactSearch {
 public:
  /// The whole changing state; snapshots copy it.
  struct State {
    bool valid = false;
    Pairs vertex_triangle, edge_edge;
    std::vector<float> path;  ///< [padded(V)] m moved since all candidates were found
    // The candidates are valid while every vertex is within slack() of start + drift * elapsed and elapsed <= its
    // `until`.
    std::vector<Double4> start, drift;      ///< [V] m, m/s
    std::vector<double> since, until;       ///< [V] s, begin and end of the path
    double elapsed = 0.0;                   ///< s, since all candidates were found
    double horizon = 0.0;                   ///< s, the least `until`
    double renewal = 0.0;                   ///< s, longest time without a search for all
    std::vector<std::uint8_t> flat;         ///< [nodes] no two parts of the node can touch, nothing was searched in it
    std::vector<std::uint8_t> flat_around;  ///< [patches] the same for the patch and all around it
  };

  /// @param thickness, edge_thickness m, distance below which vertex and triangle, and two edges, are in contact.
  /// @param piecewise from this number of vertices on, a search is only for vertices that have left their path. With
  /// fewer vertices a search for all is as fast.
  /// @param tree of the topology.
  ContactSearch(const Topology& topology, const PatchTree& tree, float thickness, float edge_thickness,
                std::int32_t piecewise);

  /// Makes sure that the candidates are valid for the next block, else searches again.
  void prepare(State& state, const Double4* x, const Double4* v, const Fixed4* fixed, double unit,
               double block_seconds) const;
  double slack() const { return slack_; }  ///< m, see State
  /// Empty, with room for a fully folded cloth, so that the frame loop does not allocate.
  void clear(State& state) const;

 private:
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
  /// Room for a search, kept so that the frame loop does not allocate.
  struct Scratch {
    std::vector<Float4> sums;         ///< [nodes] sums of unit normals
    std::vector<float> least_cosine;  ///< [nodes] of the angle to an axis from which the node is flat
    std::vector<std::uint8_t> boxed;  ///< [patches] vertex and edge boxes are those of this search
    Pairs old;                        ///< first vertices and triangles, then edges
    std::size_t old_vertex_triangle = 0;
    std::vector<std::uint8_t> strayed;  ///< [V] candidates are searched for it
    std::vector<float> life;            ///< [V] s, of a path that begins now
    Pending pending_faces, pending_edges;
    std::vector<std::uint64_t> table;              ///< the places of the old pairs, by key
    std::vector<std::array<std::int32_t, 2>> met;  ///< leaves whose boxes meet
    // The paths, relative to the lowest corner, m: now; at the end; m/s, with s until then as w.
    std::vector<Float4> position, later, drift;
  };
  class Search;

  float pair_distance(const std::int32_t (&v)[4], bool edges) const;

  const Topology* topology_;
  float thickness_ = 0.0f;
  float edge_thickness_ = 0.0f;
  float slack_ = 0.0f;
  std::int32_t piecewise_ = 0;
  mutable PatchTree tree_;
  mutable Scratch scratch_;
};

}  // namespace weft::cloth
