#pragma once
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "weft/error.hpp"
#include "weft/material.hpp"
#include "weft/types.hpp"

namespace weft {

class ConfigNode;
struct SessionResult;
struct Task;

/// One round of a recorded session.
struct RoundRecord {
  Controls controls;               ///< [u, C]: the plan; its first row was executed
  Vector state;                    ///< [S] before the segment
  MaterialKnowledge knowledge;     ///< what the plan was made with
  Positions observed;              ///< [V, 3] m, after the segment: as it was seen
  Vector losses;                   ///< [instances], residual, mm^2
  Controls curves;                 ///< [iterations, instances]: best loss so far; 0 rows when not recorded
  std::vector<Positions> mean;     ///< [u] of [V, 3] m: what the plan's winner predicts after every segment
  std::vector<Positions> sigma;    ///< [u] of [V, 3] m; empty when only means were predicted
  std::vector<Positions> targets;  ///< [12 u] of [G, 3] m: grasp points along the plan; empty in files without them
};

/// A session as session.h5 holds it: what pages, exports and later analyses are made from, without any plugin.
struct SessionRecord {
  std::string config, provenance, summary;  ///< YAML, JSON, JSON
  std::string trajectory;                   ///< JSON {controls: [{name, unit}], state: [...]}, or empty
  std::string garment_name;
  Faces faces;
  RestPositions rest;
  std::vector<Index> grasp_vertices;
  Positions start, goal, default_shape, final_shape;  ///< [V, 3] m
  std::optional<MaterialProperties> true_material;    ///< nullopt: nobody knows it
  std::vector<Positions> frames;  ///< [12 segments + 1 + settle_frames()]: start, segments, release and settling
  std::vector<RoundRecord> rounds;
  std::vector<MaterialKnowledge> estimates;  ///< [segments] after each of them; empty when nothing was estimated

  Index vertex_count() const { return start.rows(); }
  Index segments() const { return rounds.size(); }
  /// Frame at which segment j = 0, 1, ... begins; segments(): at which the hands let go.
  Index segment_frame(Index j) const { return j * kFramesPerSegment; }
  Index settle_frames() const { return std::ssize(frames) - 1 - segment_frame(segments()); }
  bool released() const { return settle_frames() > 0; }
  /// [V, 3] m, what the cloth was after segment j = 0, 1, ...; settled if it was the last.
  const Positions& shape_after(Index j) const {
    return j + 1 >= segments() ? frames.back() : frames[segment_frame(j + 1)];
  }
};

/// @throws ConfigError naming what is missing, damaged or of the wrong shape.
SessionRecord read_session(const std::filesystem::path& file);

/// summary.json: the keys of docs/file-formats.md.
std::string session_summary_json(const SessionResult& result);
/// session.h5. @param resolved the resolved config; @param provenance version, commit, plugins.
void write_session(const std::filesystem::path& file, const SessionResult& result, const Task& task,
                   const ConfigNode& resolved, const std::string& provenance);

}  // namespace weft
