#pragma once
#include <filesystem>
#include <string>
#include <vector>

#include "experiments/cases.hpp"
#include "weft/garment.hpp"

/// `weft evaluate planning`: the error of whole sessions against the width of the knowledge (Fig. 3).
namespace weft {

/// Fig. 3: one arm per width, and a closed-loop session per arm and case; c is drawn as in section 4. A goal is the
/// result of a random trajectory, or of the example's controls, with the case's true material.
/// @param session config of the sessions; `knowledge` and `drawn_width` are set here.
SweepPlan planning_evaluation(const ConfigNode& session, const std::vector<double>& widths,
                              const EvaluationCases& cases);
/// Runs one cell and keeps goal and final shape in folder/shapes (see write_planning_shapes).
SweepRunner planning_runner(const EvaluationCases& cases, const std::filesystem::path& folder);

/// planning.json, planning.csv (docs/file-formats.md). The keys of the first column are at the top level; those of the
/// others are under `columns`.
std::string planning_evaluation_json(const std::vector<EvaluationColumn>& columns);
std::string planning_evaluation_csv(const std::vector<EvaluationColumn>& columns);
/// The times of both: of planning.json for times.json, and of the cases for times.csv.
std::string planning_times_json(const std::vector<EvaluationColumn>& columns);
std::string planning_times_csv(const std::vector<EvaluationColumn>& columns);
/// A table for people.
std::string planning_evaluation_table(const EvaluationColumn& column);
/// cases.h5 of the page: goals and final shapes of the rows of planning.json's `cases`, from folder/shapes.
void write_planning_shapes(const EvaluationColumn& column, const Garment& garment, const std::filesystem::path& folder,
                           const std::filesystem::path& file);

}  // namespace weft
