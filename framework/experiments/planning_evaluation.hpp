#pragma once
#include <filesystem>
#include <string>
#include <vector>

#include "experiments/cases.hpp"
#include "weft/garment.hpp"

/// `weft evaluate planning`: the error of whole sessions against the width of the knowledge (Fig. 3).
namespace weft {

/// Fig. 3: one arm per width, a closed-loop session per arm and case; c drawn as in section 4. Goals are what a random
/// trajectory or the example's controls make of the case's true material.
/// @param session config of the sessions; `knowledge` and `drawn_width` are set here.
SweepPlan planning_evaluation(const ConfigNode& session, const std::vector<double>& widths,
                              const EvaluationCases& cases);
/// Runs a cell of it, and keeps goal and final shape in folder/shapes (see write_planning_shapes).
SweepRunner planning_runner(const EvaluationCases& cases, const std::filesystem::path& folder);

/// planning.json, planning.csv (docs/file-formats.md). The first column has the keys at the top level; the others are
/// under `columns`.
std::string planning_evaluation_json(const std::vector<EvaluationColumn>& columns);
std::string planning_evaluation_csv(const std::vector<EvaluationColumn>& columns);
/// A table for people.
std::string planning_evaluation_table(const EvaluationColumn& column);
/// cases.h5 of the page: goals and final shapes of the rows of planning.json's `cases`, from folder/shapes.
void write_planning_shapes(const EvaluationColumn& column, const Garment& garment, const std::filesystem::path& folder,
                           const std::filesystem::path& file);

}  // namespace weft
