#pragma once
#include <filesystem>
#include <string>
#include <vector>

#include "weft/params.hpp"
#include "weft/task.hpp"

namespace weft::torchscript {

/// The metadata file: the task that the module was made for. It is read like any config.
struct Metadata {
  std::string garment_hash;
  std::vector<std::string> controls, states;
  std::vector<double> grasp_vertices, displacement_m, opens_at;
  double drop_height_m = 0.05;
  ConfigNode material;
  std::vector<double> control_low, control_high;
  std::int64_t max_segments = 200;
  bool previous = false;
  double length_unit_m = 1.0;
  std::vector<double> control_mean, control_sd, state_mean, state_sd;
  template <class Visitor>
  void visit(Visitor& v) {
    v("garment_hash", garment_hash, "Hash of the garment.");
    v("controls", controls, "Names of the trajectory's controls.");
    v("states", states, "Names of the trajectory's state variables.");
    v("grasp_vertices", grasp_vertices, range(0, 1e9), "Vertices that the hands hold.");
    v("displacement_m", displacement_m, range(-10, 10, "m"), "d, [x, y].");
    v("drop_height_m", drop_height_m, range(0, 1, "m"), "h.");
    v("opens_at", opens_at, range(0, 1),
      "manipulation.opens_at of the training data; default: all hands at the release.");
    v("material", material, "Material space of the training data; without it nothing is compared, and weft warns.");
    v("control_low", control_low, range(-1e9, 1e9),
      "Least value of each control in the training data; plans stay above.");
    v("control_high", control_high, range(-1e9, 1e9), "Largest value of each control in the training data.");
    v("max_segments", max_segments, range(1, 1000, "segments"), "Largest number of segments that the module takes.");
    v("previous", previous, "forward() takes the shape one segment earlier as fifth argument.");
    v("length_unit_m", length_unit_m, range(1e-6, 1e6, "m"), "Unit of all lengths that the module takes and returns.");
    v("control_mean", control_mean, range(-1e9, 1e9), "The module takes (control - control_mean) / control_sd.");
    v("control_sd", control_sd, range(1e-9, 1e9), "One number per control; with control_mean or not at all.");
    v("state_mean", state_mean, range(-1e9, 1e9), "The module takes (state - state_mean) / state_sd.");
    v("state_sd", state_sd, range(1e-9, 1e9), "One number per state variable; with state_mean or not at all.");
  }
};

/// @throws ConfigError with file, line and key.
Metadata read_metadata(const std::filesystem::path& file);
/// @throws ConfigError when the module was made for another garment, trajectory or manipulation than the task's.
void require_task(const Metadata& metadata, const std::string& file, const Task& task);

}  // namespace weft::torchscript
