#pragma once
#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "experiments/sweep.hpp"
#include "weft/params.hpp"

/// `weft ablate`: a sweep over factors. Each arm is compared with a baseline by paired differences.
namespace weft {

/// An ablation file: a session config, factors whose levels change it, and the seeds for every combination of levels.
/// Or a physics experiment, factors, and the cases of its suite.
struct AblationParams {
  std::string description, measure = "session";
  std::filesystem::path task;
  ConfigNode tasks, set, factors, baseline, target, seeds;
  std::int64_t resamples = 10000;

  template <class Visitor>
  void visit(Visitor& v) {
    v("description", description, "A description of the ablation for people.", Decides::nothing);
    v("measure", measure, choice({"session", "physics"}),
      "A cell runs a whole session (session), or a case of the physics suite in the arm's simulator (physics; paired "
      "folds are compared with `other`).");
    v("task", task, "Session config or physics experiment of every arm.");
    v("tasks", tasks,
      "In place of `task`: a list of such files. They are the levels of a first factor, `task`, by the names of the files "
      "without their ending.");
    v("set", set, "Keys of the session config, dotted or nested, that every arm changes: {planning.iterations: 80}.");
    v("factors", factors,
      "The factors by name. A list holds values of the session key with the factor's name. A mapping holds levels by "
      "name, each a mapping of session keys to values. Every combination of levels is an arm.");
    v("baseline", baseline,
      "{factor: level}: each arm is compared with the arm that has these levels and otherwise its own; default: the "
      "first level of the first factor.");
    v("target", target,
      "Such a {factor: level} too: of the gap between the medians of the baseline and of the arm with these levels, each arm "
      "says what share it closes; default: no gap is measured.");
    v("seeds", seeds, "A list, or {first: 1, count: 10}. Not for measure: physics, whose cases count from 0.",
      Decides::nothing);
    v("resamples", resamples, range(100, 1e6), "Number of bootstrap resamples.", Decides::nothing);
  }
};

struct AblationPlan : SweepPlan {
  std::string measure;                ///< of AblationParams
  std::vector<std::size_t> baseline;  ///< [arms]: the baseline of each arm; a baseline is its own
  std::vector<std::size_t> target;    ///< [arms]: the arm to which each arm's gap is measured; empty: none
  std::vector<std::string> cases;     ///< [seeds]: names; empty: seeds have no names
  std::int64_t resamples = 10000;     ///< of the bootstrap
};

/// Reads an ablation and the config of every arm. With measure: physics the cases are those of the first arm.
/// @param config with the keys of AblationParams. @param first_seed replaces the first seed of {first, count}.
/// @throws ConfigError with file and line, also if the cases of two arms differ.
AblationPlan read_ablation(const ConfigNode& config, const std::uint64_t* first_seed = nullptr);

/// One line per row: factors, seed, status, metrics, failure, the identity that it belongs to.
std::string ablation_csv(const AblationPlan& plan, const std::vector<SweepRow>& rows);
/// Statistics per arm and metric, and of the paired differences to the baseline over the seeds that both completed, with
/// the ratio of their medians and the share of the gap to the target (MedianComparison). Arms with rows that belong to
/// another identity say so under `mixed`.
std::string ablation_json(const AblationPlan& plan, const std::vector<SweepRow>& rows);
/// The same of what a clock measured: the times of ablation.json, and one line per row.
std::string ablation_times_json(const AblationPlan& plan, const std::vector<SweepRow>& rows);
std::string ablation_times_csv(const AblationPlan& plan, const std::vector<SweepRow>& rows);
/// A table of one metric over the arms, for people.
std::string ablation_table(const AblationPlan& plan, const std::vector<SweepRow>& rows, const std::string& metric);

}  // namespace weft
