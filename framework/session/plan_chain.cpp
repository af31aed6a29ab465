#include "session/plan_chain.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>
#include <utility>

#include "loader/where.hpp"
#include "simulation/hand_limits.hpp"

namespace weft {
namespace {

constexpr double kNever = std::numeric_limits<double>::infinity();
constexpr double kSameMaterial = 1e-3;  // change of a normalised property below which the simulated past is kept
constexpr double kSameShape = 2e-5;     // m: pulling the twin by less than this would only drop its contacts
constexpr double kStalledGain = 0.05;   // share of the loss; a correction that gains less, in a small region, has ended
constexpr double kLaterRadius = 0.15;   // of the first radius: with which a later correction begins at least
constexpr double kWorse_mm = 0.1;       // a forecast that got worse by more is corrected again

}  // namespace

Plan rest_of(const Plan& plan) {
  Plan rest = plan;
  rest.controls = plan.controls.bottomRows(plan.controls.rows() - 1);
  if (!rest.shapes.empty()) rest.shapes.erase(rest.shapes.begin());
  rest.points.clear();
  rest.curves.clear();
  rest.ended = {};
  rest.iterations = rest.evaluations = 0;
  rest.seconds = 0.0;
  return rest;
}

PlanChain::PlanChain(std::shared_ptr<const Planner> planner, std::shared_ptr<const Twin> twin,
                     const CorrectionParams& params, Host& host, const TrialMemory& memory)
    : planner_(planner),
      twin_(twin),
      params_(params),
      host_(host),
      before_(memory),
      corrector_(std::move(planner), twin, params, host),
      filter_(*twin->task().garment),
      error_mm_(kNever),
      radius_(params.radius) {}

PlanChain::~PlanChain() {
  if (outcome_.valid()) outcome_.wait();
}

std::pair<Plan, std::optional<CorrectionRecord>> PlanChain::first(const PlanRequest& request) {
  const auto started = std::chrono::steady_clock::now();
  base_ = request;
  knowledge_ = request.knowledge;
  executed_.resize(0, twin_->task().trajectory->controls().size());
  plan_ = planner_->plan(request);
  std::optional<CorrectionRecord> record;
  if (knowledge_.width.mean() <= params_.max_width && plan_.releases) {
    track_ = {twin_->start(knowledge_.centre)};
    CorrectionRequest correction;
    correction.candidates = plan_.points;
    // Not first: where a single plan is simulated, it is that of what is known now.
    if (!before_.learned.empty())
      correction.candidates.insert(correction.candidates.begin() + (correction.candidates.empty() ? 0 : 1),
                                   planner_->point_of(request, before_.controls));
    correction.simulations = params_.simulations;
    correction.radius = params_.radius;
    const Plan network = plan_;
    Outcome outcome = corrected(request, std::move(correction), track_.front(), 0, 0);
    if (outcome.plan) {
      plan_ = std::move(*outcome.plan);
      // What the search of the network did stays on record.
      plan_.losses = network.losses;
      plan_.curves = network.curves;
      plan_.ended = network.ended;
      plan_.instance = network.instance;
      plan_.iterations = network.iterations;
      plan_.evaluations = network.evaluations;
      plan_.seconds = network.seconds;
      error_mm_ = outcome.record.corrected_mm;
      radius_ = outcome.radius;
    }
    record = std::move(outcome.record);
    record->seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - started).count();
  }
  return {plan_, record};
}

std::pair<Plan, std::optional<CorrectionRecord>> PlanChain::next(const PlanRequest& request,
                                                                 const std::function<MaterialKnowledge()>& knowledge) {
  plan_ = rest_of(plan_);
  std::optional<CorrectionRecord> record;
  const Index now = executed_.rows();
  if (pending_ && pending_->due == now) record = finish();
  // Until the first correction the network plans again, whatever the number of later simulations.
  if (!pending_ && (params_.later_simulations > 0 || !std::isfinite(error_mm_))) {
    start(knowledge);
    if (pending_ && pending_->due == now) record = finish();
  }
  if (plan_.controls.rows() == 0) {  // it ended without a release
    PlanRequest now_known = request;
    now_known.knowledge = knowledge_ = knowledge();
    plan_ = planner_->plan(now_known);
    error_mm_ = kNever;
  }
  return {plan_, record};
}

