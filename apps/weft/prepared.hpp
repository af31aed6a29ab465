#pragma once
#include <memory>
#include <string>

#include "context.hpp"
#include "learning/dataset_files.hpp"
#include "learning/held_out.hpp"
#include "output.hpp"
#include "session/session.hpp"
#include "weft/params.hpp"
#include "weft/trainable.hpp"

namespace weft::app {

/// A config as a command needs it: its parameters, the task, and who runs it. What is wrong in the config shows here,
/// before any work.
/// @tparam Params SessionParams, or derived from it.
template <class Params>
struct Prepared {
  Prepared(Context& context, const std::string& file) : config(context.load(file)) {
    resolved = read_params(config, params);
    if (context.jobs == 0) context.jobs = static_cast<int>(params.threads);
    registry = context.registry(config);
    seed = static_cast<std::uint64_t>(params.seed);
    host = context.host(registry, seed);
    task = make_task(params.task, config, *host);
    check_session(params, config, task);
  }
  std::string provenance() const { return provenance_json(*registry, *host, seed); }
  /// The resolved config for a result's folder, see self_contained().
  ConfigNode saved_config(const std::filesystem::path& folder) const {
    return self_contained(resolved, task, *registry, folder);
  }

  ConfigNode config, resolved;
  Params params;
  std::shared_ptr<const PluginRegistry> registry;
  std::uint64_t seed = 0;
  std::unique_ptr<Host> host;
  Task task;
};

/// The model file that --out names. @throws ConfigError without one.
inline std::filesystem::path model_file(const Context& context, const std::string& command) {
  if (context.out.empty()) throw ConfigError(command + ": --out MODEL is required, a file such as model.h5");
  if (std::filesystem::path(context.out).extension() != ".h5")
    throw ConfigError("--out = " + context.out + ", must end in .h5");
  return context.out;
}

/// Reads datasets of one task, the first one first.
inline Dataset read_datasets(const Context& context, const std::vector<std::string>& folders, const Task& task) {
  Dataset dataset;
  for (std::size_t i = 0; i < folders.size(); ++i) {
    context.say("reading " + folders[i]);
    Dataset one = load_dataset(folders[i]);
    one.require_task(task);
    if (i == 0)
      dataset = std::move(one);
    else
      append_dataset(dataset, std::move(one));
  }
  return dataset;
}

/// Warns when examples of a split, or of `all`, are not to this predictor what the split's name says.
inline void warn_unless_held_out(Predictor& predictor, const Dataset& dataset, const std::string& split, Host& host) {
  const TrainablePredictor* learner = predictor.trainable();
  if (learner == nullptr) return;
  const std::string warning =
      held_out_warning(dataset, split_or_all(split), learner->trained_on(), learner->calibrated_on());
  if (!warning.empty()) host.log(LogLevel::warning, warning);
}

}  // namespace weft::app
