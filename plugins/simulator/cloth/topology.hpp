#pragma once
#include <array>
#include <cstdint>
#include <memory>
#include <vector>

#include "weft/rest_shape.hpp"

namespace weft::cloth {

/// Connectivity of the rest mesh. Immutable after construction.
struct Topology {
  explicit Topology(const Garment& garment);
  /// Whether the garment has the same rest shape and faces.
  bool is_of(const Garment& garment) const;

  std::int32_t vertices = 0;
  std::vector<std::array<std::int32_t, 3>> faces;
  std::vector<std::array<std::int32_t, 2>> edges;      ///< first < second, sorted
  std::vector<std::array<std::int32_t, 3>> opposite;   ///< [f][i]: vertex across the edge opposite corner i, or -1
  std::vector<std::array<std::int32_t, 3>> neighbour;  ///< [f][i]: the face of that vertex, or -1
  std::vector<std::array<std::array<double, 2>, 3>> corner;  ///< [f] m, in the face's rest frame
  /// [f][i] m: where `opposite` lies in that frame, unfolded across the edge.
  std::vector<std::array<std::array<double, 2>, 3>> beyond;
  /// [f][i] no bending moment crosses the edge opposite corner i: a border or a seam.
  std::vector<std::array<bool, 3>> free_edge;
  /// [v] m: in one plane, or with frames in space as the garment was drawn. For sorting what lies together.
  std::vector<std::array<double, 3>> place;
  /// [f] piece, and with frames its side (whether the face was drawn looking down): what is split on its own.
  std::vector<std::int32_t> part;
  std::shared_ptr<const RestShape> frames;         ///< null: the rest shape is a chart, `place` in the plane
  std::vector<double> area;                        ///< [f] m^2, rest
  std::vector<double> vertex_area;                 ///< [v] m^2: a third of the faces around
  std::vector<std::int32_t> face_of_vertex_start;  ///< [v + 1]
  std::vector<std::int32_t> face_of_vertex;        ///< faces around a vertex
  std::vector<std::int32_t> component;             ///< [v] connected piece
  double max_edge = 0.0, mean_edge = 0.0;          ///< m, rest
  double min_height = 0.0;                         ///< m, smallest altitude of a rest face

 private:
  void measure_faces();
  void join_faces();
  void find_components();
  void list_faces_of_vertices();
  void lay_out(const Garment& garment);
  double rest_length(std::int32_t face, int corner) const;  ///< m, of the edge opposite the corner

  GarmentForm form_;
  Positions drawn_;  ///< with frames
};

}  // namespace weft::cloth
