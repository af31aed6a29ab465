#pragma once
#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "experiments/sweep.hpp"
#include "weft/dataset.hpp"

/// The cases of the evaluations of planning and estimation.
namespace weft {

/// Cases of `weft evaluate planning` and `weft evaluate estimation`: fresh ones from the seed, which are in no dataset,
/// or examples of a split.
struct EvaluationCases {
  std::string source;                      ///< fresh, test, validation, train
  std::vector<std::uint64_t> seeds;        ///< [n]: a session's seed each; all of a case's random numbers come from it
  std::shared_ptr<const Dataset> dataset;  ///< null: fresh
  std::map<std::uint64_t, std::size_t> examples;  ///< seed -> position in dataset->examples

  const Example* example(std::uint64_t seed) const;  ///< null: fresh
};
/// Chooses fresh cases, or released examples of a split in an order drawn from the seed.
/// @param dataset ignored for source fresh. @throws ConfigError if the split holds fewer than `count`.
EvaluationCases choose_cases(const std::string& source, std::int64_t count, std::uint64_t seed,
                             std::shared_ptr<const Dataset> dataset);

/// One source's rows of an evaluation.
struct EvaluationColumn {
  EvaluationCases cases;
  SweepPlan plan;
  std::vector<SweepRow> rows;
};

/// The description of the cases in the cells' config. With it rows of other cases are refused.
std::string describe(const EvaluationCases& cases, const std::string& what);
/// The file for the shapes of a cell. @param level of the cell's arm.
std::filesystem::path shape_file(const std::filesystem::path& folder, std::uint64_t seed, const std::string& level);
/// The seed of a cell's config.
std::uint64_t seed_of(const ConfigNode& cell);
/// A number with 9 digits, for levels and tables.
std::string text_of(double value);

}  // namespace weft