const Plan& PlanChain::rest() {
  plan_ = rest_of(plan_);
  return plan_;
}

void PlanChain::add(ConstVec control, const Observation& seen) {
  executed_.conservativeResize(executed_.rows() + 1, Eigen::NoChange);
  executed_.bottomRows(1) = control.transpose();
  seen_.push_back(std::make_shared<const Observation>(seen));
}

void PlanChain::start(const std::function<MaterialKnowledge()>& knowledge) {
  const Index now = executed_.rows();
  if (params_.lag >= plan_.controls.rows()) return;  // the plan is over before
  pending_ = Work{.started = now,
                  .due = now + params_.lag,
                  .base = base_,
                  .rest = plan_.controls,
                  .executed = executed_,
                  .seen = seen_,
                  .knowledge = knowledge,
                  .error_mm = error_mm_,
                  .radius = radius_,
                  .stalled = stalled_};
  const bool beside = params_.lag > 0 && host_.threads() > 1;
  outcome_ =
      std::async(beside ? std::launch::async : std::launch::deferred, [this, task = *pending_] { return work(task); });
}

std::optional<CorrectionRecord> PlanChain::finish() {
  Outcome outcome = outcome_.get();
  const bool recorded = std::find(params_.dropped.begin(), params_.dropped.end(),
                                  static_cast<double>(pending_->started)) != params_.dropped.end();
  outcome.record.dropped = recorded || (params_.time_budget_s > 0.0 && outcome.record.seconds > params_.time_budget_s);
  if (outcome.record.dropped) {
    dropped_.push_back(pending_->started);
  } else {
    knowledge_ = outcome.knowledge;
    error_mm_ = outcome.corrected ? outcome.record.corrected_mm : kNever;
    radius_ = outcome.radius;
    stalled_ = outcome.stalled;
    if (outcome.plan) plan_ = std::move(*outcome.plan);
  }
  pending_.reset();
  return outcome.record;
}

TwinState PlanChain::twin_at(const Work& work, const MaterialProperties& material) {
  if (track_.empty() || (track_.front().material - material).cwiseAbs().maxCoeff() > kSameMaterial)
    track_ = {twin_->start(material)};
  for (Index j = std::ssize(track_) - 1; j < work.executed.rows(); ++j) {
    TwinState after = twin_->advance(track_.back(), work.executed.row(j).transpose());
    const Positions pulled = filter_.pulled(after.positions, *work.seen[j], twin_->task().held_at(after.state));
    if ((pulled - after.positions).cwiseAbs().maxCoeff() > kSameShape) {
      after.positions = pulled;
      after.snapshot = nullptr;
    }
    track_.push_back(std::move(after));
  }
  return track_[work.executed.rows()];
}

TrialMemory PlanChain::memory(bool released) {
  if (outcome_.valid()) outcome_.wait();
  TrialMemory memory{.controls = executed_, .knowledge = knowledge_, .learned = {}};
  const Index segments = executed_.rows();
  if (!released || segments == 0) return memory;
  Work past{.executed = executed_.topRows(segments - 1), .seen = seen_};
  std::vector<std::shared_ptr<const Positions>> learned(segments);
  try {
    twin_at(past, knowledge_.centre);
    host_.parallel_for(segments, [&](Index j) {
      const FoldResult fold = twin_->fold(track_[j], executed_.bottomRows(segments - j));
      const Positions& forecast = fold.shapes.back();
      learned[j] = std::make_shared<const Positions>(*filled(*seen_.back(), forecast) - forecast);
    });
  } catch (const Diverged&) {
    return memory;  // what happened cannot be simulated, so nothing is learned from it
  }
  memory.learned = std::move(learned);
  return memory;
}

