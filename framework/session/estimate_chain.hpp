#pragma once
#include <future>
#include <vector>

#include "session/estimator.hpp"

namespace weft {

/// What the first look of a session tells its estimates.
void set_start(EstimateRequest& request, const Task& task, const Observation& seen);

/// Estimates after every segment, each from everything up to then and the estimate before it. With more than one thread
/// they run beside the session; their values do not depend on that.
class EstimateChain {
 public:
  /// @param estimator may be null as long as add() is not called.
  EstimateChain(const Estimator* estimator, Host& host, std::uint64_t seed);
  /// @param controls C, the number of controls. @param state [S].
  void start(const Task& task, const Observation& seen, const Vector& state, Index controls);
  /// One more segment was executed and seen. Beyond what the predictor takes the last estimate stays.
  void add(ConstVec control, Observation seen);
  /// After `segments` segments; before the first one nothing is known. Waits for it.
  MaterialKnowledge knowledge(std::int64_t segments) const;
  /// One per segment that was added. Waits for them.
  std::vector<Estimate> all() const;

 private:
  const Estimator* estimator_;
  Host& host_;
  EstimateRequest history_;
  std::vector<std::shared_future<Estimate>> estimates_;
};

}  // namespace weft
