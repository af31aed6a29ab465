#pragma once
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "experiments/experiment_config.hpp"
#include "experiments/sweep.hpp"
#include "session/material_posterior.hpp"

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

/// Fig. 3: one arm per width, a closed-loop session per arm and case; c drawn as in section 4. Goals are what a random
/// trajectory or the example's controls make of the case's true material.
/// @param session config of the sessions; `knowledge` and `drawn_width` are set here.
AblationPlan planning_evaluation(const ConfigNode& session, const std::vector<double>& widths,
                                 const EvaluationCases& cases);
/// Runs a cell of it, and keeps goal and final shape in folder/shapes (see write_planning_shapes).
AblationRunner planning_runner(const EvaluationCases& cases, const std::filesystem::path& folder);

/// Section 5: one arm per method; a case is a manipulation replayed under the case's material, estimated after every
/// segment.
AblationPlan estimation_evaluation(const ConfigNode& session, const std::vector<std::string>& methods,
                                   const DataParams& data, const EvaluationCases& cases);
/// Runs a cell of it, and keeps the shapes of the manipulation in folder/shapes (see write_estimation_shapes).
AblationRunner estimation_runner(const EvaluationCases& cases, const DataParams& data,
                                 const std::filesystem::path& folder);

/// One source's rows of an evaluation.
struct EvaluationColumn {
  EvaluationCases cases;
  AblationPlan plan;
  std::vector<AblationRow> rows;
};
/// planning.json, planning.csv, estimation.json (docs/file-formats.md). The first column (of estimation: its first
/// method) has the keys at the top level; all are under `columns`.
std::string planning_evaluation_json(const std::vector<EvaluationColumn>& columns);
std::string planning_evaluation_csv(const std::vector<EvaluationColumn>& columns);
std::string estimation_evaluation_json(const std::vector<EvaluationColumn>& columns);
std::string estimation_evaluation_csv(const std::vector<EvaluationColumn>& columns);
/// Tables for people.
std::string planning_evaluation_table(const EvaluationColumn& column);
std::string estimation_evaluation_table(const std::string& json);  ///< of estimation_evaluation_json
/// cases.h5 of the page: goals and final shapes of the rows of planning.json's `cases`, from folder/shapes.
void write_planning_shapes(const EvaluationColumn& column, const Garment& garment, const std::filesystem::path& folder,
                           const std::filesystem::path& file);
/// The same for estimation.json: the cloth of its `cases` at the start and after every segment.
void write_estimation_shapes(const EvaluationColumn& column, const Garment& garment,
                             const std::filesystem::path& folder, const std::filesystem::path& file);

/// How often, and how well, intervals hold the truth.
struct IntervalFigures {
  double coverage50 = 0.0, coverage80 = 0.0, coverage100 = 0.0;  ///< of [c - a w/2, c + a w/2], a = 0.5, 0.8, 1
  /// Mean interval score [Gneiting & Raftery 2007, eq. 43] of the intervals for a = 0.5 and 0.8, averaged; smaller is
  /// better. u - l + 2 / (1 - a) (distance by which the truth lies outside).
  double score = 0.0;
};
IntervalFigures interval_figures(const std::vector<MaterialKnowledge>& knowledge,
                                 const std::vector<MaterialProperties>& truth, Index property);
/// Factors on the posteriors' standard deviations under which their intervals hold the truth as often as they say
/// (largest miss of the coverage at a = 0.5 and 0.8; then the best interval score): `estimation.deviation_scale`. To be
/// found on other cases than those that are reported.
PropertyVector calibrate_deviations(const std::vector<MaterialPosterior>& posteriors,
                                    const std::vector<MaterialProperties>& truth);

}  // namespace weft
