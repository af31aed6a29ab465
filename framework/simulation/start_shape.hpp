#pragma once
#include <filesystem>

#include "weft/hdf5_file.hpp"
#include "weft/task.hpp"

namespace weft {

/// Opens a recorded session. @throws ConfigError if it was recorded with another garment.
Hdf5File open_recorded(const std::filesystem::path& session_file, const Garment& garment);

/// Where a recorded session left the cloth. @throws ConfigError as open_recorded(), and for a session without a segment.
StartShape read_start(const std::filesystem::path& session_file, const Garment& garment);

/// Puts the cloth where the task begins, held by the hands: flat, or at Task::start, at rest.
/// @throws ConfigError as Simulator::reset().
void begin(Simulator& simulator, const Task& task, const Fabric& fabric);

}  // namespace weft
