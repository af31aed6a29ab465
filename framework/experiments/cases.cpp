#include "experiments/cases.hpp"

#include <cstdio>

#include "weft/random.hpp"

namespace weft {
namespace {

constexpr std::uint64_t kCaseStream = 0x6576616c;  // "eval"

}  // namespace

const Example* EvaluationCases::example(std::uint64_t seed) const {
  if (!dataset) return nullptr;
  return &dataset->examples.at(examples.at(seed));
}

EvaluationCases choose_cases(const std::string& source, std::int64_t count, std::uint64_t seed,
                             std::shared_ptr<const Dataset> dataset) {
  EvaluationCases cases;
  cases.source = source;
  for (std::int64_t i = 0; i < count; ++i) {
    // A session's seed fits an int64 below 9e18.
    cases.seeds.push_back(RandomStream(seed, kCaseStream, static_cast<std::uint64_t>(i)).bits64() >> 2);
  }
  if (source == "fresh") return cases;
  const Split split = split_named(source);
  if (!dataset) throw ConfigError("cases from the " + source + " split need a dataset: --data FOLDER");
  std::vector<std::size_t> released;
  for (const auto i : dataset->select(split)) {
    if (dataset->examples[i].released) released.push_back(i);
  }
  if (static_cast<std::int64_t>(released.size()) < count) {
    throw ConfigError("the " + source + " split holds " + std::to_string(released.size()) +
                      " released examples, fewer than the " + std::to_string(count) + " cases asked for");
  }
  RandomStream random(seed, kCaseStream + 1);
  for (std::size_t i = 0; i < cases.seeds.size(); ++i) {
    std::swap(released[i], released[i + static_cast<std::size_t>(random.below(released.size() - i))]);
    cases.examples[cases.seeds[i]] = released[i];
  }
  cases.dataset = std::move(dataset);
  return cases;
}

std::string describe(const EvaluationCases& cases, const std::string& what) {
  std::string text = what + ", cases: " + cases.source;
  if (cases.dataset) text += " of dataset " + cases.dataset->header.identity;
  return text;
}

std::filesystem::path shape_file(const std::filesystem::path& folder, std::uint64_t seed, const std::string& level) {
  return folder / "shapes" / ("seed" + std::to_string(seed) + "-" + level + ".h5");
}

std::uint64_t seed_of(const ConfigNode& cell) { return static_cast<std::uint64_t>(cell.at("seed").as_int()); }

std::string text_of(double value) {
  char text[40];
  std::snprintf(text, sizeof text, "%.9g", value);
  return text;
}

}  // namespace weft
