#pragma once
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "session/goal_surface.hpp"
#include "weft/error.hpp"
#include "weft/material.hpp"
#include "weft/mesh.hpp"
#include "weft/obstacle.hpp"
#include "weft/types.hpp"

namespace weft {

class ConfigNode;
struct SessionResult;
struct Task;

/// One round of a recorded session.
struct RoundRecord {
  Controls controls;             ///< [u, C]: the plan; its first row was executed
  Vector state;                  ///< [S] before the segment
  MaterialKnowledge knowledge;   ///< the plan's input
  Positions observed;            ///< [V, 3] m, observed after the segment
  Vector losses;                 ///< [instances], residual, mm^2
  Controls curves;               ///< [iterations, instances]: best loss so far; 0 rows if not recorded
  std::vector<Positions> mean;   ///< [u] of [V, 3] m: the winner's prediction after every segment
  std::vector<Positions> sigma;  ///< [u] of [V, 3] m; empty if only means were predicted
  /// [12 u] of [G, 3] m: grasp points along the plan, those of a hand that has opened where it opened; empty in files
  /// without them.
  std::vector<Positions> targets;
};

/// The contents of session.h5. Pages, exports and later analyses need nothing else, and no plugin.
struct SessionRecord {
  std::string config, provenance, summary;  ///< YAML, JSON, JSON
  std::string trajectory;                   ///< JSON {controls: [{name, unit}], state: [...]}, or empty
  std::string garment_name;
  Faces faces;
  RestPositions rest;
  GarmentForm form;  ///< of schema 2; empty for garments of one chart and one layer
  std::vector<Index> grasp_vertices;
  std::vector<Index> opened_after;              ///< [G] segments after which each hand opened; empty: all at the end
  std::vector<Obstacle> obstacles;              ///< those of `config`
  Positions start, default_shape, final_shape;  ///< [V, 3] m
  bool has_correspondence = true;               ///< whether the goal's vertices are the garment's
  GoalKind goal_kind = GoalKind::surface;
  Positions goal;                 ///< [V, 3] m; without correspondence the goal's own vertices, [G, 3]
  std::vector<bool> goal_counts;  ///< [V]: vertices that count in the errors; empty: all
  Faces goal_faces;               ///< of the goal: those of the garment, or its own; 0 rows for points
  std::optional<MaterialProperties> true_material;  ///< nullopt: unknown
  std::vector<Positions> frames;  ///< [12 segments + 1 + settle_frames()]: start, segments, release and settling
  std::vector<RoundRecord> rounds;
  std::vector<MaterialKnowledge> estimates;  ///< [segments]: after each of them; empty without estimation

  Index vertex_count() const { return start.rows(); }
  /// How far a shape is from the goal, mm: mean distance of the vertices that count, without correspondence GoalSurface::chamfer_mm().
  double goal_distance_mm(const Positions& shape) const;
  /// The same of every vertex, [V], mm; without correspondence from the nearest point of the goal.
  Vector vertex_distances_mm(const Positions& shape) const;
  /// The goal as a mesh to draw, without rest positions: points are small squares.
  Mesh drawn_goal() const;
  /// An obstacle as a mesh to draw; its `source` is a name of its own: "obstacle_0_box".
  Mesh drawn_obstacle(std::size_t k) const;
  /// The goal without correspondence, or as a planning loss chamfer or silhouette sees it.
  std::shared_ptr<const GoalSurface> goal_surface(const Garment& garment, const std::string& loss) const;
  Index segments() const { return rounds.size(); }
  /// First frame of segment j = 0, 1, ...; for j = segments() the frame of the release.
  Index segment_frame(Index j) const { return j * kFramesPerSegment; }
  /// The last frame in which a hand holds its vertex.
  Index held_until(Index hand) const { return segment_frame(opened_after.empty() ? segments() : opened_after[hand]); }
  Index settle_frames() const { return std::ssize(frames) - 1 - segment_frame(segments()); }
  bool released() const { return settle_frames() > 0; }
  /// [V, 3] m, the shape after segment j = 0, 1, ...; settled if it was the last.
  const Positions& shape_after(Index j) const {
    return j + 1 >= segments() ? frames.back() : frames[segment_frame(j + 1)];
  }
};

/// @throws ConfigError naming the array that is missing, damaged or of the wrong shape.
SessionRecord read_session(const std::filesystem::path& file);

/// summary.json: the keys of docs/file-formats.md. Its times are apart, in session_times_json().
std::string session_summary_json(const SessionResult& result);
/// summary.json of a sequence: the errors of every step, in its folder step_1, step_2, ...
std::string sequence_summary_json(const SessionResult& result);
/// The times of summary.json, for times.json.
std::string session_times_json(const SessionResult& result);
/// session.h5. @param resolved the resolved config; @param provenance version, commit, plugins.
void write_session(const std::filesystem::path& file, const SessionResult& result, const Task& task,
                   const ConfigNode& resolved, const std::string& provenance);

}  // namespace weft
