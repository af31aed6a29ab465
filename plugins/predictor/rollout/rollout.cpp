#include "rollout.hpp"

#include <cmath>
#include <optional>

namespace weft::rollout {
namespace {

/// Halton point i (from 1) in 4 dimensions, bases 2, 3, 5, 7: the same few materials for every call, evenly spread.
PropertyVector halton(Index i) {
  constexpr Index bases[4] = {2, 3, 5, 7};
  PropertyVector point;
  for (Index p = 0; p < 4; ++p) {
    double fraction = 1.0, value = 0.0;
    for (Index n = i; n > 0; n /= bases[p]) {
      fraction /= static_cast<double>(bases[p]);
      value += fraction * static_cast<double>(n % bases[p]);
    }
    point(p) = value;
  }
  return point;
}

}  // namespace

/// One simulated case and sample.
struct RolloutPredictor::Run {
  MaterialProperties material = MaterialProperties::Zero();
  std::vector<Positions> shapes;                                    ///< [last requested segment]: after each segment
  std::vector<Positions> early;                                     ///< the same, released but not yet settled
  std::vector<std::shared_ptr<const SimulatorSnapshot>> snapshots;  ///< at the start of each segment
  std::vector<Vector> states;                                       ///< at the start of each segment
  Index release = 0;                        ///< 1-based segment at whose end the cloth is released; 0: never
  std::vector<std::vector<Index>> opening;  ///< [k]: hands that open at the end of each segment, while others go on
  Index early_frames = 0;                   ///< of settling in `early`
};

class RolloutPredictor::Lease {
 public:
  explicit Lease(const RolloutPredictor& owner) : owner_(owner) {
    {
      const std::lock_guard lock(owner.pool_mutex_);
      if (!owner.pool_.empty()) {
        simulator_ = owner.pool_.back();
        owner.pool_.pop_back();
        return;
      }
    }
    simulator_ = owner.host_.create<Simulator>(owner.simulator_slot_);
  }
  ~Lease() {
    const std::lock_guard lock(owner_.pool_mutex_);
    owner_.pool_.push_back(std::move(simulator_));
  }
  Lease(const Lease&) = delete;
  Lease& operator=(const Lease&) = delete;
  Simulator& operator*() const { return *simulator_; }

 private:
  const RolloutPredictor& owner_;
  std::shared_ptr<Simulator> simulator_;
};

/// Owns the unperturbed runs; pullback() simulates the perturbed ones.
class RolloutPrediction final : public PlainPrediction {
 public:
  using Run = RolloutPredictor::Run;
  using Lease = RolloutPredictor::Lease;

  RolloutPrediction(const RolloutPredictor& owner, const std::vector<PredictionCase>& cases,
                    const PredictionRequest& request)
      : PlainPrediction(cases.size()),
        owner_(owner),
        cases_(cases),
        request_(request),
        samples_(owner.params_.samples) {
    runs_.resize(cases_.size() * samples_);
    std::vector<std::string> errors(runs_.size());
    owner_.host_.parallel_for(static_cast<std::int64_t>(runs_.size()), [&](std::int64_t job) {
      try {
        simulate(cases_[job / samples_], job % samples_, runs_[job]);
      } catch (const Diverged& error) {
        errors[job] = error.what();
      }
    });
    early_.resize(cases_.size());
    for (std::size_t i = 0; i < cases_.size(); ++i) {
      for (std::size_t s = 0; s < samples_; ++s) {
        if (failures_[i].empty()) failures_[i] = errors[i * samples_ + s];
      }
      if (!failures_[i].empty()) continue;
      std::vector<const std::vector<Positions>*> sampled, early;
      for (std::size_t s = 0; s < samples_; ++s) {
        sampled.push_back(&runs_[i * samples_ + s].shapes);
        early.push_back(&runs_[i * samples_ + s].early);
      }
      shapes_[i] = moments(cases_[i], sampled);
      if (request_.gradients) early_[i] = moments(cases_[i], early);
    }
  }

