#pragma once
#include <memory>
#include <string>
#include <type_traits>
#include <vector>

#include "context.hpp"
#include "experiments/experiment_config.hpp"
#include "learning/dataset_files.hpp"
#include "output.hpp"
#include "session/sequence.hpp"
#include "weft/dataset.hpp"
#include "weft/params.hpp"

namespace weft::app {

/// For IdentityInput: none of a session of one fold.
std::vector<IdentityInput::Fold> identity_folds(const SessionParams& params, const ConfigNode& config);

/// A config as a command needs it: its parameters, the task and the host. Errors in the config show here, before any
/// work.
/// @tparam Params SessionParams, or derived from it.
template <class Params>
struct Prepared {
  /// @param recorded what a used folder holds: plugins get the numeric variants that they had there, unless the config
  /// names others. @param where that is, for messages.
  Prepared(Context& context, const std::string& file, const std::vector<Identity>& recorded = {},
           const std::string& where = "")
      : config(context.load(file)) {
    resolved = read_params(config, params);
    if (context.jobs == 0) context.jobs = static_cast<int>(params.threads);
    registry = context.registry(config);
    if (!recorded.empty()) {
      config = with_recorded_variants(config, describe_params<Params>(), *registry, recorded, where);
      resolved = read_params(config, params = Params());
    }
    seed = static_cast<std::uint64_t>(params.seed);
    host = context.host(registry, seed);
    task = make_task(params.task, config, *host);
    check_session(params, config, task);
    if constexpr (std::is_same_v<Params, ExperimentParams>) require_one_step(params, config, "an experiment");
  }
  /// @param command whose results belong to the identity. @param keep, besides, data as those of IdentityInput.
  Identity identity(
      const std::string& command,
      const std::function<bool(const ParamInfo&)>& keep = [](const ParamInfo&) { return true; },
      std::vector<std::pair<std::string, std::string>> besides = {},
      std::vector<std::filesystem::path> data = {}) const {
    const auto params_of_config = describe_params<Params>();
    besides.insert(besides.begin(), {"command", command});
    return make_identity({config, resolved, params_of_config, task, *registry, keep, std::move(besides),
                          std::move(data), identity_folds(params, config)});
  }
  std::string provenance(const Identity& identity) const { return provenance_json(*registry, seed, identity); }
  /// The resolved config for a result's folder, see self_contained().
  ConfigNode saved_config() const { return self_contained(resolved, describe_params<Params>(), task, *registry); }

  ConfigNode config, resolved;
  Params params;
  std::shared_ptr<const PluginRegistry> registry;
  std::uint64_t seed = 0;
  std::unique_ptr<Host> host;
  Task task;
};

/// What a fit or calibration belongs to: the task but for its simulator, which made the examples, the predictor and the
/// examples.
Identity learning_identity(const Prepared<ExperimentParams>& given, const std::string& command,
                           const std::vector<std::string>& folders);

/// The model file that --out names. @throws ConfigError without one.
std::filesystem::path model_file(const Context& context, const std::string& command);

/// Reads datasets of one task, the first one first.
Dataset read_datasets(const Context& context, const std::vector<std::string>& folders, const Task& task,
                      ShapesIn shapes = ShapesIn::memory);

/// Warns when this predictor was fitted or calibrated with examples of a split that should be fresh to it, or of `all`.
void warn_unless_held_out(Predictor& predictor, const Dataset& dataset, const std::string& split, Host& host);

}  // namespace weft::app
