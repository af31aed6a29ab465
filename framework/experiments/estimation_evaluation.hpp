#pragma once
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "experiments/cases.hpp"
#include "learning/generate.hpp"
#include "session/material_posterior.hpp"
#include "weft/garment.hpp"

/// `weft evaluate estimation`: estimates of the material while manipulations are replayed (section 5).
namespace weft {

/// What a cell found: the estimates of one manipulation. The payload of its row.
struct EstimationCase {
  MaterialProperties truth;
  std::vector<MaterialKnowledge> knowledge;    ///< after 1, 2, ... segments
  std::optional<MaterialPosterior> posterior;  ///< after the last one, where the method has one
};
SweepPayload to_payload(const EstimationCase& one);
/// @param row that ran. Rows of "weft ablation row 1" hold the case as metrics, and are read, too.
/// @throws ConfigError for another payload, and for a damaged one.
EstimationCase estimation_case(const SweepRow& row);

/// Section 5: one arm per method; a case is a manipulation replayed under the case's material, estimated after every
/// segment.
SweepPlan estimation_evaluation(const ConfigNode& session, const std::vector<std::string>& methods,
                                const DataParams& data, const EvaluationCases& cases);
/// Runs a cell of it, and keeps the shapes of the manipulation in folder/shapes (see write_estimation_shapes).
SweepRunner estimation_runner(const EvaluationCases& cases, const DataParams& data,
                              const std::filesystem::path& folder);

/// estimation.json, estimation.csv (docs/file-formats.md). The first method of the first column has the keys at the top
/// level; all are under `columns`.
std::string estimation_evaluation_json(const std::vector<EvaluationColumn>& columns);
std::string estimation_evaluation_csv(const std::vector<EvaluationColumn>& columns);
/// A table for people. @param json of estimation_evaluation_json
std::string estimation_evaluation_table(const std::string& json);
/// cases.h5 of the page: the cloth of estimation.json's `cases` at the start and after every segment, from
/// folder/shapes.
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
