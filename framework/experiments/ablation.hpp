#pragma once
#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "experiments/sweep.hpp"
#include "weft/params.hpp"

/// What `weft ablate` reads and writes: a sweep over factors, whose arms are compared pair by pair with a baseline.
namespace weft {

/// An ablation file: a session config, factors whose levels change it, and the seeds that every combination is run
/// with. Or a physics experiment, factors, and the cases of its suite.
struct AblationParams {
  std::string description, measure = "session";
  std::filesystem::path task;
  ConfigNode set, factors, baseline, seeds;
  std::int64_t resamples = 10000;

  template <class Visitor>
  void visit(Visitor& v) {
    v("description", description, "What is compared, for people.", Decides::nothing);
    v("measure", measure, choice({"session", "physics"}),
      "What a cell runs. session: a whole session; physics: a case of the physics suite in the arm's simulator, whose "
      "paired folds are compared with `other`.");
    v("task", task, "Session config, or physics experiment, that every arm starts from.");
    v("set", set, "Keys of the session config, dotted or nested, that every arm changes: {planning.iterations: 80}.");
    v("factors", factors,
      "What is compared, by name. A list holds values of the session key that the factor is called after; a mapping "
      "holds "
      "levels by name, each a mapping of session keys to values. Every combination of levels is an arm.");
    v("baseline", baseline,
      "{factor: level}: each arm is compared with the arm that has these levels and is like it otherwise; default: the "
      "first "
      "level of the first factor.");
    v("seeds", seeds, "A list, or {first: 1, count: 10}. Not with measure: physics, whose cases count from 0.",
      Decides::nothing);
    v("resamples", resamples, range(100, 1e6), "Of the bootstrap.", Decides::nothing);
  }
};

struct AblationPlan : SweepPlan {
  std::string measure;                ///< of AblationParams
  std::vector<std::size_t> baseline;  ///< [arms]: the arm that each is compared with; itself if it is one
  std::vector<std::string> cases;     ///< [seeds], names; empty: seeds have none
  std::int64_t resamples = 10000;     ///< of the bootstrap
};

/// @param config as AblationParams; every arm's config is read. With measure: physics the cases are those of the first
/// arm. @throws ConfigError also where another arm has other cases.
/// @param first_seed replaces the first seed of {first, count}. @throws ConfigError with file and line.
AblationPlan read_ablation(const ConfigNode& config, const std::uint64_t* first_seed = nullptr);

/// One line per row: factors, seed, status, metrics, failure.
std::string ablation_csv(const AblationPlan& plan, const std::vector<SweepRow>& rows);
/// Per arm and metric: statistics, and those of the paired differences to the baseline over the seeds that both ran.
std::string ablation_json(const AblationPlan& plan, const std::vector<SweepRow>& rows);
/// A table for people of one metric, over the arms.
std::string ablation_table(const AblationPlan& plan, const std::vector<SweepRow>& rows, const std::string& metric);

}  // namespace weft
