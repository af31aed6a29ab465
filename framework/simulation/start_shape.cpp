#include "simulation/start_shape.hpp"

#include <string>

#include "weft/error.hpp"

namespace weft {
namespace {

/// The last row of an [n, 4] array in [0, 1].
PropertyVector last_row(const Hdf5File& file, const std::string& path) {
  const auto values = file.read(path);
  if (values.size() < 4 || values.size() % 4 != 0) throw ConfigError(path + ": must have the shape [n, 4]");
  const PropertyVector row = Eigen::Map<const Eigen::Vector4d>(values.data() + values.size() - 4);
  if (!(row.minCoeff() >= 0.0 && row.maxCoeff() <= 1.0)) throw ConfigError(path + ": must be in [0, 1]");
  return row;
}

}  // namespace

Hdf5File open_recorded(const std::filesystem::path& session_file, const Garment& garment) {
  auto file = Hdf5File::open(session_file);
  const auto hash = file.read_text("/garment/hash");
  if (hash != std::to_string(garment.hash)) {
    throw ConfigError(session_file.string() + ": was recorded with another garment (hash " + hash + ", this one has " +
                      std::to_string(garment.hash) + ")");
  }
  return file;
}

StartShape read_start(const std::filesystem::path& session_file, const Garment& garment) {
  const auto file = open_recorded(session_file, garment);
  StartShape start;
  start.world = file.read_positions("/final_shape");
  const auto rounds = file.has("/rounds") ? file.list("/rounds") : std::vector<std::string>();
  if (rounds.empty()) throw ConfigError(session_file.string() + ": has no segment");
  start.shape = file.read_positions("/rounds/" + rounds.back() + "/observed");
  if (file.has("/estimates/centre")) {
    start.knowledge =
        MaterialKnowledge{.centre = last_row(file, "/estimates/centre"), .width = last_row(file, "/estimates/width")};
  }
  for (const Positions* shape : {&start.world, &start.shape})
    require_shape(session_file.string() + ": vertices", shape->rows(), garment.vertex_count());
  return start;
}

void begin(Simulator& simulator, const Task& task, const Fabric& fabric) {
  simulator.reset(task.garment, fabric, task.scene);
  const auto& held = task.manipulation.grasp_vertices;
  if (task.start)
    simulator.set_state(task.start->shape, Positions::Zero(task.start->shape.rows(), 3), held);
  else
    simulator.grasp(held);
}

}  // namespace weft
