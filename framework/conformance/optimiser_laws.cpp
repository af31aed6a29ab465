// The laws of an optimiser. They demand cost reductions within a budget, never minimisers.
#include <algorithm>
#include <atomic>
#include <functional>
#include <map>
#include <mutex>

#include "conformance/kit.hpp"
#include "weft/optimiser.hpp"

namespace weft::conformance {
namespace of_optimisers {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

/// One point of a test function: residuals and Jacobian; cost = 1/2 |r|^2.
struct Point {
  Vector r;
  Matrix j;
};
using Function = std::function<Point(const Vector& x)>;

/// A test function as an objective that records how it is called.
class Watched final : public Objective {
 public:
  Watched(Index dim, Function function, const OptimiserCapabilities& solver)
      : dim_(dim), function_(std::move(function)) {
    offered_.gradients = solver.needs_gradients;
    offered_.residuals = solver.needs_residuals ? function_(Vector::Zero(dim)).r.size() : 0;
  }
  Index dim() const override { return dim_; }
  ObjectiveCapabilities capabilities() const override { return offered_; }

  Evaluation evaluate(ConstMatrix x, const std::vector<Index>& instances, const EvaluationRequest& request) override {
    const std::lock_guard lock(mutex_);
    ++calls;
    if (throw_at_call > 0 && calls >= throw_at_call) throw Diverged("conformance: the objective says no");
    if (request.gradients && !offered_.gradients) throw Unsupported("conformance: gradients are not offered");
    if (request.residuals && offered_.residuals == 0) throw Unsupported("conformance: residuals are not offered");
    asked_gradients |= request.gradients;
    asked_residuals |= request.residuals;
    well_formed &= x.rows() == dim_ && x.cols() == std::ssize(instances) && x.cols() > 0 && x.allFinite();
    for (std::size_t i = 0; i < instances.size(); ++i) {
      well_formed &= instances[i] >= 0 && instances[i] < count && (i == 0 || instances[i] >= instances[i - 1]);
    }
    if (!well_formed) throw Error("conformance: a malformed batch");

    Evaluation e;
    e.costs.resize(x.cols());
    if (request.gradients) e.gradients.resize(dim_, x.cols());
    if (request.residuals) e.residuals.resize(offered_.residuals, x.cols());
    for (Index i = 0; i < x.cols(); ++i) {
      const Vector at = x.col(i);
      Point p = function_(at);
      double cost = 0.5 * p.r.squaredNorm();
      Vector gradient = p.j.transpose() * p.r;
      const Index instance = instances[i];
      if (hole && hole(at, instance)) {
        cost = instance % 2 == 0 ? kInfinity : kNaN;
        gradient.setConstant(kNaN);
        p.r.setConstant(kNaN);
        p.j.setConstant(kNaN);
      }
      e.costs[i] = cost;
      if (request.gradients) e.gradients.col(i) = gradient;
      if (request.residuals) {
        e.residuals.col(i) = p.r;
        e.jacobians.push_back(p.j);
      }
      ++evaluations[instance];
      if (std::isfinite(cost) && !(cost >= best[instance].first)) best[instance] = {cost, at};
      if (box.lower.size() == dim_) {
        outside.add(box.lower - at);
        outside.add(at - box.upper);
      }
    }
    return e;
  }
  double cost(const Vector& x) const { return 0.5 * function_(x).r.squaredNorm(); }
  void offer_everything() { offered_ = {true, function_(Vector::Zero(dim_)).r.size()}; }
  void offer(bool gradients, bool residuals) {
    offered_ = {gradients, residuals ? function_(Vector::Zero(dim_)).r.size() : 0};
  }

  struct Best : std::pair<double, Vector> {
    Best() : pair(kInfinity, Vector()) {}
    Best(double cost, Vector x) : pair(cost, std::move(x)) {}
  };
  Index count = 0;  // instances
  Index calls = 0, throw_at_call = 0;
  std::function<bool(const Vector& x, Index instance)> hole;
  Box box;
  Worst outside;  // units of x
  bool asked_gradients = false, asked_residuals = false, well_formed = true;
  std::map<Index, Index> evaluations;
  std::map<Index, Best> best;

