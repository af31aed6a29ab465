#pragma once
#include <functional>
#include <future>
#include <memory>
#include <optional>
#include <vector>

#include "session/estimate_corrector.hpp"

namespace weft {

/// Sets the start shape and its errors in `request` from the first observation of a session, and what is known before.
void set_start(EstimateRequest& request, const Task& task, const Observation& seen, const MaterialKnowledge& prior);

/// The estimator of a session, with its corrections.
class SessionEstimator {
 public:
  /// @param simulator slot of the corrections; null: the task's. @throws as Estimator, EstimateCorrector and Twin.
  SessionEstimator(const Task& task, std::shared_ptr<const Predictor> predictor,
                   std::shared_ptr<const Optimiser> optimiser, const EstimatorParams& params,
                   const ConfigNode& simulator, Host& host);
  /// The estimate after one more segment: the network's, or, once enough segments were seen, the corrected one. Beyond
  /// the predictor's max_segments() the previous one stays.
  /// @param request its `previous`: the prior, or nothing. @param previous null: the first.
  Estimate next(EstimateRequest request, const Estimate* previous) const;
  const Estimator& network() const { return network_; }

 private:
  Estimator network_;
  std::optional<EstimateCorrector> corrector_;
};

/// Estimates the material after every segment, from the whole history and the previous estimate. With more than one
/// thread the estimates run in parallel to the session. Their values do not depend on that.
class EstimateChain {
 public:
  /// @param estimator may be null if add() is never called.
  EstimateChain(const SessionEstimator* estimator, Host& host, std::uint64_t seed);
  /// @param controls C, the number of controls. @param state [S]. @param prior what is known before the first segment.
  void start(const Task& task, const Observation& seen, const Vector& state, Index controls,
             const MaterialKnowledge& prior);
  /// Adds an executed segment and its observation. Beyond the predictor's max_segments() the last estimate stays.
  void add(ConstVec control, Observation seen);
  /// The estimate after `segments` segments; no knowledge before the first one. Waits for it.
  MaterialKnowledge knowledge(std::int64_t segments) const;
  /// The same, to be called later, on any thread, also while segments are added.
  std::function<MaterialKnowledge()> knowledge_later(std::int64_t segments) const;
  /// One estimate per added segment. Waits for them.
  std::vector<Estimate> all() const;

 private:
  const SessionEstimator* estimator_;
  Host& host_;
  EstimateRequest history_;
  std::vector<std::shared_future<Estimate>> estimates_;
};

}  // namespace weft