  std::vector<CaseGradient> pullback(const std::vector<std::vector<ShapeCotangent>>& cotangents) const override {
    if (!request_.gradients) throw Unsupported("rollout: pullback needs a prediction made with gradients");
    require_shape("rollout: cotangent cases", cotangents.size(), cases_.size());
    std::vector<CaseGradient> gradients(cases_.size());
    // One job per case and perturbed input; a job runs all samples of that case.
    struct Job {
      std::size_t instance;
      Index segment, control;  // segment < 0: knowledge entry `control`, centre 0-3, width 4-7
    };
    std::vector<Job> jobs;
    for (std::size_t i = 0; i < cases_.size(); ++i) {
      const auto& one = cases_[i];
      gradients[i].controls = Controls::Zero(one.controls.rows(), one.controls.cols());
      require_shape("rollout: cotangents of a case", cotangents[i].size(), one.segments.size());
      Index last = 0;
      for (std::size_t k = 0; k < cotangents[i].size(); ++k) {
        if (cotangents[i][k].mean.rows() > 0 || cotangents[i][k].sigma.rows() > 0) last = one.segments[k];
      }
      if (!failures_[i].empty() || last == 0) continue;
      if (request_.control_gradients) {
        const Index active = active_segments(i, last);
        for (Index j = 0; j < active; ++j) {
          for (Index c = 0; c < one.controls.cols(); ++c) jobs.push_back({i, j, c});
        }
      }
      if (request_.knowledge_gradients) {
        for (Index p = 0; p < 8; ++p) jobs.push_back({i, -1, p});
      }
    }
    std::vector<double> derivatives(jobs.size());
    owner_.host_.parallel_for(static_cast<std::int64_t>(jobs.size()), [&](std::int64_t j) {
      const auto& job = jobs[j];
      derivatives[j] = job.segment < 0
                           ? knowledge_derivative(job.instance, job.control, cotangents[job.instance])
                           : control_derivative(job.instance, job.segment, job.control, cotangents[job.instance]);
    });
    for (std::size_t j = 0; j < jobs.size(); ++j) {
      auto& gradient = gradients[jobs[j].instance];
      if (jobs[j].segment >= 0) {
        gradient.controls(jobs[j].segment, jobs[j].control) = derivatives[j];
      } else if (jobs[j].control < 4) {
        gradient.centre(jobs[j].control) = derivatives[j];
      } else {
        gradient.width(jobs[j].control - 4) = derivatives[j];
      }
    }
    return gradients;
  }

  std::vector<std::vector<std::vector<ShapeCotangent>>> jvp(
      const std::vector<std::vector<CaseDirection>>& directions) const override {
    if (!request_.gradients) throw Unsupported("rollout: jvp needs a prediction made with gradients");
    require_shape("rollout: directions", directions.size(), cases_.size());
    std::vector<std::vector<std::vector<ShapeCotangent>>> result(cases_.size());
    std::vector<std::pair<std::size_t, std::size_t>> jobs;
    for (std::size_t i = 0; i < cases_.size(); ++i) {
      result[i].resize(directions[i].size());
      for (std::size_t d = 0; d < directions[i].size(); ++d) {
        const Controls& controls = directions[i][d].controls;
        require_shape("rollout: rows of a direction", controls.rows(), cases_[i].controls.rows());
        require_shape("rollout: columns of a direction", controls.cols(), cases_[i].controls.cols());
        jobs.emplace_back(i, d);
      }
    }
    owner_.host_.parallel_for(static_cast<std::int64_t>(jobs.size()), [&](std::int64_t j) {
      const auto [i, d] = jobs[j];
      result[i][d] =
          failures_[i].empty() ? jvp(i, directions[i][d]) : std::vector<ShapeCotangent>(cases_[i].segments.size());
    });
    return result;
  }