 private:
  Index dim_;
  Function function_;
  ObjectiveCapabilities offered_;
  std::mutex mutex_;
};

/// sum of curvature_i (x_i - centre_i)^2 / 2
Function bowl(const Vector& centre, const Vector& curvature) {
  return [=](const Vector& x) {
    const Vector root = curvature.cwiseSqrt();
    return Point{root.cwiseProduct(x - centre), root.asDiagonal()};
  };
}

/// 100 (y - x^2)^2 + (1 - x)^2 [Rosenbrock 1960]
Point rosenbrock(const Vector& x) {
  Point p{Vector(2), Matrix(2, 2)};
  const double a = std::sqrt(200.0), b = std::sqrt(2.0);
  p.r << a * (x[1] - x[0] * x[0]), b * (1.0 - x[0]);
  p.j << -2.0 * a * x[0], a, -b, 0.0;
  return p;
}

/// A search: objective, starts, box, scale, budget.
struct Search {
  Search(const Optimiser& solver, Index dim, Function function, Matrix from, double half = 2.0)
      : optimiser(solver), objective(dim, std::move(function), solver.capabilities()), starts(std::move(from)) {
    box = {Vector::Constant(dim, -half), Vector::Constant(dim, half)};
    scale = Vector::Constant(dim, 0.25);
    options.max_iterations = 400;
    options.max_evaluations = 20000;
    options.seed = 1;
  }
  std::vector<OptimiserResult> run(const OptimiserObserver& observer = nullptr) {
    objective.count = starts.cols();
    objective.box = box;
    auto results = optimiser.minimise(objective, starts, box, scale, options, observer);
    require_shape("results of minimise()", results.size(), starts.cols());
    for (const auto& r : results) require_shape("x of a result", r.x.size(), starts.rows());
    return results;
  }
  /// Worst cost at a result over the cost at its start; `least` is the cost of the minimum.
  double worst_ratio(const std::vector<OptimiserResult>& results, double least = 0.0) const {
    Worst worst;
    for (std::size_t i = 0; i < results.size(); ++i) {
      const double from = objective.cost(starts.col(i));
      worst.add((objective.cost(results[i].x) - least) / (from - least));
    }
    return worst.value();
  }
  const Optimiser& optimiser;
  Watched objective;
  Matrix starts;
  Box box;
  Vector scale;
  OptimiserOptions options;
};

Matrix spread(Index dim, Index instances, std::uint64_t key = 0) {
  RandomStream random(21, key);
  Matrix m(dim, instances);
  for (Index i = 0; i < m.size(); ++i) m.data()[i] = random.uniform(-1.8, 1.8);
  return m;
}

Vector ramp(Index dim, double first, double last) {
  Vector v(dim);
  for (Index i = 0; i < dim; ++i)
    v[i] = first * std::pow(last / first, static_cast<double>(i) / static_cast<double>(std::max<Index>(dim - 1, 1)));
  return v;
}

Function small_bowl() {
  Vector centre(3);
  centre << 0.3, -0.4, 0.9;
  return bowl(centre, ramp(3, 1.0, 10.0));
}

double differing_results(const OptimiserResult& a, const OptimiserResult& b) {
  return differing(a.x, b.x) + (std::memcmp(&a.cost, &b.cost, sizeof a.cost) != 0) + (a.evaluations != b.evaluations) +
         (a.status != b.status);
}

// ---------------------------------------------------------------------------------------------------------------------

Outcome solves_an_ill_conditioned_quadratic(const Bench& bench) {
  const auto o = bench.make<Optimiser>();
  Vector centre(6);
  centre << 0.5, -0.7, 1.1, 0.0, -1.2, 0.3;
  Search s(*o, 6, bowl(centre, ramp(6, 1.0, 1000.0)), spread(6, 3));
  return {s.worst_ratio(s.run()), ""};
}

Outcome solves_rosenbrock(const Bench& bench) {
  const auto o = bench.make<Optimiser>();
  Matrix starts(2, 3);
  starts << -1.2, 0.5, 1.7, 1.0, -0.5, 1.9;
  Search s(*o, 2, rosenbrock, starts);
  return {s.worst_ratio(s.run()), ""};
}

Outcome finds_a_minimum_on_the_boundary(const Bench& bench) {
  const auto o = bench.make<Optimiser>();
  Vector centre(4), nearest_inside(4);
  centre << 3.0, -3.0, 0.3, -0.1;
  nearest_inside << 1.0, -1.0, 0.3, -0.1;
  Search s(*o, 4, bowl(centre, ramp(4, 1.0, 10.0)), 0.5 * spread(4, 3), 1.0);
  return {s.worst_ratio(s.run(), s.objective.cost(nearest_inside)), ""};
}

Outcome survives_holes(const Bench& bench) {
  const auto o = bench.make<Optimiser>();
  // The minimum (0.3, -0.4, 0.9) and the last start lie in the part x_0 > 0, where the cost is not finite.
  Matrix starts = spread(3, 3);
  starts.row(0) << -1.5, -0.9, 1.0;
  Search s(*o, 3, small_bowl(), starts);
  s.objective.hole = [](const Vector& x, Index) { return x[0] > 0.0; };
  const auto results = s.run();
  Worst worst;
  for (Index i = 0; i < 2; ++i) {
    const auto& r = results[i];
    if (!std::isfinite(r.cost) || !r.x.allFinite() || r.x[0] > 0.0)
      return failed("an instance that started outside the hole ended in it");
    worst.add(r.cost / s.objective.cost(starts.col(i)));
  }
  const auto& last = results[2];
  if (!last.x.allFinite()) return failed("an instance that started in the hole returned a non-finite x");
  if (std::isnan(last.cost))
    return failed("an instance that started in the hole returned the cost NaN, must be +infinity or finite");
  if (std::isfinite(last.cost) && last.x[0] > 0.0) return failed("the result has a finite cost at a point in the hole");
  if (!std::isfinite(last.cost) && last.status != OptimiserStatus::diverged)
    return failed(std::string("without a finite cost the status is ") + to_string(last.status) + ", must be diverged");
  return worst.outcome();
}

Outcome a_failed_instance_costs_only_itself(const Bench& bench) {
  const auto o = bench.make<Optimiser>();
  Search sound(*o, 3, small_bowl(), spread(3, 3)), holed(*o, 3, small_bowl(), spread(3, 3));
  holed.objective.hole = [](const Vector&, Index instance) { return instance == 1; };
  const auto a = sound.run(), b = holed.run();
  if (b[1].status != OptimiserStatus::diverged)
    return failed(std::string("an instance without a finite cost ended as ") + to_string(b[1].status));
  return {differing_results(a[0], b[0]) + differing_results(a[2], b[2]), ""};
}

Outcome asks_only_for_what_it_needs(const Bench& bench) {
  const auto o = bench.make<Optimiser>();
  const auto capabilities = o->capabilities();
  Search s(*o, 3, small_bowl(), spread(3, 2));
  s.options.max_iterations = 10;
  s.objective.offer_everything();
  s.run();
  Refusals wrong;
  if (s.objective.asked_gradients && !capabilities.needs_gradients)
    wrong.miss("gradients were requested, but are not declared");
  if (s.objective.asked_residuals && !capabilities.needs_residuals)
    wrong.miss("residuals were requested, but are not declared");
  return wrong.outcome();
}

Outcome refuses_objectives_that_lack_what_it_needs(const Bench& bench) {
  const auto o = bench.make<Optimiser>();
  const auto capabilities = o->capabilities();
  Refusals refusals;
  Search s(*o, 3, small_bowl(), spread(3, 2));
  s.options.max_iterations = 5;
  if (capabilities.needs_gradients) {
    s.objective.offer(false, true);
    refusals.wants<Unsupported>("an objective without gradients", [&] { s.run(); });
  }
  if (capabilities.needs_residuals) {
    s.objective.offer(true, false);
    refusals.wants<Unsupported>("an objective without residuals", [&] { s.run(); });
  }
  if (!capabilities.needs_gradients && !capabilities.needs_residuals) {
    s.objective.offer(false, false);
    s.run();  // costs are enough
  }
  if (s.objective.calls > 0 && (capabilities.needs_gradients || capabilities.needs_residuals))
    refusals.miss("the objective was evaluated before the refusal");
  return refusals.outcome();
}

Outcome instances_do_not_affect_one_another(const Bench& bench) {
  const auto o = bench.make<Optimiser>();
  const Matrix starts = spread(3, 4);
  Search all(*o, 3, small_bowl(), starts);
  const auto together = all.run();
  double wrong = 0.0;
  // Noise and batch rows are keyed on the instance, so the first n instances give the same bits without the others.
  for (Index n : {1, 2, 3}) {
    Search fewer(*o, 3, small_bowl(), starts.leftCols(n));
    const auto results = fewer.run();
    for (Index i = 0; i < n; ++i) wrong += differing_results(results[i], together[i]);
  }
  // The starts of the others do not matter either.
  Matrix moved = spread(3, 4, 1);
  moved.col(2) = starts.col(2);
  Search others(*o, 3, small_bowl(), moved);
  wrong += differing_results(others.run()[2], together[2]);
  // If the seed changes nothing, an instance does not depend on its number either.
  Search reseeded(*o, 3, small_bowl(), starts);
  reseeded.options.seed = 2;
  if (differing_results(reseeded.run()[2], together[2]) == 0) {
    Search alone(*o, 3, small_bowl(), starts.col(2));
    wrong += differing_results(alone.run()[0], together[2]);
  }
  return {wrong, ""};
}

Outcome budget_is_respected(const Bench& bench) {
  const auto o = bench.make<Optimiser>();
  Refusals wrong;
  for (const auto& [iterations, evaluations] : {std::pair<Index, Index>{1000, 7}, {3, 100000}, {1000, 1}}) {
    Search s(*o, 2, rosenbrock, spread(2, 3));
    s.options.max_iterations = iterations;
    s.options.max_evaluations = evaluations;
    const auto results = s.run();
    for (std::size_t i = 0; i < results.size(); ++i) {
      const auto& r = results[i];
      const Index counted = s.objective.evaluations[i];
      if (counted > evaluations)
        wrong.miss(std::to_string(counted) + " evaluations, at most " + std::to_string(evaluations) + " are allowed");
      if (r.evaluations != counted)
        wrong.miss("a result reports " + std::to_string(r.evaluations) + " evaluations, there were " +
                   std::to_string(counted));
      if (r.iterations > iterations)
        wrong.miss(std::to_string(r.iterations) + " iterations, at most " + std::to_string(iterations) +
                   " are allowed");
      if (r.status != OptimiserStatus::budget_spent && r.status != OptimiserStatus::converged)
        wrong.miss(std::string("a search with a spent budget ended as ") + to_string(r.status));
    }
  }
  return wrong.outcome();
}

Outcome never_leaves_the_box(const Bench& bench) {
  const auto o = bench.make<Optimiser>();
  Vector centre(4);
  centre << 3.0, -3.0, 0.3, -0.1;
  Search s(*o, 4, bowl(centre, ramp(4, 1.0, 10.0)), 4.0 * spread(4, 3), 1.0);  // some starts lie outside the box
  const auto results = s.run();
  Worst outside = s.objective.outside;
  for (const auto& r : results) {
    outside.add(s.box.lower - r.x);
    outside.add(r.x - s.box.upper);
  }
  return outside.outcome();
}

Outcome observer_stops_the_search(const Bench& bench) {
  const auto o = bench.make<Optimiser>();
  Refusals wrong;
  Search s(*o, 2, rosenbrock, spread(2, 3));
  Index seen = 0, calls_then = 0;
  Vector before = Vector::Constant(3, kInfinity);
  const auto caller = std::this_thread::get_id();
  const auto results = s.run([&](Index, const Vector& best) {
    if (std::this_thread::get_id() != caller) wrong.miss("the observer was called on another thread");
    if (best.size() != 3 || best.hasNaN() || (best.size() == 3 && (best.array() > before.array()).any()))
      wrong.miss("the best costs rose, or their number is wrong");
    else
      before = best;
    ++seen;
    calls_then = s.objective.calls;
    return seen < 3;
  });
  if (seen != 3) wrong.miss("the observer was called " + std::to_string(seen) + " times, must be 3");
  if (s.objective.calls != calls_then) wrong.miss("the objective was evaluated after the observer returned false");
  for (std::size_t i = 0; i < results.size(); ++i) {
    if (results[i].status != OptimiserStatus::stopped)
      wrong.miss(std::string("a stopped search ended as ") + to_string(results[i].status));
    if (results[i].cost != before[i]) wrong.miss("a cost that is not the last one observed");
  }
  return wrong.outcome();
}

Outcome an_unwanted_instance_ends_alone(const Bench& bench) {
  const auto o = bench.make<Optimiser>();
  Refusals wrong;
  Search whole(*o, 2, rosenbrock, spread(2, 3)), shortened(*o, 2, rosenbrock, spread(2, 3));
  for (Search* s : {&whole, &shortened}) s->options.max_iterations = 40;
  const auto all = whole.run();
  Index seen = 0;
  shortened.options.wanted = [&](Index instance) {
    if (instance < 0 || instance > 2) wrong.miss("it asks about instance " + std::to_string(instance) + " of 3");
    return instance != 1 || seen < 4;
  };
  const auto results = shortened.run([&](Index, const Vector&) { return ++seen, true; });
  for (const std::size_t i : {0, 2})
    if (differing_results(results[i], all[i]) > 0) wrong.miss("instance " + std::to_string(i) + " changed");
  if (results[1].evaluations > all[1].evaluations) wrong.miss("the unwanted instance evaluated more than before");
  if (results[1].evaluations < all[1].evaluations && results[1].status != OptimiserStatus::stopped)
    wrong.miss(std::string("the unwanted instance ended as ") + to_string(results[1].status));
  const auto& [cost, x] = shortened.objective.best[1];
  if (results[1].cost != cost || results[1].x != x) wrong.miss("its result is not its best point");
  return wrong.outcome();
}

Outcome the_best_point_is_returned(const Bench& bench) {
  const auto o = bench.make<Optimiser>();
  double wrong = 0.0;
  for (const Index iterations : {2, 9, 60}) {
    Search s(*o, 2, rosenbrock, spread(2, 3));
    s.options.max_iterations = iterations;
    const auto results = s.run();
    for (std::size_t i = 0; i < results.size(); ++i) {
      const auto& [cost, x] = s.objective.best[i];
      if (results[i].cost != cost || results[i].x != x) ++wrong;
    }
  }
  return {wrong, ""};
}

Outcome same_seed_same_bits(const Bench& bench) {
  const auto o = bench.make<Optimiser>(), other = bench.make<Optimiser>();
  double wrong = 0.0;
  const auto run = [&](const Optimiser& solver, std::uint64_t seed) {
    Search s(solver, 2, rosenbrock, spread(2, 3));
    s.options.max_iterations = 40;
    s.options.seed = seed;
    return s.run();
  };
  for (const std::uint64_t seed : {1, 2}) {
    const auto a = run(*o, seed), b = run(*o, seed), c = run(*other, seed);
    for (std::size_t i = 0; i < a.size(); ++i) wrong += differing_results(a[i], b[i]) + differing_results(a[i], c[i]);
  }
  return {wrong, ""};
}

Outcome same_bits_on_two_threads(const Bench& bench) {
  const auto o = bench.make<Optimiser>();
  std::vector<OptimiserResult> results[3];
  const auto run = [&](int k) {
    Search s(*o, 2, rosenbrock, spread(2, 3));
    s.options.max_iterations = 40;
    results[k] = s.run();
  };
  run(0);
  on_two_threads([&] { run(1); }, [&] { run(2); });
  double wrong = 0.0;
  for (std::size_t i = 0; i < results[0].size(); ++i)
    wrong += differing_results(results[0][i], results[1][i]) + differing_results(results[0][i], results[2][i]);
  return {wrong, ""};
}

Outcome batches_are_well_formed(const Bench& bench) {
  const auto o = bench.make<Optimiser>();
  Search s(*o, 3, small_bowl(), spread(3, 5));
  try {
    s.run();
  } catch (const Error&) {
    if (s.objective.well_formed) throw;
  }
  Search none(*o, 3, small_bowl(), Matrix(3, 0));
  none.run();  // no instances, no result
  return {s.objective.well_formed && none.objective.calls == 0 ? 0.0 : 1.0, ""};
}

Outcome errors_of_the_objective_pass_through(const Bench& bench) {
  const auto o = bench.make<Optimiser>();
  Refusals refusals;
  for (Index call : {1, 3}) {
    Search s(*o, 2, rosenbrock, spread(2, 2));
    s.objective.throw_at_call = call;
    refusals.wants<Diverged>("an objective that throws at call " + std::to_string(call), [&] { s.run(); });
  }
  return refusals.outcome();
}

Outcome refuses_bad_shapes(const Bench& bench) {
  const auto o = bench.make<Optimiser>();
  Refusals refusals;
  const auto with = [&](const std::string& what, const std::function<void(Search&)>& change) {
    Search s(*o, 3, small_bowl(), spread(3, 2));
    s.options.max_iterations = 5;
    change(s);
    refusals.wants<ShapeError>(what, [&] { s.run(); });
  };
  with("starts with a row too many", [](Search& s) { s.starts = spread(4, 2); });
  with("too short a lower bound", [](Search& s) { s.box.lower = Vector::Constant(2, -1.0); });
  with("too long an upper bound", [](Search& s) { s.box.upper = Vector::Ones(4); });
  with("too short a scale", [](Search& s) { s.scale = Vector::Ones(2); });
  return refusals.outcome();
}

Outcome refuses_nan(const Bench& bench) {
  const auto o = bench.make<Optimiser>();
  Refusals refusals;
  const auto with = [&](const std::string& what, const std::function<void(Search&)>& change) {
    Search s(*o, 3, small_bowl(), spread(3, 2));
    s.options.max_iterations = 5;
    change(s);
    refusals.wants<Error>(what, [&] { s.run(); });
  };
  with("a start that is NaN", [](Search& s) { s.starts(1, 1) = kNaN; });
  with("a bound that is infinite", [](Search& s) { s.box.upper[0] = kInfinity; });
  with("a box upside down", [](Search& s) { s.box.upper[2] = -3.0; });
  with("a scale of 0", [](Search& s) { s.scale[1] = 0.0; });
  return refusals.outcome();
}

}  // namespace
}  // namespace of_optimisers

