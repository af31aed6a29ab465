#pragma once
#include <atomic>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <string>
#include <utility>
#include <vector>

#include "loader/registry.hpp"
#include "session/session.hpp"
#include "weft/params.hpp"

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

/// One combination of levels.
struct AblationArm {
  std::string name;                 ///< levels, comma-separated
  std::vector<std::string> levels;  ///< one per factor
  ConfigNode config;                ///< of the session, without a seed
  std::size_t baseline = 0;         ///< arm it is compared with; itself if it is one
};

struct AblationPlan {
  std::string description, measure;
  std::vector<std::string> factors;
  std::vector<AblationArm> arms;
  std::vector<std::uint64_t> seeds;
  std::vector<std::string> cases;  ///< [seeds], names; empty: seeds have none
  std::int64_t resamples = 10000;
};

/// @param config as AblationParams; every arm's config is read. With measure: physics the cases are those of the first
/// arm. @throws ConfigError also where another arm has other cases.
/// @param first_seed replaces the first seed of {first, count}. @throws ConfigError with file and line.
AblationPlan read_ablation(const ConfigNode& config, const std::uint64_t* first_seed = nullptr);

using AblationMetrics = std::vector<std::pair<std::string, double>>;

/// What one session measured.
struct AblationOutcome {
  AblationMetrics metrics;
  std::string paired_by;  ///< fingerprint of what must be the same in all arms: goal, start and true material
};

/// One arm with one seed.
struct AblationRow {
  std::size_t arm = 0;
  std::uint64_t seed = 0;
  std::string failure;  ///< empty: it ran
  AblationOutcome outcome;
};

/// Runs a session. @throws what a session throws.
using AblationRunner = std::function<AblationOutcome(const ConfigNode& session, Host& host)>;
AblationOutcome session_outcome(const SessionResult& result);
AblationOutcome run_session_cell(const ConfigNode& session, Host& host);
/// Runs case number `seed` of a physics experiment in its `simulator`. Metrics, named "test: quantity": the error as
/// its bound counts it, the largest where a case has several; and "test: within bounds", 1 if all of the case are.
AblationOutcome run_physics_cell(const ConfigNode& experiment, Host& host);

struct AblationOptions {
  std::filesystem::path folder;  ///< rows go into folder/cells
  int jobs = 1;                  ///< sessions at a time
  std::shared_ptr<const PluginRegistry> registry;
  const std::atomic<bool>* cancel = nullptr;
  AblationRunner runner = run_session_cell;
  /// Called after every row, one call at a time; done counts rows that were there already.
  std::function<void(const AblationRow& row, std::size_t done, std::size_t total)> progress;
};

/// Runs all cells that have no row yet, seed by seed, several at a time; every cell gets a host of its own with the
/// session's `threads` (0: one thread). A cell writes its row whole or not at all, so a run killed at any moment is
/// finished by the next one. What a cell throws is its row's failure; the others go on.
/// @return all rows, [seeds * arms]; fewer when cancelled.
/// @throws ConfigError when the folder holds rows of another ablation, or a damaged row.
std::vector<AblationRow> run_ablation(const AblationPlan& plan, const AblationOptions& options);

/// Mean, median, standard deviation, and 95 % intervals of mean and median by the percentile bootstrap [Efron 1979].
/// NaN where there are too few values.
struct AblationStatistics {
  std::size_t n = 0;
  double mean, median, sd;
  std::pair<double, double> mean_interval, median_interval;
};
/// @param key of the bootstrap's random stream: same values, same key, same bits.
AblationStatistics ablation_statistics(const std::vector<double>& values, std::int64_t resamples, std::uint64_t key);

/// One line per row: factors, seed, status, metrics, failure.
std::string ablation_csv(const AblationPlan& plan, const std::vector<AblationRow>& rows);
/// Per arm and metric: statistics, and those of the paired differences to the baseline over the seeds that both ran.
std::string ablation_json(const AblationPlan& plan, const std::vector<AblationRow>& rows);
/// Names of all metrics, in the order of first appearance.
std::vector<std::string> ablation_metrics(const std::vector<AblationRow>& rows);
/// A table for people of one metric, over the arms.
std::string ablation_table(const AblationPlan& plan, const std::vector<AblationRow>& rows, const std::string& metric);

}  // namespace weft
