#include "prepared.hpp"

#include <algorithm>
#include <set>

#include "identity/sha256.hpp"
#include "learning/held_out.hpp"
#include "weft/config.hpp"
#include "weft/trainable.hpp"

namespace weft::app {

namespace fs = std::filesystem;

std::filesystem::path model_file(const Context& context, const std::string& command) {
  if (context.out.empty()) throw ConfigError(command + ": --out MODEL is required, a file such as model.h5");
  if (std::filesystem::path(context.out).extension() != ".h5")
    throw ConfigError("--out = " + context.out + ", must end in .h5");
  return context.out;
}

std::vector<IdentityInput::Fold> identity_folds(const SessionParams& params, const ConfigNode& config) {
  std::vector<IdentityInput::Fold> folds;
  if (params.manipulations.is_null()) return folds;
  for (auto& step : session_steps(params, config)) folds.push_back({step.config, step.resolved});
  return folds;
}

Identity learning_identity(const Prepared<ExperimentParams>& given, const std::string& command,
                           const std::vector<std::string>& folders) {
  for (const auto& folder : folders) list_shards(folder);  // says what is wrong with it
  std::set<std::string> keys{"predictor", "seed"};
  for (const auto& info : describe_params<TaskParams>())
    if (info.name != "simulator") keys.insert(info.name);
  // Learning may be in a library of its own: libweft_NAME_*.so, beside the plugin or in the folder above.
  std::vector<std::pair<std::string, std::string>> besides;
  const PluginEntry plugin = given.registry->entry(Predictor::kKind, given.params.predictor);
  const fs::path folder = fs::absolute(plugin.file).parent_path();
  for (const auto& place : {folder, folder.parent_path()}) {
    std::error_code ignored;
    for (const auto& entry : fs::directory_iterator(place, ignored)) {
      const std::string name = entry.path().filename().string();
      if (name.starts_with("libweft_" + plugin.name + "_") && entry.path().extension() == ".so")
        besides.emplace_back("library " + name, "sha256 " + sha256_of_file(entry.path()));
    }
  }
  std::sort(besides.begin(), besides.end());
  return given.identity(command, [&](const ParamInfo& info) { return keys.contains(info.name); }, besides,
                        {folders.begin(), folders.end()});
}

Dataset read_datasets(const Context& context, const std::vector<std::string>& folders, const Task& task,
                      ShapesIn shapes) {
  Dataset dataset;
  for (std::size_t i = 0; i < folders.size(); ++i) {
    context.say("reading " + folders[i]);
    Dataset one = load_dataset(folders[i], 0, shapes);
    one.require_task(task);
    if (i == 0)
      dataset = std::move(one);
    else
      append_dataset(dataset, std::move(one));
  }
  return dataset;
}

void warn_unless_held_out(Predictor& predictor, const Dataset& dataset, const std::string& split, Host& host) {
  const TrainablePredictor* learner = predictor.trainable();
  if (learner == nullptr) return;
  const std::string warning =
      held_out_warning(dataset, split_or_all(split), learner->trained_on(), learner->calibrated_on());
  if (!warning.empty()) host.log(LogLevel::warning, warning);
}

}  // namespace weft::app
