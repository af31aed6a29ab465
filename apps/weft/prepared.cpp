#include "prepared.hpp"

#include "learning/dataset_files.hpp"
#include "learning/held_out.hpp"
#include "weft/config.hpp"
#include "weft/trainable.hpp"

namespace weft::app {

std::filesystem::path model_file(const Context& context, const std::string& command) {
  if (context.out.empty()) throw ConfigError(command + ": --out MODEL is required, a file such as model.h5");
  if (std::filesystem::path(context.out).extension() != ".h5")
    throw ConfigError("--out = " + context.out + ", must end in .h5");
  return context.out;
}

Dataset read_datasets(const Context& context, const std::vector<std::string>& folders, const Task& task) {
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

void warn_unless_held_out(Predictor& predictor, const Dataset& dataset, const std::string& split, Host& host) {
  const TrainablePredictor* learner = predictor.trainable();
  if (learner == nullptr) return;
  const std::string warning =
      held_out_warning(dataset, split_or_all(split), learner->trained_on(), learner->calibrated_on());
  if (!warning.empty()) host.log(LogLevel::warning, warning);
}

}  // namespace weft::app
