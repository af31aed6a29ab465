#include "weft/batching.hpp"

#include <algorithm>
#include <cmath>
#include <condition_variable>
#include <exception>
#include <memory>
#include <mutex>
#include <system_error>
#include <thread>

namespace weft {

namespace {

/// Synchronises the threads of one minimise_pointwise(). An instance is `working` (its solver computes), `asking`
/// (blocked in evaluate()) or `gone`. The caller's thread waits until no instance works, evaluates the requested points
/// and answers.
class Meeting {
 public:
  class Instance final : public PointwiseSearch {
   public:
    Instance(Meeting& meeting, Index number, Vector start) : meeting_(meeting), number_(number) {
      result_.x = std::move(start);
    }

    Index instance() const override { return number_; }
    const PointValue* evaluate(ConstVec x, const EvaluationRequest& request) override {
      require_shape("batching: x", x.size(), result_.x.size());
      if (over_) return nullptr;
      if (!x.allFinite()) {
        value_ = {};
        value_.cost = std::numeric_limits<double>::infinity();
        value_.gradient = Vector::Zero(request.gradients ? x.size() : 0);
        value_.residuals = Vector::Zero(request.residuals ? meeting_.residuals_ : 0);
        value_.jacobian = Matrix::Zero(request.jacobians ? meeting_.residuals_ : 0, x.size());
        last_was_finite_ = false;
        // This is not an evaluation, but a solver that only asks for such points must end too.
        if (++refused_ > kMostRefused) end(OptimiserStatus::diverged, "the solver asks for points that are not finite");
        return over_ ? nullptr : &value_;
      }
      if (result_.evaluations >= meeting_.options_.max_evaluations) {
        end(OptimiserStatus::budget_spent, "max_evaluations");
        return nullptr;
      }
      x_ = meeting_.bounds_.clamp(x);
      request_ = request;
      meeting_.ask(*this);
      return over_ ? nullptr : &value_;
    }
    bool over() const override { return over_; }
    void count_iteration() override { ++result_.iterations; }
    Index evaluations() const override { return result_.evaluations; }
    const Vector& best_x() const override { return result_.x; }
    double best_cost() const override { return result_.cost; }
    bool last_was_finite() const override { return last_was_finite_; }

   private:
    friend class Meeting;
    static constexpr Index kMostRefused = 1000;
    enum class State { working, asking, gone };

    /// Keeps the first reason.
    void end(OptimiserStatus status, std::string message) {
      if (over_) return;
      over_ = true;
      result_.status = status;
      result_.message = std::move(message);
    }
    void take(const Evaluation& e, Index column) {
      ++result_.evaluations;
      value_ = {};
      value_.cost = e.costs[column];
      value_.finite = std::isfinite(value_.cost);
      if (request_.gradients) {
        value_.gradient = e.gradients.col(column);
        value_.finite = value_.finite && value_.gradient.allFinite();
      }
      if (request_.residuals) {
        value_.residuals = e.residuals.col(column);
        value_.finite = value_.finite && value_.residuals.allFinite();
      }
      if (request_.jacobians) {
        value_.jacobian = e.jacobians[column];
        value_.finite = value_.finite && value_.jacobian.allFinite();
      }
      last_was_finite_ = value_.finite;
      if (value_.finite && value_.cost < result_.cost) {
        result_.cost = value_.cost;
        result_.x = x_;
      }
    }

    Meeting& meeting_;
    Index number_;
    OptimiserResult result_;
    bool over_ = false;
    bool last_was_finite_ = false;
    Index refused_ = 0;
    // The instance's thread writes x_ and request_ before it asks, and the caller's thread reads them. For value_ it is
    // the other way round.
    Vector x_;
    EvaluationRequest request_;
    PointValue value_;
    State state_ = State::working;  // guarded by the meeting's mutex
    std::condition_variable answered_;
    std::exception_ptr error_;
  };

  Meeting(Objective& objective, const Box& bounds, const OptimiserOptions& options)
      : objective_(objective), residuals_(objective.capabilities().residuals), bounds_(bounds), options_(options) {}

  std::vector<OptimiserResult> run(const std::string& who, ConstMatrix starts, const OptimiserObserver& observer,
                                   const PointwiseSolver& solver) {
    for (Index i = 0; i < starts.cols(); ++i)
      instances_.push_back(std::make_unique<Instance>(*this, i, bounds_.clamp(starts.col(i))));
    working_ = instances_.size();

    std::vector<std::thread> threads;
    std::exception_ptr error;
    try {
      threads.reserve(instances_.size());
      for (auto& one : instances_) threads.emplace_back([this, &one, &solver] { solve(*one, solver); });
    } catch (const std::system_error& failure) {
      error = std::make_exception_ptr(Error(who + ": cannot start a thread for each of " +
                                            std::to_string(instances_.size()) + " instances: " + failure.what()));
      const std::lock_guard lock(mutex_);
      for (std::size_t i = threads.size(); i < instances_.size(); ++i) instances_[i]->state_ = Instance::State::gone;
      working_ -= instances_.size() - threads.size();
    }

    for (Index round = 0;; ++round) {
      const auto asking = wait_until_nobody_works();
      if (!error) error = first_error();
      if (asking.empty()) break;
      if (!error) {
        try {
          evaluate(asking);
          if (observer && !observer(round, best_costs()))
            for (auto& one : instances_) one->end(OptimiserStatus::stopped, "stopped by the observer");
          for (auto* one : asking)
            if (options_.wanted && !options_.wanted(one->number_))
              one->end(OptimiserStatus::stopped, "not wanted any more");
        } catch (...) {
          error = std::current_exception();
        }
      }
      if (error)
        for (auto* one : asking) one->end(OptimiserStatus::stopped, "ended by an exception");
      answer(asking);
    }
    for (auto& thread : threads) thread.join();
    if (error) std::rethrow_exception(error);

    std::vector<OptimiserResult> results;
    for (auto& one : instances_) {
      auto& result = one->result_;
      if (result.evaluations > 0 && !std::isfinite(result.cost)) {
        result.status = OptimiserStatus::diverged;
        result.message = "no finite cost was found";
      }
      results.push_back(std::move(result));
    }
    return results;
  }