PlanChain::Outcome PlanChain::work(const Work& work) {
  const auto started = std::chrono::steady_clock::now();
  const Step segment("segment", work.due + 1);
  Outcome outcome;
  outcome.knowledge = work.knowledge();
  outcome.radius = work.radius;
  outcome.record.started = work.started;
  PlanRequest request = work.base;
  request.knowledge = outcome.knowledge;
  request.round = work.due;
  TwinState start = twin_at(work, outcome.knowledge.centre);
  if (work.started > 0) {
    const TwinState& before = track_[work.started - 1];
    request.previous = std::make_shared<const Positions>(before.positions);
    request.hand_step = last_step(twin_->task(), before.state, work.executed.bottomRows(1).transpose());
  }
  const Index lag = work.due - work.started;
  for (Index j = 0; j < lag; ++j) {
    request.previous = std::make_shared<const Positions>(start.positions);
    request.hand_step = last_step(twin_->task(), start.state, work.rest.row(j).transpose());
    start = twin_->advance(start, work.rest.row(j).transpose());
  }
  request.shape = std::make_shared<const Positions>(start.positions);
  request.state = start.state;
  request.warm_start = work.rest.bottomRows(work.rest.rows() - lag);
  if (outcome.knowledge.width.mean() > params_.max_width) {
    outcome.plan = planner_->plan(request);
  } else {
    CorrectionRequest correction;
    correction.candidates = {planner_->point_of(request, request.warm_start)};
    correction.radius =
        std::isfinite(work.error_mm) ? std::max(work.radius, kLaterRadius * params_.radius) : params_.radius;
    correction.keeps_plan = true;
    correction.is_new = !std::isfinite(work.error_mm);
    correction.simulations = correction.is_new ? params_.simulations : params_.later_simulations;
    // A plan that the last correction could not make better is only measured, unless it has got worse.
    correction.enough_mm = work.stalled ? work.error_mm + kWorse_mm : 0.0;
    correction.more = [this, &request, is_new = correction.is_new] {
      std::vector<PlanPoint> points = planner_->plan(request).points;
      if (!is_new) return points;
      // What is known now may ask for another fold than the one that was begun.
      PlanRequest afresh = request;
      afresh.warm_start.resize(0, request.warm_start.cols());
      for (auto& point : planner_->plan(afresh).points) points.push_back(std::move(point));
      std::stable_sort(points.begin(), points.end(),
                       [](const PlanPoint& a, const PlanPoint& b) { return a.loss < b.loss; });
      return points;
    };
    const double radius = outcome.radius;
    outcome = corrected(request, std::move(correction), start, work.started, work.due);
    outcome.knowledge = request.knowledge;
    if (!outcome.plan) outcome.radius = radius;
  }
  outcome.record.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - started).count();
  return outcome;
}

PlanChain::Outcome PlanChain::corrected(const PlanRequest& request, CorrectionRequest correction,
                                        const TwinState& start, Index started, Index due) {
  Outcome outcome;
  if (const Index known = std::ssize(before_.learned); known > 0)
    correction.learned = before_.learned[std::min(due, known - 1)];
  correction.plan = request;
  correction.start = start;
  const Correction result = corrector_.correct(correction);
  outcome.record.started = started;
  outcome.record.forecast_mm = result.first_error_mm;
  outcome.record.steps = result.steps;
  outcome.radius = result.radius;
  if (!std::isfinite(result.loss)) return outcome;
  outcome.corrected = true;
  outcome.stalled =
      result.loss > (1.0 - kStalledGain) * result.steps.front().loss && result.radius < kLaterRadius * params_.radius;
  outcome.record.corrected_mm = result.error_mm;
  Plan plan = planner_->plan_of(request, result.point);
  for (std::size_t j = 0; j < plan.shapes.size(); ++j) plan.shapes[j].mean = result.shapes[j];
  plan.predicted_error_mm = result.error_mm;
  plan.losses = {result.loss};
  outcome.plan = std::move(plan);
  return outcome;
}

}  // namespace weft
