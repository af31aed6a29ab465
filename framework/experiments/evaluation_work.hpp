#pragma once
#include <atomic>
#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "experiments/physics/physics.hpp"
#include "experiments/physics_checkpoint.hpp"
#include "experiments/prediction_evaluation.hpp"
#include "loader/registry.hpp"
#include "processes/worker_process.hpp"

/// `evaluate physics` and `evaluate prediction` in child processes: a crash or hang costs one case, or one batch.
namespace weft {

/// Where the work is done.
struct EvaluationWorkers {
  std::vector<std::string> command;  ///< of a program that answers the requests below
  double limit_s = 0.0;              ///< see work_limits()
  std::function<bool()> cancelled;   ///< asked every half second
};

/// Runs all cases of a physics experiment, as many at a time as the host has threads.
/// @param config with the keys of PhysicsExperimentParams. @param cases of it. @param done called after every case, one
/// call at a time. @param checkpoint its cases do not run again, and those that run to their end are added.
/// @return the rows in the order of the cases. A case whose process fails has one row, which failed.
std::vector<PhysicsRow> run_physics_cases(const EvaluationWorkers& workers, const ConfigNode& config,
                                          const std::vector<PhysicsCase>& cases, const PluginRegistry& registry,
                                          Host& host, PhysicsCheckpoint& checkpoint,
                                          const std::function<void(const std::vector<PhysicsRow>&)>& done);
/// Runs one case in this process, in the simulators of the experiment.
std::vector<PhysicsRow> run_physics_case_of(const PhysicsExperimentParams& params, const PhysicsCase& one,
                                            const Task& task, Host& host);

/// Predicts batches in one child process with as many threads as the host has.
/// @param config with the keys of ExperimentParams. @param folders that the dataset was read from, in order. All
/// arguments must outlive the result.
PredictBatch predict_in_child(const EvaluationWorkers& workers, const ConfigNode& config, const Dataset& dataset,
                              const std::vector<std::string>& folders, const PluginRegistry& registry, Host& host);

/// The other side: answers the requests of both.
class EvaluationServer {
 public:
  explicit EvaluationServer(const std::atomic<bool>* cancel);
  ~EvaluationServer();
  EvaluationServer(const EvaluationServer&) = delete;
  EvaluationServer& operator=(const EvaluationServer&) = delete;
  /// Whether a request of this kind is for it.
  static bool knows(const std::string& kind);
  std::string answer(const std::string& request);

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace weft
