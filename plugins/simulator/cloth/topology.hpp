#pragma once
#include <array>
#include <cstdint>
#include <vector>

#include "weft/garment.hpp"

namespace weft::cloth {

/// Connectivity of the rest mesh. Immutable after construction.
struct Topology {
  explicit Topology(const Garment& garment);
  /// Whether the garment has the same rest shape and faces.
  bool is_of(const Garment& garment) const;

  std::int32_t vertices = 0;
  std::vector<std::array<std::int32_t, 3>> faces;
  std::vector<std::array<std::int32_t, 2>> edges;     ///< first < second, sorted
  std::vector<std::array<std::int32_t, 3>> opposite;  ///< [f][i]: vertex across the edge opposite corner i, or -1
  std::vector<std::array<double, 2>> rest;            ///< m
  std::vector<double> area;                           ///< [f] m^2, rest
  std::vector<double> vertex_area;                    ///< [v] m^2: a third of the faces around
  std::vector<std::int32_t> face_of_vertex_start;     ///< [v + 1]
  std::vector<std::int32_t> face_of_vertex;           ///< faces around a vertex
  std::vector<std::int32_t> component;                ///< [v] connected piece
  double max_edge = 0.0, mean_edge = 0.0;             ///< m, rest
  double min_height = 0.0;                            ///< m, smallest altitude of a rest face

 private:
  void measure_faces();
  void join_faces();
  void find_components();
  void list_faces_of_vertices();
  double rest_length(std::int32_t a, std::int32_t b) const;  ///< m
};

}  // namespace weft::cloth