 private:
  /// Runs on an instance's thread. Results and exceptions leave it through the instance only.
  void solve(Instance& one, const PointwiseSolver& solver) {
    try {
      SolverOutcome outcome = solver(one, one.result_.x);
      one.end(outcome.status, std::move(outcome.message));
    } catch (...) {
      one.error_ = std::current_exception();
    }
    const std::lock_guard lock(mutex_);
    one.over_ = true;
    one.state_ = Instance::State::gone;
    if (--working_ == 0) nobody_works_.notify_one();
  }

  void ask(Instance& one) {
    std::unique_lock lock(mutex_);
    one.state_ = Instance::State::asking;
    if (--working_ == 0) nobody_works_.notify_one();
    one.answered_.wait(lock, [&] { return one.state_ == Instance::State::working; });
  }

  /// @return the instances that ask, ascending.
  std::vector<Instance*> wait_until_nobody_works() {
    std::unique_lock lock(mutex_);
    nobody_works_.wait(lock, [&] { return working_ == 0; });
    std::vector<Instance*> asking;
    for (auto& one : instances_)
      if (one->state_ == Instance::State::asking) asking.push_back(one.get());
    return asking;
  }

  void answer(const std::vector<Instance*>& asking) {
    const std::lock_guard lock(mutex_);
    working_ = asking.size();
    for (auto* one : asking) {
      one->state_ = Instance::State::working;
      one->answered_.notify_one();
    }
  }

  std::exception_ptr first_error() const {
    for (const auto& one : instances_)
      if (one->error_) return one->error_;
    return nullptr;
  }

  Vector best_costs() const {
    Vector costs(instances_.size());
    for (const auto& one : instances_) costs[one->number_] = one->result_.cost;
    return costs;
  }

  void evaluate(const std::vector<Instance*>& asking) {
    std::vector<EvaluationRequest> kinds;
    for (const auto* one : asking)
      if (std::find(kinds.begin(), kinds.end(), one->request_) == kinds.end()) kinds.push_back(one->request_);
    for (const auto& kind : kinds) {
      std::vector<Instance*> group;
      std::vector<Index> numbers;
      for (auto* one : asking) {
        if (!(one->request_ == kind)) continue;
        group.push_back(one);
        numbers.push_back(one->number_);
      }
      const Index n = group.size();
      const Index dim = bounds_.dim();
      Matrix x(dim, n);
      for (Index j = 0; j < n; ++j) x.col(j) = group[j]->x_;
      const Evaluation e = objective_.evaluate(x, numbers, kind);
      require_shape("batching: costs of the objective", e.costs.size(), n);
      if (kind.gradients) {
        require_shape("batching: rows of the objective's gradients", e.gradients.rows(), dim);
        require_shape("batching: columns of the objective's gradients", e.gradients.cols(), n);
      }
      if (kind.residuals) {
        require_shape("batching: rows of the objective's residuals", e.residuals.rows(), residuals_);
        require_shape("batching: columns of the objective's residuals", e.residuals.cols(), n);
      }
      if (kind.jacobians) {
        require_shape("batching: the objective's Jacobians", e.jacobians.size(), n);
        for (const auto& jacobian : e.jacobians) {
          require_shape("batching: rows of a Jacobian", jacobian.rows(), residuals_);
          require_shape("batching: columns of a Jacobian", jacobian.cols(), dim);
        }
      }
      for (Index j = 0; j < n; ++j) group[j]->take(e, j);
    }
  }

  Objective& objective_;
  Index residuals_;
  const Box& bounds_;
  const OptimiserOptions& options_;
  std::vector<std::unique_ptr<Instance>> instances_;
  std::mutex mutex_;
  std::condition_variable nobody_works_;
  std::size_t working_ = 0;
};

}  // namespace

std::vector<OptimiserResult> minimise_pointwise(const std::string& who, Objective& objective, ConstMatrix starts,
                                                const Box& bounds, ConstVec scale, const OptimiserOptions& options,
                                                const OptimiserObserver& observer, const PointwiseSolver& solver) {
  check_search(who, objective, starts, bounds, scale);
  if (starts.cols() == 0) return {};
  return Meeting(objective, bounds, options).run(who, starts, observer, solver);
}

}  // namespace weft
