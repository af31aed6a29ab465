#include "session/estimate_chain.hpp"

namespace weft {

void set_start(EstimateRequest& request, const Task& task, const Observation& seen) {
  request.start = filled_start(task, seen);
  request.start_sigma = seen.sigma;
  request.start_height_sigma = seen.height_sigma;
}

EstimateChain::EstimateChain(const Estimator* estimator, Host& host, std::uint64_t seed)
    : estimator_(estimator), host_(host) {
  history_.seed = seed;
}

void EstimateChain::start(const Task& task, const Observation& seen, const Vector& state, Index controls) {
  set_start(history_, task, seen);
  history_.state = state;
  history_.controls.resize(0, controls);
}

void EstimateChain::add(ConstVec control, Observation seen) {
  history_.controls.conservativeResize(history_.controls.rows() + 1, Eigen::NoChange);
  history_.controls.bottomRows(1) = control.transpose();
  history_.observations.push_back(std::make_shared<const Observation>(std::move(seen)));
  history_.round = history_.controls.rows() - 1;
  if (history_.controls.rows() > estimator_->max_segments().value_or(history_.controls.rows())) {
    estimates_.push_back(estimates_.back());
    return;
  }
  const auto before = estimates_.empty() ? std::shared_future<Estimate>() : estimates_.back();
  const auto policy = host_.threads() > 1 ? std::launch::async : std::launch::deferred;
  estimates_.push_back(std::async(policy, [this, before, request = history_]() mutable {
                         if (before.valid()) request.previous = before.get().knowledge;
                         return estimator_->estimate(request);
                       }).share());
}

MaterialKnowledge EstimateChain::knowledge(std::int64_t segments) const {
  if (segments <= 0) return MaterialKnowledge::none();
  return estimates_.at(segments - 1).get().knowledge;
}

std::vector<Estimate> EstimateChain::all() const {
  std::vector<Estimate> list;
  for (const auto& one : estimates_) list.push_back(one.get());
  return list;
}

}  // namespace weft