void probe_optimiser(const Bench& bench) {
  using namespace of_optimisers;
  const auto o = bench.make<Optimiser>();
  Search s(*o, 3, small_bowl(), spread(3, 2));
  s.options.max_iterations = 2;
  s.run();
}

const std::vector<Law>& optimiser_laws() {
  using namespace of_optimisers;
  static const std::vector<Law> laws = {
      {"solves_an_ill_conditioned_quadratic",
       "6 variables, condition 1000, 400 iterations, 20000 evaluations: final over initial cost.", 1e-2,
       solves_an_ill_conditioned_quadratic},
      {"solves_rosenbrock", "Rosenbrock's valley from three sides, same budget: final over initial cost.", 0.05,
       solves_rosenbrock},
      {"finds_a_minimum_on_the_boundary",
       "A bowl whose minimum is on two faces of the box: final over initial excess cost.", 1e-2,
       finds_a_minimum_on_the_boundary},
      {"survives_holes",
       "Costs and gradients beyond a wall, where the minimum lies, are not finite: final over initial cost.", 0.5,
       survives_holes},
      {"a_failed_instance_costs_only_itself",
       "An instance without a finite cost ends as diverged and changes no other (numbers that differ).", 0,
       a_failed_instance_costs_only_itself},
      {"asks_only_for_what_it_needs", "Gradients and residuals are requested only if declared as needed (violations).",
       0, asks_only_for_what_it_needs},
      {"refuses_objectives_that_lack_what_it_needs",
       "An objective that lacks needed gradients or residuals is refused with Unsupported (accepted).", 0,
       refuses_objectives_that_lack_what_it_needs},
      {"instances_do_not_affect_one_another",
       "An instance gives the same bits alone and in a batch (numbers that differ).", 0,
       instances_do_not_affect_one_another},
      {"budget_is_respected",
       "max_iterations and max_evaluations are never exceeded, and the reported counts are right (violations).", 0,
       budget_is_respected},
      {"never_leaves_the_box", "Nothing is evaluated or returned outside the box (units of x).", 0,
       never_leaves_the_box},
      {"observer_stops_the_search",
       "The observer gets falling best costs on the caller's thread, and false ends the search (violations).", 0,
       observer_stops_the_search},
      {"an_unwanted_instance_ends_alone",
       "An instance that is no longer wanted ends with its best point, or goes on, and changes no other (violations).",
       0, an_unwanted_instance_ends_alone},
      {"the_best_point_is_returned", "x and cost are those of the best evaluation (instances that differ).", 0,
       the_best_point_is_returned},
      {"same_seed_same_bits", "Same seed, same bits, also from a second object (numbers that differ).", 0,
       same_seed_same_bits},
      {"same_bits_on_two_threads", "Two searches in parallel give the bits of one alone (numbers that differ).", 0,
       same_bits_on_two_threads},
      {"batches_are_well_formed", "Instances ascend, points are finite, and a batch is never empty (violations).", 0,
       batches_are_well_formed},
      {"errors_of_the_objective_pass_through", "Exceptions of the objective reach the caller (swallowed).", 0,
       errors_of_the_objective_pass_through},
      {"refuses_bad_shapes", "Wrong sizes are refused with ShapeError (accepted).", 0, refuses_bad_shapes},
      {"refuses_nan", "Starts, boxes and scales that are not finite or out of range are refused (accepted).", 0,
       refuses_nan},
  };
  return laws;
}

}  // namespace weft::conformance
