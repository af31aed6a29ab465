#pragma once
#include <string>
#include <vector>

#include "context.hpp"
#include "experiments/cases.hpp"
#include "experiments/experiment_config.hpp"
#include "prepared.hpp"
#include "work_options.hpp"

namespace weft::app {

/// What `evaluate planning` and `evaluate estimation` have in common: the file, the cases, the cells.
struct EvaluationOptions {
  std::string file;
  std::string data;
  std::vector<std::string> goals = {"fresh"};
  std::int64_t cases = 50;
  WorkOptions work;
};
void add_evaluation_options(CLI::App& command, EvaluationOptions& options);

class EvaluationRun {
 public:
  /// Reads and checks everything that a cell needs, before any work starts.
  EvaluationRun(Context& context, const EvaluationOptions& options, const std::string& name);

  using MakePlan = std::function<SweepPlan(const EvaluationCases&)>;
  using MakeRunner = std::function<SweepRunner(const EvaluationCases&, const std::filesystem::path& folder)>;
  /// Runs the cells of every source. Cells that an earlier run finished are read.
  /// @param line the text about a row that ran.
  std::vector<EvaluationColumn> run(const MakePlan& make_plan, const MakeRunner& make_runner,
                                    const std::function<std::string(const SweepRow&)>& line);

  Prepared<ExperimentParams> given;
  ConfigNode session;  ///< config of the cells
  std::filesystem::path out;

  /// Says what is missing or failed. @return the command's exit code.
  int exit_code(const std::vector<EvaluationColumn>& columns) const;
  std::filesystem::path source_folder(const std::string& source) const { return out / source; }

 private:
  Context& context_;
  EvaluationOptions options_;
  std::string kind_;  ///< of CellWork
  std::shared_ptr<Predictor> predictor_;
};

}  // namespace weft::app