 private:
  /// Number of segments among the first `last` of a case whose controls have an effect: those up to its release.
  Index active_segments(std::size_t i, Index last) const {
    const Index release = runs_[i * samples_].release;
    return release > 0 ? std::min(last, release) : last;
  }

  /// Change of every requested shape along a direction, by finite differences. The step moves no control by more than
  /// `step` scales and no knowledge by more than `knowledge_step`.
  std::vector<ShapeCotangent> jvp(std::size_t i, const CaseDirection& direction) const {
    const auto& one = cases_[i];
    const auto variables = owner_.task_.trajectory->controls();
    const Index active = active_segments(i, one.segments.empty() ? 0 : one.segments.back());
    const double knowledge = std::max(direction.centre.cwiseAbs().maxCoeff(), direction.width.cwiseAbs().maxCoeff());
    double largest = knowledge / owner_.params_.knowledge_step;  // in steps
    Index from = knowledge > 0.0 ? 0 : active;                   // first segment that differs
    for (Index j = active - 1; j >= 0; --j) {
      for (Index c = 0; c < one.controls.cols(); ++c) {
        if (direction.controls(j, c) == 0.0) continue;
        const double scale = variables[c].scale;
        largest = std::max(largest, std::abs(direction.controls(j, c)) / (owner_.params_.step * scale));
        from = std::min(from, j);
      }
    }
    std::vector<ShapeCotangent> derivatives;
    const auto& here = early_[i];
    if (largest == 0.0) {
      for (const auto& shape : shapes_[i])
        derivatives.push_back(
            {Positions::Zero(shape.mean.rows(), 3), Positions::Zero(shape.sigma.rows(), shape.sigma.cols())});
      return derivatives;
    }
    double step = 1.0 / largest;
    if (!is_inside(one, direction, step) && is_inside(one, direction, -step)) step = -step;
    const auto sides = sides_of<std::vector<ShapeDistribution>>(
        step, is_inside(one, direction, -step),
        [&](double amount) { return perturbed_along(i, direction, amount, from); });
    const auto& there = sides.there ? *sides.there : here;
    const auto& back = sides.back ? *sides.back : here;
    for (std::size_t s = 0; s < there.size(); ++s)
      derivatives.push_back(
          {(there[s].mean - back[s].mean) / sides.length, (there[s].sigma - back[s].sigma) / sides.length});
    return derivatives;
  }

  /// The two sides of a difference; what is missing is replaced by the unperturbed value.
  template <class Value>
  struct Sides {
    std::optional<Value> there, back;
    double length = 0.0;  ///< from the one to the other
  };
  /// @param step of the first side. @param has_back whether the other side may be evaluated. It is if differences are
  /// central, or if the first side diverges. @throws Diverged if no side has a value.
  template <class Value, class Evaluate>
  Sides<Value> sides_of(double step, bool has_back, const Evaluate& evaluate) const {
    Sides<Value> sides;
    std::string why;
    const auto value_at = [&](double amount) -> std::optional<Value> {
      try {
        return evaluate(amount);
      } catch (const Diverged& error) {
        why = error.what();
        return std::nullopt;
      }
    };
    sides.there = value_at(step);
    if (has_back && (!sides.there || owner_.params_.difference == "central")) sides.back = value_at(-step);
    if (!sides.there && !sides.back) throw Diverged("rollout: no difference has a result: " + why);
    sides.length = (sides.there ? step : 0.0) + (sides.back ? step : 0.0);
    return sides;
  }
  template <class Evaluate>
  double quotient(double step, bool has_back, double here, const Evaluate& evaluate) const {
    const auto sides = sides_of<double>(step, has_back, evaluate);
    return (sides.there.value_or(here) - sides.back.value_or(here)) / sides.length;
  }

