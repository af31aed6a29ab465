#pragma once
#include <memory>
#include <string>
#include <vector>

#include "context.hpp"
#include "output.hpp"
#include "session/session.hpp"
#include "weft/dataset.hpp"
#include "weft/params.hpp"

namespace weft::app {

/// A config as a command needs it: its parameters, the task and the host. Errors in the config show here, before any
/// work.
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
  /// The resolved config for a result's folder, see self_contained(). Without a folder: write_garment() must follow.
  ConfigNode saved_config() const { return self_contained(resolved, describe_params<Params>(), task, *registry); }
  ConfigNode saved_config(const std::filesystem::path& folder) const {
    return self_contained(resolved, describe_params<Params>(), task, *registry, folder);
  }

  ConfigNode config, resolved;
  Params params;
  std::shared_ptr<const PluginRegistry> registry;
  std::uint64_t seed = 0;
  std::unique_ptr<Host> host;
  Task task;
};

/// The model file that --out names. @throws ConfigError without one.
std::filesystem::path model_file(const Context& context, const std::string& command);

/// Reads datasets of one task, the first one first.
Dataset read_datasets(const Context& context, const std::vector<std::string>& folders, const Task& task);

/// Warns when this predictor was fitted or calibrated with examples of a split that should be fresh to it, or of `all`.
void warn_unless_held_out(Predictor& predictor, const Dataset& dataset, const std::string& split, Host& host);

}  // namespace weft::app
