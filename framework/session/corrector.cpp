#include "session/corrector.hpp"

#include <algorithm>
#include <cmath>

#include "loader/where.hpp"
#include "session/shape_errors.hpp"
#include "session/trust_region.hpp"

namespace weft {
namespace {

constexpr TrustRegion kRegion{.shrink = 0.35, .edge = 0.8};
constexpr double kLeastRadius = 0.01;  // in scales; below, the simulator's roughness decides
constexpr double kLeastGain = 0.01;    // share of the loss; a search that promises less is not worth a simulation
constexpr double kSecondRadius = 0.3;  // of two searches from one plan

}  // namespace

/// A plan that was simulated: what the next searches start from.
struct Corrector::Simulated {
  PlanPoint point;
  Positions offset;  // sim - net of the final shape
  std::vector<Positions> shapes;
  double loss = std::numeric_limits<double>::infinity();
  double error_mm = std::numeric_limits<double>::quiet_NaN();
  double radius = 0.0;
  bool exhausted = false;
};

/// A plan to simulate.
struct Corrector::Proposal {
  PlanPoint point;    // its loss: expected
  Index anchor = -1;  // in the pool; -1: a candidate
  double radius = 0.0;
  Simulated result;
};

/// All plans that were simulated, and the candidates that still wait.
class Corrector::Pool {
 public:
  Pool(const Corrector& owner, const CorrectionRequest& request)
      : owner_(owner), request_(request), waiting_(request.candidates), has_more_(request.more != nullptr) {}

  const Simulated* best() const {
    const auto it = std::min_element(plans_.begin(), plans_.end(),
                                     [](const Simulated& a, const Simulated& b) { return a.loss < b.loss; });
    return it == plans_.end() ? nullptr : &*it;
  }

  /// Up to `count` plans for the next simulations. Empty: nothing is left to try.
  std::vector<Proposal> propose(Index count) {
    std::vector<Proposal> proposals;
    const Simulated* leader = best();
    const bool is_poor = leader == nullptr || leader->error_mm > owner_.params_.pool_mm || request_.is_new;
    if (is_poor && waiting_.empty() && has_more_) {
      has_more_ = false;
      waiting_ = request_.more();
    }
    // Where the error is high, every second plan is a new candidate.
    const auto take = [&] {
      proposals.push_back({.point = waiting_.front(), .anchor = -1, .radius = request_.radius, .result = {}});
      waiting_.erase(waiting_.begin());
    };
    if (leader == nullptr) {
      const Index alone = is_first_ && request_.keeps_plan ? 1 : count;
      while (std::ssize(proposals) < alone && !waiting_.empty()) take();
      is_first_ = false;
      return proposals;
    }
    std::vector<Index> order;
    for (Index i = 0; i < std::ssize(plans_); ++i)
      if (!plans_[i].exhausted) order.push_back(i);
    std::sort(order.begin(), order.end(), [&](Index a, Index b) { return plans_[a].loss < plans_[b].loss; });
    for (const Index i : order) {
      if (std::ssize(proposals) >= count) break;
      if (!proposals.empty() && is_poor && !waiting_.empty()) break;
      if (!proposals.empty() && !is_poor && plans_[i].loss > 4.0 * leader->loss) break;
      proposals.push_back({.point = {}, .anchor = i, .radius = plans_[i].radius, .result = {}});
    }
    while (std::ssize(proposals) < count && is_poor && !waiting_.empty()) take();
    if (std::ssize(proposals) < count && !proposals.empty() && proposals.front().anchor >= 0) {
      Proposal shorter = proposals.front();
      shorter.radius *= kSecondRadius;
      proposals.push_back(std::move(shorter));
    }
    return proposals;
  }

  /// Searches near its anchor, if it has one, and simulates. Runs beside others.
  /// @return whether it was simulated; false: the search promises nothing.
  bool run(Proposal& proposal) const {
    if (proposal.anchor >= 0) {
      const Simulated& anchor = plans_[proposal.anchor];
      proposal.point = owner_.planner_->search_near(request_.plan, {.anchor = anchor.point,
                                                                    .offset = anchor.offset,
                                                                    .radius = proposal.radius,
                                                                    .iterations = owner_.params_.iterations,
                                                                    .seed = request_.plan.seed});
      if (!(proposal.point.loss < (1.0 - kLeastGain) * anchor.loss)) return false;
    }
    proposal.result = owner_.simulate(request_, proposal.point);
    proposal.result.radius = proposal.radius;
    return true;
  }

