#pragma once
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "loader/registry.hpp"

/// What `weft benchmark` measures. A row is a JSON object whose keys say what is measured: {part: frames, motion: resting,
/// simulator: cloth, fabric: basic, vertices: 1024}. Its numbers come from measure_row(), once for every repeat.
namespace weft::benchmark {

using Row = nlohmann::ordered_json;

/// frames, folds, training, planning.
const std::vector<std::string>& part_names();
/// The fabrics of the part `frames`: names of files in configs/fabrics.
const std::vector<std::string>& fabric_names();

struct Plan {
  std::vector<std::string> parts = part_names();
  std::vector<std::string> simulators = {"cloth", "bullet"};
  std::vector<std::string> kernels = {};  ///< numeric variants of `emd`
  int processors = 1;                     ///< the most that a row uses
  bool is_quick = false;                  ///< smallest sizes
};
/// The rows of the plan's parts, small ones before large ones of the same kind.
std::vector<Row> rows_of(const Plan& plan);

/// The names of the numeric variants of a predictor, those that this machine cannot run too; empty if it has none.
std::vector<std::string> variants_of(const PluginRegistry& registry, const ConfigNode& predictor);

}  // namespace weft::benchmark
