#pragma once
#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "experiments/sweep.hpp"
#include "weft/dataset.hpp"

/// What the evaluations of planning and of estimation have in common: their cases.
namespace weft {

/// The cases of `weft evaluate planning` and `weft evaluate estimation`: fresh ones made from the seed, which no
/// dataset holds, or examples of a split.
struct EvaluationCases {
  std::string source;                      ///< fresh, test, validation, train
  std::vector<std::uint64_t> seeds;        ///< [n]: a session's seed each; all of a case's random numbers come from it
  std::shared_ptr<const Dataset> dataset;  ///< null: fresh
  std::map<std::uint64_t, std::size_t> examples;  ///< seed -> position in dataset->examples

  const Example* example(std::uint64_t seed) const;  ///< null: fresh
};
/// @param dataset ignored for source fresh. Released examples of the split, in an order drawn from the seed.
/// @throws ConfigError when the split holds fewer than `count`.
EvaluationCases choose_cases(const std::string& source, std::int64_t count, std::uint64_t seed,
                             std::shared_ptr<const Dataset> dataset);

/// One source's rows of an evaluation.
struct EvaluationColumn {
  EvaluationCases cases;
  SweepPlan plan;
  std::vector<SweepRow> rows;
};

/// What the cells' config says about where the cases come from, so that rows of other cases are refused.
std::string describe(const EvaluationCases& cases, const std::string& what);
/// Where a cell keeps its shapes. @param level of the cell's arm.
std::filesystem::path shape_file(const std::filesystem::path& folder, std::uint64_t seed, const std::string& level);
/// The seed of a cell's config.
std::uint64_t seed_of(const ConfigNode& cell);
/// A number of 9 digits, for levels and tables.
std::string text_of(double value);

}  // namespace weft
