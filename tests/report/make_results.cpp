// Writes made-up results, so that tests of pages and exports need no simulator, no model and no time.
//   make_results session FOLDER [SEGMENTS]   session.h5, summary.json as `weft run` writes them; the fold is a formula
//   make_results evaluation FOLDER           planning.json, cases.h5, estimation.json, prediction.json
//   make_results physics FOLDER              physics.json
//   make_results ablation FOLDER             ablation.json
// and report.html from them, where the page's template is found. docs/report.md describes the files.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <numbers>
#include <numeric>

#include "experiments/statistics.hpp"
#include "loader/program_host.hpp"
#include "loader/registry.hpp"
#include "report/cases_file.hpp"
#include "report/page.hpp"
#include "report/times.hpp"
#include "session/session.hpp"
#include "session/session_file.hpp"
#include "simulation/task_config.hpp"
#include "weft/hdf5_file.hpp"
#include "weft/random.hpp"

namespace {

using namespace weft;
namespace fs = std::filesystem;
using json = nlohmann::ordered_json;

constexpr Index kSettleFrames = 60;

void write_json(const fs::path& file, const json& value) { std::ofstream(file) << value.dump(1) << '\n'; }

/// The shape at a control state: the part left of the fold line is turned about it, a little bent and waved.
Positions folded(const Task& task, const Vector& state, double wave) {
  constexpr double kDegree = std::numbers::pi / 180.0;
  const double angle = std::clamp(state(0), 0.0, 180.0) * kDegree, turn = state(2) * kDegree;
  const Vec2 direction(std::cos(turn), std::sin(turn));
  const Vec2 across(-direction.y(), direction.x());
  const Vec2 hinge(state(3), state(4));
  Positions shape = task.garment->positions;
  for (Index v = 0; v < shape.rows(); ++v) {
    const Vec2 offset = Vec2(shape(v, 0), shape(v, 1)) - hinge;
    const double u = -offset.dot(direction);
    double height = 0.001;
    if (u > 0) {
      // Rolled up near the hinge, straight further out.
      const double roll = 0.04, arc = std::min(u / roll, 1.0) * angle;
      const double radius = angle > 1e-6 ? roll / angle : 1e9;
      const double x =
          u < roll || angle <= 1e-6 ? radius * std::sin(arc) : radius * std::sin(angle) + (u - roll) * std::cos(angle);
      double z = u < roll || angle <= 1e-6 ? radius * (1 - std::cos(arc))
                                           : radius * (1 - std::cos(angle)) + (u - roll) * std::sin(angle);
      z *= 1.0 - 0.9 * std::pow(angle / std::numbers::pi, 8);
      const Vec2 moved = hinge - direction * (angle <= 1e-6 ? u : x) + across * offset.dot(across);
      shape(v, 0) = moved.x();
      shape(v, 1) = moved.y();
      height += angle <= 1e-6 ? 0.0 : z;
      height += 0.012 * std::sin(angle) * (1 + std::sin(18 * offset.dot(across) + wave)) * std::min(u / 0.2, 1.0);
    }
    shape(v, 2) = height;
  }
  return shape;
}

void make_session(const fs::path& folder, Index segments, const Task& task, const ConfigNode& resolved) {
  const auto& trajectory = *task.trajectory;
  const auto vertices = task.garment->vertex_count();
  RandomStream random(1, 1);

  SessionResult result;
  result.true_material = MaterialProperties(0.62, 0.35, 0.71, 0.22);
  const auto goal_states = [&](double pace, double turn, double shift) {
    Controls controls = Controls::Zero(segments, static_cast<Index>(trajectory.controls().size()));
    for (Index j = 0; j < segments; ++j) {
      const double s = static_cast<double>(j) / static_cast<double>(segments);
      controls.row(j) << pace, 0.0, turn * std::sin(3 * s), shift * std::cos(2 * s), -shift * s;
    }
    return controls;
  };
  const double pace = 180.0 / (12.0 * static_cast<double>(segments)) + 1e-9;
  const Controls goal_controls = goal_states(pace, 0.12, 0.00025);
  const Controls executed = goal_states(pace, 0.115, 0.00023);
  const Vector start = trajectory.initial_state(task.manipulation);
  const Controls goal_path = trajectory.segment_states(task.manipulation, start, goal_controls);
  result.goal_controls = goal_controls;
  result.start = folded(task, start, 0);
  result.goal = folded(task, goal_path.row(segments - 1).transpose(), 0);
  Vector straight = start;
  straight(0) = 180;
  result.default_shape = folded(task, straight, 0.4);
  result.default_error_mm = mean_distance_mm(result.default_shape, result.goal);

  const auto record = [&](const Positions& shape) {
    std::vector<float> frame(shape.size());
    for (Index i = 0; i < shape.size(); ++i) frame[i] = static_cast<float>(shape.data()[i]);
    result.frames.push_back(std::move(frame));
  };
  record(result.start);
  Vector state = start;
  for (Index r = 0; r < segments; ++r) {
    SessionRound round;
    round.state = state;
    for (Index p = 0; p < 4; ++p) {
      const double left = std::exp(-0.22 * static_cast<double>(r) * (0.6 + 0.3 * static_cast<double>(p)));
      round.knowledge.width(p) = 0.12 + 0.88 * left;
      round.knowledge.centre(p) =
          (*result.true_material)(p) + (0.5 - (*result.true_material)(p)) * left + 0.03 * (random.uniform() - 0.5);
    }
    auto& plan = round.plan;
    plan.controls = executed.bottomRows(segments - r);
    for (Index j = 1; j < plan.controls.rows(); ++j) plan.controls(j, 2) += 0.03 * (random.uniform() - 0.5) * 5;
    plan.horizon = r == 0 ? 25 : plan.controls.rows() + 5;
    plan.releases = true;
    const Controls states = trajectory.segment_states(task.manipulation, state, plan.controls);
    for (Index j = 0; j < plan.controls.rows(); ++j) {
      ShapeDistribution shape;
      shape.mean = folded(task, states.row(j).transpose(), 0.15 * static_cast<double>(j));
      const double spread = 0.001 + 0.0012 * static_cast<double>(j) * round.knowledge.width.mean();
      shape.sigma = Positions::Constant(vertices, 3, spread);
      for (Index v = 0; v < vertices; ++v) {
        const double lifted = std::min(1.0, 8 * shape.mean(v, 2));
        shape.sigma.row(v) *= 0.3 + 1.4 * lifted;
        for (Index a = 0; a < 3; ++a) shape.mean(v, a) += 0.4 * shape.sigma(v, a) * (2 * random.uniform() - 1);
      }
      plan.shapes.push_back(std::move(shape));
    }
    plan.predicted_error_mm = mean_distance_mm(plan.shapes.back().mean, result.goal);
    const std::size_t instances = 16, iterations = r == 0 ? 80 : 30;
    std::vector<double> rate(instances), floor(instances);
    for (std::size_t i = 0; i < instances; ++i) {
      rate[i] = 0.04 + 0.1 * random.uniform();
      floor[i] = 12 + 90 * random.uniform() * random.uniform();
    }
    for (std::size_t k = 0; k < iterations; ++k) {
      plan.curves.emplace_back();
      for (std::size_t i = 0; i < instances; ++i) {
        plan.curves.back().push_back(floor[i] + (r == 0 ? 1800 : 160) * std::exp(-rate[i] * static_cast<double>(k)));
      }
    }
    plan.losses = plan.curves.back();
    plan.instance = std::min_element(plan.losses.begin(), plan.losses.end()) - plan.losses.begin();
    plan.loss = plan.losses[plan.instance];
    plan.ended = {OptimiserStatus::budget_spent,
                  "max_iterations",
                  {{OptimiserStatus::converged, 3}, {OptimiserStatus::budget_spent, 13}}};
    plan.iterations = static_cast<Index>(iterations);
    plan.seconds = r == 0 ? 2.31 : 0.45 + 0.3 * random.uniform();

    const Vector control = executed.row(r).transpose();
    Vector moving = state;
    for (Index f = 0; f < kFramesPerSegment; ++f) {
      moving = trajectory.advance(task.manipulation, moving, control);
      record(folded(task, moving, 0.05 * static_cast<double>(r * 12 + f)));
    }
    state = moving;
    if (r + 1 == segments) {
      const Positions held = folded(task, state, 0.05 * static_cast<double>(segments * 12));
      for (Index f = 1; f <= kSettleFrames; ++f) {
        Positions shape = folded(task, state, 0);
        const double left = std::exp(-static_cast<double>(f) / 12.0);
        shape += left * (held - shape);
        shape.col(2).array() += 0.02 * left * (shape.col(0).array() * 9.0).sin().abs();
        record(shape);
      }
    }
    const auto& last = result.frames.back();
    round.observed.resize(vertices, 3);
    for (Index i = 0; i < round.observed.size(); ++i) round.observed.data()[i] = last[i];
    result.rounds.push_back(std::move(round));
  }
  for (std::size_t r = 0; r < result.rounds.size(); ++r) {
    Estimate estimate;
    estimate.knowledge = result.rounds[std::min(r + 1, result.rounds.size() - 1)].knowledge;
    estimate.seconds = 0.3 + 0.1 * random.uniform();
    result.estimates.push_back(std::move(estimate));
  }
  result.released = true;
  result.settle.settled = true;
  result.settle.frames = kSettleFrames;
  result.final_shape = result.rounds.back().observed;
  result.error_mm = mean_distance_mm(result.final_shape, result.goal);
  result.errors = shape_errors(result.final_shape, result.goal, task);
  result.world = WorldRecord{0.2, "cloth", {{"density", 1.07}}};
  result.simulate_seconds = 7.9;
  result.max_grasp_strain = 0.021;
  const std::string provenance =
      R"({"weft": "0.1.0", "commit": "made-up", "compiler": "none", "seed": 1, "plugins": [{"kind": "trajectory", "name": "arc", "version": "1.0.0"}]})";
  write_session(folder / "session.h5", result, task, resolved, provenance);
  std::ofstream(folder / "summary.json") << session_summary_json(result);
  std::ofstream(folder / "times.json") << times_json(2, {{"summary.json", session_times_json(result)}});
  std::printf("%td segments, %zu frames, %td vertices, error %.2f mm\n", segments, result.frames.size(), vertices,
              result.error_mm);
}

json spread_json(const std::vector<double>& values) {
  const Spread s = spread_of(values);
  return {{"mean", s.mean}, {"sd", s.sd}, {"median", s.median}};
}

void make_evaluation(const fs::path& folder, const Task& task) {
  RandomStream random(2, 2);
  const auto& trajectory = *task.trajectory;
  const Index vertices = task.garment->vertex_count();
  const std::size_t goals = 8;
  std::vector<Positions> goal_shapes, final_shapes;
  std::vector<std::int64_t> goal_of;
  for (std::size_t g = 0; g < goals; ++g) {
    Vector state = trajectory.initial_state(task.manipulation);
    state(0) = 180;
    state(2) += 20 * (random.uniform() - 0.5);
    state(3) += 0.08 * (random.uniform() - 0.5);
    goal_shapes.push_back(folded(task, state, 0));
  }
  json planning = {{"cases", json::array()}, {"by_width", json::array()}};
  for (int i = 1; i <= 10; ++i) {
    const double width = i / 10.0;
    std::vector<double> errors;
    for (std::size_t g = 0; g < goals; ++g) {
      const bool failed = i == 7 && g == 3;
      const bool outlier = g == 5 && i % 3 == 0;
      const Vec3 shift = (outlier ? 0.04 : 0.005 + 0.004 * width) * Vec3(random.uniform(), random.uniform() - 0.5, 0.1);
      Positions shape = goal_shapes[g];
      for (Index v = 0; v < vertices; ++v) shape.row(v) += (1.0 + shape(v, 1)) * shift.transpose();
      const double error = mean_distance_mm(shape, goal_shapes[g]);
      final_shapes.push_back(shape);
      goal_of.push_back(static_cast<std::int64_t>(g));
      json one = {{"width", width}, {"goal", g}, {"error_mm", failed ? json() : json(error)}, {"plan_seconds", 0.8}};
      if (failed) one["failed"] = "made up: the simulation diverged at frame 12";
      planning["cases"].push_back(one);
      if (!failed) errors.push_back(error);
    }
    const double q1 = quantile_of(errors, 0.25), q3 = quantile_of(errors, 0.75);
    const auto outliers = std::count_if(errors.begin(), errors.end(),
                                        [&](double e) { return e < q1 - 1.5 * (q3 - q1) || e > q3 + 1.5 * (q3 - q1); });
    planning["by_width"].push_back({{"width", width},
                                    {"n", errors.size()},
                                    {"mean_mm", mean_of(errors)},
                                    {"median_mm", quantile_of(errors, 0.5)},
                                    {"sd_mm", spread_of(errors).sd},
                                    {"q1_mm", q1},
                                    {"q3_mm", q3},
                                    {"outliers", outliers},
                                    {"silhouette_iou", 0.95 - 0.02 * width},
                                    {"success_10mm", 0.9},
                                    {"success_20mm", 1.0},
                                    {"success_30mm", nullptr}});
  }
  write_json(folder / "planning.json", planning);
  json estimation = {{"properties", json::object()}, {"cases", json::array()}};
  std::vector<std::vector<double>> errors(4), widths(4);
  std::vector<Positions> replayed;
  std::vector<std::int64_t> first{0};
  for (int i = 0; i < 50; ++i) {
    json one = {{"true_material", json::array()}, {"knowledge", json::array()}};
    std::vector<double> truth, drift;
    for (std::size_t p = 0; p < 4; ++p) {
      truth.push_back(random.uniform());
      drift.push_back(0.16 * (random.uniform() - 0.5));
    }
    one["true_material"] = truth;
    Vector state = trajectory.initial_state(task.manipulation);
    const double turn = 20 * (random.uniform() - 0.5);
    for (int j = 0; j <= 12; ++j) {
      state(0) = 15.0 * j;
      state(2) = turn * j / 12.0;
      replayed.push_back(folded(task, state, i));
      std::vector<double> centre, width;
      for (std::size_t p = 0; p < 4; ++p) {
        const double left = std::exp(-0.35 * j);
        centre.push_back(truth[p] + drift[p] + (0.5 - truth[p] - drift[p]) * left);
        width.push_back(0.18 + 0.82 * left);
        if (j == 12) errors[p].push_back(std::abs(centre[p] - truth[p])), widths[p].push_back(width[p]);
      }
      one["knowledge"].push_back({{"centre", centre}, {"width", width}});
    }
    estimation["cases"].push_back(one);
    first.push_back(static_cast<std::int64_t>(replayed.size()));
  }
  for (std::size_t p = 0; p < 4; ++p) {
    json coverage;
    for (const auto& [name, share] : {std::pair{"0.5", 0.5}, std::pair{"0.8", 0.8}, std::pair{"1", 1.0}}) {
      double inside = 0;
      for (std::size_t i = 0; i < errors[p].size(); ++i) inside += errors[p][i] <= share * widths[p][i] / 2;
      coverage[name] = inside / static_cast<double>(errors[p].size());
    }
    estimation["properties"][kPropertyNames[p]] = {{"abs_error", spread_json(errors[p])},
                                                   {"width", spread_json(widths[p])},
                                                   {"failure_rate", 0.02 * static_cast<double>(p)},
                                                   {"coverage", coverage},
                                                   {"interval_score", 0.3}};
  }
  estimation["cases"].push_back({{"seed", 51}, {"failed", "made up: none of 50 random trajectories was released"}});
  first.push_back(first.back());
  for (const char* source : {"test", "train"}) {
    for (const char* method : {"posterior", "plain"})
      estimation["columns"][source][method] = {{"n", 50}, {"properties", estimation["properties"]}};
  }
  write_json(folder / "estimation.json", estimation);

  json prediction = {{"by_step", json::array()}};
  const auto figures = [](double mm) {
    return json{
        {"n", 40},    {"mean_mm", mm},     {"median_mm", 0.8 * mm}, {"nll", 1.1 + 0.05 * mm}, {"coverage_1sigma", 0.66},
        {"nse", 1.1}, {"sigma_mm", mm / 2}};
  };
  for (int step = 1; step <= 12; ++step) {
    json row = figures(1.5 + 0.5 * step);
    row["steps"] = step;
    row["coverage_1sigma"] = 0.72 - 0.01 * step;
    prediction["by_step"].push_back(row);
  }
  prediction["settled"] = {{"from_start", figures(6.1)}, {"from_random", figures(4.4)}, {"no_knowledge", figures(8.2)}};
  prediction["baselines"] = {{"no_change", {{"n", 40}, {"mean_mm", 210.0}, {"median_mm", 200.0}}},
                             {"linear", {{"n", 40}, {"mean_mm", 31.0}, {"median_mm", 27.0}}}};
  // The goals serve as recorded shapes, the ends of the planned folds as predicted shapes.
  for (int i = 0; i < 40; ++i)
    prediction["cases"].push_back({{"example", 100 + i},
                                   {"segments", 9 + i % 5},
                                   {"error_mm", mean_distance_mm(final_shapes[i], goal_shapes[goal_of[i]])},
                                   {"sigma_mm", 3.0 + 4.0 * random.uniform()}});
  write_json(folder / "prediction.json", prediction);

  auto file = create_cases_file(folder / "cases.h5", *task.garment);
  const auto write = [&](const char* experiment, std::size_t count) {
    const std::string group = std::string("/") + experiment;
    write_shapes(file, group + "/goals", goal_shapes);
    write_shapes(file, group + "/finals",
                 {final_shapes.begin(), final_shapes.begin() + static_cast<std::ptrdiff_t>(count)});
    file.write(group + "/goal_of", {static_cast<Index>(count)}, goal_of.data());
  };
  write("planning", final_shapes.size());
  write("prediction", 30);
  write_shapes(file, "/estimation/shapes", replayed);
  file.write("/estimation/first", {static_cast<Index>(first.size())}, first.data());
  file.commit();
}

void make_physics(const fs::path& folder) {
  RandomStream random(4, 4);
  json rows = json::array();
  const auto add = [&](const std::string& test, const std::string& name, double reference, double error, double bound) {
    rows.push_back({{"test", test},
                    {"case", name},
                    {"variant", "default"},
                    {"quantity", "made up"},
                    {"reference", reference},
                    {"measured", reference * (1 + error)},
                    {"error", error},
                    {"bound", bound},
                    {"passed", error <= bound},
                    {"note", ""}});
  };
  for (int i = 0; i < 12; ++i) add("elastica", std::to_string(i) + " mm", 0.3, 0.03 * random.uniform(), 0.03);
  add("catenary", "1.25", 0.25, 0.031, 0.02);
  add("rest", "on the ground", 0.0, 0.0, 0.0);
  rows.push_back({{"test", "incline"},
                  {"case", "mu=1"},
                  {"variant", "finer"},
                  {"quantity", "exception"},
                  {"reference", 0.0},
                  {"measured", 0.0},
                  {"error", nullptr},
                  {"bound", 0.0},
                  {"passed", false},
                  {"note", "made up: the simulation diverged at frame 12"}});
  for (int group = 0; group < 2; ++group) {
    add("folds", group == 0 ? "seeds 1 to 10" : "seeds 11 to 20", 0.0, group == 0 ? 0.004 : 0.006, 0.005);
    for (int k = 1; k <= 10; ++k)
      rows.back()["by_seed"].push_back({10 * group + k, group == 1 && k == 7 ? 0.006 : 0.004 * random.uniform()});
  }
  const auto failed = std::count_if(rows.begin(), rows.end(), [](const json& row) { return !row["passed"]; });
  write_json(folder / "physics.json", {{"comparisons", rows.size()}, {"failed", failed}, {"rows", rows}});
}

void make_ablation(const fs::path& folder) {
  RandomStream random(3, 3);
  json arms = json::array();
  const auto statistics = [](double value, double half) {
    return json{{"n", 19},
                {"mean", value},
                {"median", 0.9 * value},
                {"sd", 2 * half},
                {"mean_95", {value - half, value + half}},
                {"median_95", {0.9 * value - half, 0.9 * value + half}}};
  };
  for (const std::string instances : {"1", "4", "16"}) {
    double error0 = 0.0, seconds0 = 0.0;
    for (const std::string optimiser : {"rprop", "ceres", "nlopt", "mppi"}) {
      const double count = std::stod(instances);
      const double error = 12.0 / std::sqrt(count) + 4 + 3 * random.uniform();
      const double seconds = 0.12 * count + 0.1 * random.uniform();
      json metrics = {{"error_mm", statistics(error, 0.8)},
                      {"success_10mm", statistics(0.7, 0.1)},
                      {"evaluations", statistics(1200 * count, 30)},
                      {"plan_seconds", statistics(seconds, 0.05)},
                      {"simulate_seconds", statistics(3, 0.1)}};
      const bool baseline = optimiser == "rprop";
      if (baseline) {
        error0 = error;
        seconds0 = seconds;
      } else {
        metrics["error_mm"]["difference"] = statistics(error - error0, 0.6);
        metrics["plan_seconds"]["difference"] = statistics(seconds - seconds0, 0.04);
      }
      json failed = json::array();
      // One cell here and there fails, and all of one arm.
      const bool none = optimiser == "mppi" && instances == "1";
      if (none) metrics = json::object();
      for (int seed = 1; seed <= 20; ++seed) {
        if (none || (optimiser == "mppi" && seed == 4))
          failed.push_back({{"seed", seed}, {"failure", "made up: the simulation diverged"}});
      }
      arms.push_back({{"name", optimiser + ", " + instances},
                      {"levels", {{"optimiser", optimiser}, {"planning.instances", instances}}},
                      {"done", 20 - failed.size()},
                      {"failed", failed},
                      {"baseline", baseline ? json() : json("rprop, " + instances)},
                      {"unpaired", 0},
                      {"metrics", metrics}});
    }
  }
  json seeds = json::array();
  for (int seed = 1; seed <= 20; ++seed) seeds.push_back(seed);
  write_json(folder / "ablation.json", {{"description", "made-up comparison of optimisers"},
                                        {"factors", {"optimiser", "planning.instances"}},
                                        {"seeds", seeds},
                                        {"complete", true},
                                        {"arms", arms}});
}

}  // namespace

int main(int argc, char** argv) {
  const std::string kind = argc > 2 ? argv[1] : "";
  if (kind != "session" && kind != "evaluation" && kind != "physics" && kind != "ablation") return 2;
  const fs::path folder = argv[2];
  fs::create_directories(folder);
  const auto registry = std::make_shared<PluginRegistry>();
  const auto host = make_host(registry, {});
  const ConfigNode config = ConfigNode::load(WEFT_SOURCE_DIR "/configs/tasks/tshirt_fold_network.yaml");
  SessionParams params;
  const ConfigNode resolved = read_params(config, params);
  const Task task = make_task(params.task, config, *host);
  if (kind == "session") make_session(folder, argc > 3 ? std::atoi(argv[3]) : 20, task, resolved);
  if (kind == "evaluation") make_evaluation(folder, task);
  if (kind == "physics") make_physics(folder);
  if (kind == "ablation") make_ablation(folder);
  const std::string reason = write_report(folder);
  if (!reason.empty()) std::printf("no report.html: %s\n", reason.c_str());
  return 0;
}