  /// What a proposal tells of its anchor, and itself as a new anchor.
  void take(Proposal& proposal, bool was_simulated) {
    if (!was_simulated) {
      plans_[proposal.anchor].exhausted = true;
      return;
    }
    Simulated& result = proposal.result;
    if (proposal.anchor >= 0) {
      Simulated& anchor = plans_[proposal.anchor];
      const double step = owner_.planner_->distance(anchor.point, proposal.point);
      const double promised = anchor.loss - proposal.point.loss;
      const double gain = std::isfinite(result.loss) ? (anchor.loss - result.loss) / promised : -1.0;
      result.radius = kRegion.next(proposal.radius, step, gain);
      if (TrustRegion::is_poor(gain)) {
        anchor.radius = std::min(anchor.radius, result.radius);
        anchor.exhausted = anchor.radius < kLeastRadius;
      }
      // The better of the two goes on; the anchor waits behind it.
      if (gain > 0.0) anchor.radius *= kSecondRadius;
    }
    result.exhausted = result.exhausted || result.radius < kLeastRadius;
    if (std::isfinite(result.loss)) plans_.push_back(std::move(result));
  }

 private:
  const Corrector& owner_;
  const CorrectionRequest& request_;
  std::vector<PlanPoint> waiting_;
  std::vector<Simulated> plans_;
  bool is_first_ = true, has_more_;
};

Corrector::Corrector(std::shared_ptr<const Planner> planner, std::shared_ptr<const Twin> twin,
                     const CorrectionParams& params, Host& host)
    : planner_(std::move(planner)), twin_(std::move(twin)), params_(params), host_(host) {}

Corrector::Simulated Corrector::simulate(const CorrectionRequest& request, const PlanPoint& point) const {
  Simulated result;
  result.point = point;
  if (!planner_->keeps_limits(request.plan, point)) return result;
  const Controls controls = planner_->controls_of(request.plan, point);
  FoldResult fold;
  try {
    fold = twin_->fold(request.start, controls);
  } catch (const Diverged&) {
    return result;
  }
  if (!fold.released || fold.segments != point.release) return result;
  result.shapes = std::move(fold.shapes);
  if (request.learned) result.shapes.back() += *request.learned;
  const Positions& end = result.shapes.back();
  result.offset = end - planner_->predict(request.plan, point).back().mean;
  result.loss = result.point.loss = planner_->loss_of(request.plan, point, end);
  const auto& surface = request.plan.surface;  // what the planner knows of the goal
  result.error_mm = surface ? surface->chamfer_mm(end) : mean_distance_mm(end, *request.plan.goal, request.plan.counts);
  return result;
}

Correction Corrector::correct(const CorrectionRequest& request) const {
  const Step correcting("correction");
  if (request.candidates.empty()) throw ShapeError("correction: 0 candidates, must be at least 1");
  Correction correction;
  correction.radius = request.radius;
  Pool pool(*this, request);
  Index left = request.simulations;
  while (left > 0 && !host_.cancelled()) {
    auto proposals = pool.propose(std::min<Index>(left, params_.candidates));
    if (proposals.empty()) break;
    std::vector<std::uint8_t> simulated(proposals.size());
    host_.parallel_for(std::ssize(proposals), [&](std::int64_t i) { simulated[i] = pool.run(proposals[i]) ? 1 : 0; });
    for (std::size_t i = 0; i < proposals.size(); ++i) {
      Proposal& proposal = proposals[i];
      if (simulated[i] != 0) {
        --left;
        const bool first = correction.steps.empty();
        correction.steps.push_back({.release = proposal.point.release,
                                    .is_candidate = proposal.anchor < 0,
                                    .radius = proposal.radius,
                                    .expected = proposal.point.loss,
                                    .loss = proposal.result.loss,
                                    .error_mm = proposal.result.error_mm,
                                    .best = proposal.result.loss < correction.loss});
        correction.loss = std::min(correction.loss, proposal.result.loss);
        if (first) correction.first_error_mm = proposal.result.error_mm;
      }
      pool.take(proposal, simulated[i] != 0);
    }
    if (const Simulated* best = pool.best();
        best != nullptr && best->error_mm <= std::max(params_.enough_mm, request.enough_mm))
      break;
  }
  if (const Simulated* best = pool.best()) {
    correction.point = best->point;
    correction.shapes = best->shapes;
    correction.error_mm = best->error_mm;
    correction.radius = std::max(best->radius, kLeastRadius);
  }
  return correction;
}

}  // namespace weft