  /// Whether knowledge stays within [0, 1] and no control passes a bound, where the direction moves them.
  bool is_inside(const PredictionCase& one, const CaseDirection& direction, double step) const {
    const auto in_unit = [&](const PropertyVector& value, const PropertyVector& change) {
      const PropertyVector moved = value + step * change;
      for (Index p = 0; p < 4; ++p)
        if (change(p) != 0.0 && (moved(p) < 0.0 || moved(p) > 1.0)) return false;
      return true;
    };
    const auto variables = owner_.task_.trajectory->controls();
    for (Index c = 0; c < one.controls.cols(); ++c) {
      const auto& v = variables[c];
      for (Index j = 0; j < one.controls.rows(); ++j) {
        const double moved = one.controls(j, c) + step * direction.controls(j, c);
        if (direction.controls(j, c) != 0.0 && (moved < v.lower || moved > v.upper)) return false;
      }
    }
    return in_unit(one.knowledge.centre, direction.centre) && in_unit(one.knowledge.width, direction.width);
  }

  std::vector<ShapeDistribution> perturbed_along(std::size_t i, const CaseDirection& direction, double step,
                                                 Index from) const {
    MaterialKnowledge knowledge = cases_[i].knowledge;
    knowledge.centre += step * direction.centre;
    knowledge.width += step * direction.width;
    return perturbed(i, cases_[i].controls + step * direction.controls, from, knowledge);
  }

  /// Simulates from the start of `from` (0-based segment; its snapshot must be taken) to the last requested segment.
  /// @param run of the case, unperturbed: hands open and release in its segments.
  /// @param settle_frames frames of settling in a perturbed run. @param record `run` while it is made, which settles to the
  /// end; null for a perturbed run.
  void advance(Simulator& simulator, const PredictionCase& one, const Controls& controls, Index from, Vector state,
               const Run& run, Index settle_frames, std::vector<Positions>& shapes, Run* record) const {
    const auto& task = owner_.task_;
    const auto& trajectory = *task.trajectory;
    const Index last = one.segments.empty() ? 0 : one.segments.back(), release = run.release;
    for (Index j = from; j < last; ++j) {
      if (release > 0 && j >= release) {  // segments after the release have no effect (section 4)
        shapes.push_back(shapes.back());
        if (record) record->early.push_back(record->early.back());
        continue;
      }
      if (record) {
        record->states.push_back(state);
        if (request_.gradients && request_.control_gradients && owner_.has_snapshots_)
          record->snapshots.push_back(simulator.save());
      }
      const SegmentPath path = trajectory.segment(task.manipulation, state, controls.row(j).transpose());
      for (const auto& targets : path.targets) move_hands(simulator, task.manipulation, targets);
      state = path.end_state;
      if (j + 1 == release) {
        simulator.release();
        SettleCriterion settle = task.settle;
        if (settle_frames > 0) settle.max_frames = std::min(settle.max_frames, settle_frames);
        const SettleResult early = simulator.settle(settle);
        if (record) {
          record->early.push_back(simulator.positions());
          record->early_frames = early.frames;
          settle.max_frames = task.settle.max_frames - early.frames;
          if (!early.settled && settle.max_frames > 0) simulator.settle(settle);
        }
      } else {
        open_hands(simulator, task.manipulation, run.opening[j]);
        if (record) record->early.push_back(simulator.positions());
      }
      shapes.push_back(simulator.positions());
    }
  }

  void simulate(const PredictionCase& one, Index sample, Run& run) const {
    const auto& trajectory = *owner_.task_.trajectory;
    run.material = owner_.material(one.knowledge, sample);
    const Index u = trajectory.release_segment(owner_.task_.manipulation, one.state, one.controls);
    const RowMatrix states = trajectory.segment_states(owner_.task_.manipulation, one.state, one.controls);
    run.release = trajectory.released(states.row(u - 1).transpose()) ? u : 0;
    run.opening.resize(one.controls.rows());
    Vector state = one.state;
    for (Index j = 0; j < one.controls.rows() && owner_.task_.manipulation.opens_at.size() > 0; ++j) {
      SegmentPath path = trajectory.segment(owner_.task_.manipulation, state, one.controls.row(j).transpose());
      run.opening[j] = std::move(path.opening);
      state = std::move(path.end_state);
    }
    const Lease lease(owner_);
    owner_.start(*lease, one, run.material);
    advance(*lease, one, one.controls, 0, one.state, run, owner_.params_.difference_settle_frames, run.shapes, &run);
  }

