#pragma once
#include <optional>
#include <vector>

#include "weft/config.hpp"
#include "weft/params.hpp"
#include "weft/task.hpp"

/// What stands around the cloth in scenes and tasks: the ground and the obstacles.
namespace weft {

/// `ground`: null (at height 0), none, or {height_m}. @return m; nullopt: none. @throws ConfigError with file, line, key.
std::optional<double> read_ground(const ConfigNode& node);
/// `obstacles`: null or a list, each {box: ...}, {cylinder: ...}, {half_space: ...} or {table: ...}.
/// @param ground m; a table must be above it. @throws ConfigError with file, line and key.
std::vector<Obstacle> read_obstacles(const ConfigNode& node, std::optional<double> ground = {});

/// The keys of `ground`: "height_m".
std::vector<ParamInfo> describe_ground();
/// The keys of one obstacle: "box.size_m", ...
std::vector<ParamInfo> describe_obstacles();

/// Height, m, on which the cloth of a task lies at the start, in the thickest fabric that the task allows.
double work_surface(const Task& task);

}  // namespace weft
