#pragma once
#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <string>

#include "experiments/cases.hpp"
#include "experiments/sweep.hpp"
#include "loader/registry.hpp"
#include "processes/worker_process.hpp"

/// The cells of a sweep as requests to a child process, and how the child answers.
namespace weft {

/// What the cells of a sweep do.
struct CellWork {
  std::string kind;               ///< session, physics, planning, estimation
  std::filesystem::path folder;   ///< planning, estimation: shapes go into folder/shapes
  ConfigNode data;                ///< estimation: `data:` of the experiment, which makes fresh manipulations
  EvaluationCases cases;          ///< planning, estimation
  std::filesystem::path dataset;  ///< the folder that cases.dataset was read from
};
/// One line. @param cell config of the arm, with `seed`. @param registry says where plugins are searched.
std::string cell_request(const CellWork& work, const ConfigNode& cell, const PluginRegistry& registry);
/// The folders that a registry searches, for a request, and the registry that searches them: one for equal texts, which
/// is never freed, because the type of an exception may live in a plugin.
std::string searched_folders(const PluginRegistry& registry);
std::shared_ptr<const PluginRegistry> registry_of_request(const std::string& folders);

/// What a request for an example begins with. Its index, a blank, and JSON with `config` and `plugin_path` follow: a child
/// reads the JSON only when it is another one than before.
inline const std::string kExample = "example ";
/// What child processes need to make examples: the request for one, by its index.
/// @param config with the keys of ExperimentParams. @param folders from searched_folders().
std::function<std::string(std::int64_t index)> example_requests(const ConfigNode& config, const std::string& folders);

/// Reads what a child answered, or how it ended, into a row's status, failure and outcome.
/// @throws WriteError if the cell was run, but its shapes could not be written: that is not the cell's failure.
void read_cell_end(const WorkEnd& end, SweepRow& row);

/// Runs the cell of a request in this process.
/// @return the answer: one line. A failure of the cell is an answer too.
class CellServer {
 public:
  explicit CellServer(const std::atomic<bool>* cancel) : cancel_(cancel) {}
  std::string answer(const std::string& request);

 private:
  const std::atomic<bool>* cancel_;
};

}  // namespace weft
