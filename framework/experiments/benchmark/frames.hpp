#pragma once
#include <filesystem>

#include "experiments/benchmark/rows.hpp"
#include "weft/host.hpp"

namespace weft::benchmark {

/// A square of 0.6 m of the fabric in its motion: the frames that count, and their cost.
///     resting  lies flat on the ground: 60 frames, after 30 that do not count
///     hanging  two corners rise by 0.5 m and near each other within 90 frames, then hang for 60
///     folding  an edge is laid over to the opposite one within 90 frames and released, then 60 frames
/// @param row {motion, simulator, fabric, vertices}. @param fabrics folder of the fabric's file.
/// @return cpu_ms and wall_ms of a frame, reset_cpu_ms, frames; `note` if the simulator warns.
/// @throws ConfigError for what the simulator cannot honour; Diverged; Error when it is cancelled.
nlohmann::ordered_json measure_frames(const Row& row, const std::filesystem::path& fabrics, Host& host);

}  // namespace weft::benchmark
