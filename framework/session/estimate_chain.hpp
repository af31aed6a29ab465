#pragma once
#include <future>
#include <vector>

#include "session/estimator.hpp"

namespace weft {

/// Sets the start shape and its errors in `request` from the first observation of a session.
void set_start(EstimateRequest& request, const Task& task, const Observation& seen);

/// Estimates the material after every segment, from the whole history and the previous estimate. With more than one
/// thread the estimates run in parallel to the session. Their values do not depend on that.
class EstimateChain {
 public:
  /// @param estimator may be null if add() is never called.
  EstimateChain(const Estimator* estimator, Host& host, std::uint64_t seed);
  /// @param controls C, the number of controls. @param state [S].
  void start(const Task& task, const Observation& seen, const Vector& state, Index controls);
  /// Adds an executed segment and its observation. Beyond the predictor's max_segments() the last estimate stays.
  void add(ConstVec control, Observation seen);
  /// The estimate after `segments` segments; no knowledge before the first one. Waits for it.
  MaterialKnowledge knowledge(std::int64_t segments) const;
  /// One estimate per added segment. Waits for them.
  std::vector<Estimate> all() const;

 private:
  const Estimator* estimator_;
  Host& host_;
  EstimateRequest history_;
  std::vector<std::shared_future<Estimate>> estimates_;
};

}  // namespace weft
