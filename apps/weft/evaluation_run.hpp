#pragma once
#include <optional>
#include <string>
#include <vector>

#include "context.hpp"
#include "experiments/cases.hpp"
#include "experiments/experiment_config.hpp"
#include "paper_options.hpp"
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
  PaperOptions paper;
};
void add_evaluation_options(CLI::App& command, Context& context, EvaluationOptions& options);

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

  /// The exit code of a command that run() has done all of, since its cells are on a cluster or other processes do the rest.
  /// nullopt: there are tables to write.
  std::optional<int> ended_with() const { return ended_with_; }

  /// Writes NAME.json and NAME.csv, and their times to times.json and times.csv.
  void write(const std::string& name, const std::string& json, const std::string& csv, const std::string& times,
             const std::string& times_of_cells) const;
  /// Says which rows belong to something else than the others, and which were not asked for.
  void say_rows(const std::vector<EvaluationColumn>& columns) const;

  std::filesystem::path out;
  Prepared<ExperimentParams> given;
  ConfigNode session;  ///< config of the cells

  /// Says what is missing or failed. @return the command's exit code.
  int exit_code(const std::vector<EvaluationColumn>& columns) const;
  std::filesystem::path source_folder(const std::string& source) const { return out / source; }

 private:
  /// Notes what the cells of a column belong to. @param data the folder that its cases come from, unless they are fresh.
  void identify(EvaluationColumn& column, const std::filesystem::path& data) const;
  /// Checks what the folder holds. Changes nothing. @throws ConfigError for other results.
  void begin(std::vector<EvaluationColumn>& columns, const std::filesystem::path& data);
  /// Writes garment, config and provenance.
  void write_plan() const;
  /// Options of a column's sweep, without what its cells do.
  SweepOptions cell_options(const EvaluationColumn& column) const;
  /// Gives the cells to a cluster. @return the exit code.
  int submit(const std::vector<EvaluationColumn>& columns) const;
  int exit_code_of_share(const std::vector<EvaluationColumn>& columns) const;

  Context& context_;
  EvaluationOptions options_;
  std::string kind_;  ///< of CellWork
  std::string command_;
  std::shared_ptr<Predictor> predictor_;
  std::optional<int> ended_with_;
  std::vector<SweepFolder> earlier_;  ///< what the folders of the sources held
};

}  // namespace weft::app
