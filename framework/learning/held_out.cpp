#include "learning/held_out.hpp"

#include <algorithm>

namespace weft {
namespace {

/// Whether an example of a dataset is one of unseen_examples().
bool is_unseen(const DatasetOrigin& own, std::int64_t index, const std::vector<DatasetOrigin>& trained_on) {
  const Split split = own.split(index);
  if (trained_on.empty()) return split == Split::validation;
  return split != Split::test && std::all_of(trained_on.begin(), trained_on.end(), [&](const auto& origin) {
           return origin.seed != own.seed || origin.split(index) == Split::validation;
         });
}

}  // namespace

std::vector<std::size_t> unseen_examples(const Dataset& dataset, const std::vector<DatasetOrigin>& trained_on) {
  const auto all = dataset.origins();
  std::vector<std::size_t> chosen;
  for (std::size_t i = 0; i < dataset.examples.size(); ++i) {
    if (!dataset.examples[i].failed() && is_unseen(all[dataset.source(i)], dataset.examples[i].index, trained_on))
      chosen.push_back(i);
  }
  return chosen;
}

std::string held_out_warning(const Dataset& dataset, std::optional<Split> split,
                             const std::vector<DatasetOrigin>& trained_on,
                             const std::vector<DatasetOrigin>& calibrated_on) {
  const auto chosen = dataset.select(split);
  const auto all = dataset.origins();
  const std::string name = split ? kSplitNames[static_cast<std::size_t>(*split)] : "";
  const auto count_of = [&](const auto& is_counted) {
    return std::count_if(chosen.begin(), chosen.end(), [&](std::size_t i) {
      return is_counted(all[dataset.source(i)].seed, dataset.examples[i].index);
    });
  };
  const auto some = [&](std::ptrdiff_t count) {
    return std::to_string(count) + " of the " + std::to_string(chosen.size()) + " examples " +
           (split ? "of the " + name + " split " : "");
  };
  std::string text;
  if (split == Split::train) {
    for (const auto& one : all) {
      const bool is_known = std::any_of(trained_on.begin(), trained_on.end(),
                                        [&](const auto& origin) { return origin.identity == one.identity; });
      if (is_known || trained_on.empty()) continue;
      text += (text.empty() ? "" : "; ") + ("the model was not trained on dataset " + one.identity) + ": its " + name +
              " split holds no training examples of this model";
    }
  } else {
    // Examples with equal number and seed are much the same, even if the configs differ.
    const auto count = count_of([&](std::uint64_t seed, std::int64_t index) {
      return std::any_of(trained_on.begin(), trained_on.end(), [&](const auto& origin) {
        return origin.seed == seed && origin.split(index) < split.value_or(Split::test);  // train < validation < test
      });
    });
    if (count > 0) {
      text = some(count) + "may not be held out: they were in the " +
             (split == Split::validation ? "train" : "train or validation") +
             " split of a dataset of the same seed that the model was trained on" +
             (split ? ", whose data.validation_fraction or data.test_fraction differ" : "");
    }
  }
  const auto count = count_of([&](std::uint64_t seed, std::int64_t index) {
    return std::any_of(calibrated_on.begin(), calibrated_on.end(),
                       [&](const auto& origin) { return origin.seed == seed && is_unseen(origin, index, trained_on); });
  });
  if (count > 0) text += (text.empty() ? "" : "; ") + some(count) + "may be those that its sigma was calibrated on";
  return text;
}

}  // namespace weft