  /// Mean and sigma over the samples, for every requested segment. Sigma adds the declared noise level.
  std::vector<ShapeDistribution> moments(const PredictionCase& one,
                                         const std::vector<const std::vector<Positions>*>& sampled) const {
    std::vector<ShapeDistribution> result;
    const double n = static_cast<double>(sampled.size());
    for (const Index segment : one.segments) {
      const std::size_t at = segment - 1;
      ShapeDistribution distribution;
      distribution.mean = (*sampled.front())[at];
      for (std::size_t s = 1; s < sampled.size(); ++s) distribution.mean += (*sampled[s])[at];
      distribution.mean /= n;
      if (request_.moments == Moments::mean_and_sigma) {
        Positions variance =
            Positions::Constant(distribution.mean.rows(), 3, owner_.params_.sigma_m * owner_.params_.sigma_m);
        for (const auto* shapes : sampled) variance.array() += ((*shapes)[at] - distribution.mean).array().square() / n;
        distribution.sigma = variance.cwiseSqrt();
      } else {
        distribution.sigma.resize(0, 3);
      }
      result.push_back(std::move(distribution));
    }
    return result;
  }

  static double dot(const std::vector<ShapeDistribution>& shapes, const std::vector<ShapeCotangent>& cotangents) {
    double sum = 0.0;
    for (std::size_t k = 0; k < shapes.size(); ++k) {
      if (cotangents[k].mean.rows() > 0) sum += shapes[k].mean.cwiseProduct(cotangents[k].mean).sum();
      if (cotangents[k].sigma.rows() > 0) sum += shapes[k].sigma.cwiseProduct(cotangents[k].sigma).sum();
    }
    return sum;
  }

  /// Shapes of a case with other controls, equal to its own before segment `from`, and with other knowledge.
  std::vector<ShapeDistribution> perturbed(std::size_t i, const Controls& controls, Index from,
                                           const MaterialKnowledge& knowledge) const {
    const auto& one = cases_[i];
    const bool same_material = knowledge.centre == one.knowledge.centre && knowledge.width == one.knowledge.width;
    std::vector<std::vector<Positions>> shapes(samples_);
    std::vector<const std::vector<Positions>*> sampled;
    const Lease lease(owner_);
    for (std::size_t s = 0; s < samples_; ++s) {
      const Run& run = runs_[i * samples_ + s];
      const auto material = same_material ? run.material : owner_.material(knowledge, s);
      owner_.start(*lease, one, material);
      Vector state = one.state;
      Index first = 0;
      if (same_material && !run.snapshots.empty()) {
        (*lease).restore(*run.snapshots[from]);
        state = run.states[from];
        first = from;
        shapes[s].assign(run.shapes.begin(), run.shapes.begin() + from);
      }
      // As many frames as the unperturbed run, so that only the controls make a difference.
      advance(*lease, one, controls, first, state, run, run.early_frames, shapes[s], nullptr);
      sampled.push_back(&shapes[s]);
    }
    return moments(one, sampled);
  }

  /// <cotangents, shapes> with control (segment, control) changed by `change`.
  double perturbed_control(std::size_t i, Index segment, Index control, double change,
                           const std::vector<ShapeCotangent>& cotangents) const {
    Controls controls = cases_[i].controls;
    controls(segment, control) += change;
    return dot(perturbed(i, controls, segment, cases_[i].knowledge), cotangents);
  }

