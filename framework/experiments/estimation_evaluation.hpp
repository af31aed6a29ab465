#pragma once
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "experiments/cases.hpp"
#include "learning/generate.hpp"
#include "session/material_posterior.hpp"
#include "weft/garment.hpp"

/// `weft evaluate estimation`: estimates the material in replayed manipulations (section 5).
namespace weft {

/// The estimates of one manipulation: the payload of a cell's row.
struct EstimationCase {
  MaterialProperties truth;
  std::vector<MaterialKnowledge> knowledge;    ///< after 1, 2, ... segments
  std::optional<MaterialPosterior> posterior;  ///< after the last segment, if the method has one
};
SweepPayload to_payload(const EstimationCase& one);
/// The case of a completed row. Also reads rows of "weft ablation row 1", which hold the case as metrics.
/// @throws ConfigError for another or a damaged payload.
EstimationCase estimation_case(const SweepRow& row);

/// Section 5: one arm per method. Each case replays a manipulation with the case's material and estimates it after
/// every segment.
SweepPlan estimation_evaluation(const ConfigNode& session, const std::vector<std::string>& methods,
                                const DataParams& data, const EvaluationCases& cases);
/// Runs one cell and keeps the manipulation's shapes in folder/shapes (see write_estimation_shapes).
SweepRunner estimation_runner(const EvaluationCases& cases, const DataParams& data,
                              const std::filesystem::path& folder);

/// estimation.json, estimation.csv (docs/file-formats.md). The keys of the first method of the first column are at the
/// top level; those of all are under `columns`.
std::string estimation_evaluation_json(const std::vector<EvaluationColumn>& columns);
std::string estimation_evaluation_csv(const std::vector<EvaluationColumn>& columns);
/// The times of estimation.json, for times.json, and of the cases, for times.csv.
std::string estimation_times_json(const std::vector<EvaluationColumn>& columns);
std::string estimation_times_csv(const std::vector<EvaluationColumn>& columns);
/// A table for people. @param json from estimation_evaluation_json(), joined with its times.
std::string estimation_evaluation_table(const std::string& json);
/// cases.h5 of the page: the cloth of estimation.json's `cases` at the start and after every segment, from
/// folder/shapes.
void write_estimation_shapes(const EvaluationColumn& column, const Garment& garment,
                             const std::filesystem::path& folder, const std::filesystem::path& file);

/// Coverage and score of intervals.
struct IntervalFigures {
  double coverage50 = 0.0, coverage80 = 0.0, coverage100 = 0.0;  ///< of [c - a w/2, c + a w/2], a = 0.5, 0.8, 1
  /// Mean interval score [Gneiting & Raftery 2007, eq. 43] of the intervals for a = 0.5 and 0.8, averaged; smaller is
  /// better. u - l + 2 / (1 - a) (distance by which the truth lies outside).
  double score = 0.0;
};
IntervalFigures interval_figures(const std::vector<MaterialKnowledge>& knowledge,
                                 const std::vector<MaterialProperties>& truth, Index property);
/// Calibrates `estimation.deviation_scale`, the factors on the posteriors' standard deviations: minimises the largest
/// error of the coverage at a = 0.5 and 0.8, then the interval score. Use other cases than those that are reported.
PropertyVector calibrate_deviations(const std::vector<MaterialPosterior>& posteriors,
                                    const std::vector<MaterialProperties>& truth);

}  // namespace weft
