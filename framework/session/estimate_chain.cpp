#include "session/estimate_chain.hpp"

#include <cmath>
#include <limits>
#include <utility>

namespace weft {

void set_start(EstimateRequest& request, const Task& task, const Observation& seen, const MaterialKnowledge& prior) {
  request.start = filled_start(task, seen);
  const Index count = lowest_layer(*task.garment, *request.start, seen.observed).vertices;
  request.start_sigma =
      count > 0 ? seen.sigma / std::sqrt(static_cast<double>(count)) : std::numeric_limits<double>::infinity();
  request.start_height_sigma = seen.height_sigma;
  if (prior.width.mean() < MaterialKnowledge::none().width.mean()) request.previous = prior;
}

SessionEstimator::SessionEstimator(const Task& task, std::shared_ptr<const Predictor> predictor,
                                   std::shared_ptr<const Optimiser> optimiser, const EstimatorParams& params,
                                   const ConfigNode& simulator, Host& host)
    : network_(task, predictor, std::move(optimiser), params, host) {
  if (params.correction.simulations > 0)
    corrector_.emplace(task, predictor, std::make_shared<const Twin>(task, simulator, host), params.correction, host);
}

Estimate SessionEstimator::next(EstimateRequest request, const Estimate* previous) const {
  const Index segments = request.controls.rows();
  if (segments > network_.max_segments().value_or(segments)) return *previous;
  const std::optional<MaterialKnowledge> prior = request.previous;
  if (previous) request.previous = previous->knowledge;
  if (!corrector_ || !corrector_->applies(segments)) return network_.estimate(request);
  if (previous && previous->corrected) {
    Estimate next = corrector_->next(request, *previous);
    return next.corrected ? next : *previous;
  }
  Estimate network = network_.estimate(request);
  MaterialProperties start = network.posterior ? network.posterior->mode : network.knowledge.centre;
  if (prior) start = start.cwiseMax(prior->centre - 0.5 * prior->width).cwiseMin(prior->centre + 0.5 * prior->width);
  Estimate corrected = corrector_->first(request, start);
  if (!corrected.corrected) return network;
  corrected.nll = network.nll;
  corrected.misfit = network.misfit;
  corrected.losses = network.losses;
  corrected.iterations = network.iterations;
  corrected.evaluations = network.evaluations;
  corrected.seconds += network.seconds;
  return corrected;
}

EstimateChain::EstimateChain(const SessionEstimator* estimator, Host& host, std::uint64_t seed)
    : estimator_(estimator), host_(host) {
  history_.seed = seed;
}

void EstimateChain::start(const Task& task, const Observation& seen, const Vector& state, Index controls,
                          const MaterialKnowledge& prior) {
  set_start(history_, task, seen, prior);
  history_.state = state;
  history_.controls.resize(0, controls);
}

void EstimateChain::add(ConstVec control, Observation seen) {
  history_.controls.conservativeResize(history_.controls.rows() + 1, Eigen::NoChange);
  history_.controls.bottomRows(1) = control.transpose();
  history_.observations.push_back(std::make_shared<const Observation>(std::move(seen)));
  history_.round = history_.controls.rows() - 1;
  const auto before = estimates_.empty() ? std::shared_future<Estimate>() : estimates_.back();
  const auto policy = host_.threads() > 1 ? std::launch::async : std::launch::deferred;
  estimates_.push_back(std::async(policy, [this, before, request = history_] {
                         return estimator_->next(request, before.valid() ? &before.get() : nullptr);
                       }).share());
}

MaterialKnowledge EstimateChain::knowledge(std::int64_t segments) const {
  if (segments <= 0) return MaterialKnowledge::none();
  return estimates_.at(segments - 1).get().knowledge;
}

std::function<MaterialKnowledge()> EstimateChain::knowledge_later(std::int64_t segments) const {
  if (segments <= 0) return [] { return MaterialKnowledge::none(); };
  return [estimate = estimates_.at(segments - 1)] { return estimate.get().knowledge; };
}

std::vector<Estimate> EstimateChain::all() const {
  std::vector<Estimate> list;
  for (const auto& one : estimates_) {
    list.push_back(one.get());
    list.back().sequence.reset();  // a snapshot of a plugin must not outlive the host
  }
  return list;
}

}  // namespace weft