  double control_derivative(std::size_t i, Index segment, Index control,
                            const std::vector<ShapeCotangent>& cotangents) const {
    const auto variable = owner_.task_.trajectory->controls()[control];
    double step = owner_.params_.step * variable.scale;
    // Step inwards where the control stands at its upper bound.
    const double value = cases_[i].controls(segment, control);
    if (value + step > variable.upper) step = -step;
    const bool is_inside = value - step >= variable.lower && value - step <= variable.upper;
    return quotient(step, is_inside || owner_.params_.difference == "central", dot(early_[i], cotangents),
                    [&](double change) { return perturbed_control(i, segment, control, change, cotangents); });
  }

  double perturbed_knowledge(std::size_t i, Index entry, double change,
                             const std::vector<ShapeCotangent>& cotangents) const {
    MaterialKnowledge knowledge = cases_[i].knowledge;
    (entry < 4 ? knowledge.centre(entry) : knowledge.width(entry - 4)) += change;
    return dot(perturbed(i, cases_[i].controls, 0, knowledge), cotangents);
  }

  double knowledge_derivative(std::size_t i, Index entry, const std::vector<ShapeCotangent>& cotangents) const {
    if (entry >= 4 && samples_ == 1) return 0.0;  // a single sample sits in the middle of an interval of any width
    const auto& knowledge = cases_[i].knowledge;
    const double value = entry < 4 ? knowledge.centre(entry) : knowledge.width(entry - 4);
    double step = owner_.params_.knowledge_step;
    if (value + step > 1.0) step = -step;
    const bool has_both_sides = value - step >= 0.0 && value - step <= 1.0;
    return quotient(step, has_both_sides, dot(early_[i], cotangents),
                    [&](double change) { return perturbed_knowledge(i, entry, change, cotangents); });
  }

  const RolloutPredictor& owner_;
  std::vector<PredictionCase> cases_;
  PredictionRequest request_;
  std::size_t samples_;
  std::vector<Run> runs_;                              // [cases * samples]
  std::vector<std::vector<ShapeDistribution>> early_;  // unperturbed shapes of the differences
};

RolloutPredictor::RolloutPredictor(const Params& params, Host& host) : params_(params), host_(host) {}

PredictorCapabilities RolloutPredictor::capabilities() const {
  return {.gradients = true,
          .jvp = true,
          .deterministic = true,
          .needs_binding = true,
          .obstacles = true,
          .opening_hands = true};
}

void RolloutPredictor::bind(const Task& task) {
  simulator_slot_ = params_.simulator.is_null() ? task.simulator : params_.simulator;
  if (simulator_slot_.is_null()) throw ConfigError("rollout: neither its params nor the task names a simulator");
  {
    const std::lock_guard lock(pool_mutex_);
    pool_.clear();
  }
  const Lease first(*this);  // reports a wrong simulator now, not in the first plan
  has_snapshots_ = (*first).capabilities().snapshots;
  task_ = task;
}

MaterialProperties RolloutPredictor::material(const MaterialKnowledge& knowledge, Index sample) const {
  const PropertyVector lower = knowledge.lower();
  const PropertyVector upper = knowledge.upper();
  if (params_.samples == 1) return 0.5 * (lower + upper);
  return lower + halton(sample + 1).cwiseProduct(upper - lower);
}

void RolloutPredictor::start(Simulator& simulator, const PredictionCase& one,
                             const MaterialProperties& material) const {
  simulator.reset(task_.garment, task_.material.at(material), task_.scene);
  Positions velocities = Positions::Zero(one.shape->rows(), 3);
  if (one.previous && params_.carry_velocity) {
    velocities = (*one.shape - *one.previous) / (kFrameSeconds * static_cast<double>(kFramesPerSegment));
  }
  simulator.set_state(*one.shape, velocities, task_.held_at(one.state));
}

std::unique_ptr<Prediction> RolloutPredictor::predict(const std::vector<PredictionCase>& cases,
                                                      const PredictionRequest& request) const {
  check_cases("rollout", task_, cases);
  return std::make_unique<RolloutPrediction>(*this, cases, request);
}

}  // namespace weft::rollout
