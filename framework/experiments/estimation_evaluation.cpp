#include "experiments/estimation_evaluation.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <nlohmann/json.hpp>
#include <numeric>

#include "learning/dataset_files.hpp"
#include "report/cases_file.hpp"
#include "session/estimator.hpp"
#include "simulation/task_config.hpp"
#include "weft/config.hpp"
#include "weft/hdf5_file.hpp"

namespace weft {
namespace {

using nlohmann::ordered_json;
namespace fs = std::filesystem;

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
constexpr int kCalibrationSweeps = 600;  // quantiles to a few per cent: less than so few cases can tell
constexpr std::uint64_t kCaseStream = 0x6576616c;

double metric(const AblationRow& row, const std::string& name) {
  for (const auto& [key, value] : row.outcome.metrics) {
    if (key == name) return value;
  }
  return kNaN;
}

double quantile(std::vector<double> values, double at) {
  if (values.empty()) return kNaN;
  std::sort(values.begin(), values.end());
  const double place = at * static_cast<double>(values.size() - 1);
  const auto below = static_cast<std::size_t>(place);
  const std::size_t above = std::min(below + 1, values.size() - 1);
  return values[below] + (place - static_cast<double>(below)) * (values[above] - values[below]);
}

struct Spread {
  double mean = kNaN, sd = kNaN, median = kNaN;
};
Spread spread_of(const std::vector<double>& values) {
  if (values.empty()) return {};
  const auto n = static_cast<double>(values.size());
  const double mean = std::accumulate(values.begin(), values.end(), 0.0) / n;
  double square = 0.0;
  for (const double v : values) square += (v - mean) * (v - mean);
  return {mean, values.size() > 1 ? std::sqrt(square / (n - 1.0)) : kNaN, quantile(values, 0.5)};
}

ordered_json number(double value) { return std::isfinite(value) ? ordered_json(value) : ordered_json(nullptr); }
ordered_json json_of(const Spread& s) {
  return {{"mean", number(s.mean)}, {"sd", number(s.sd)}, {"median", number(s.median)}};
}

std::string text_of(double value) {
  char text[40];
  std::snprintf(text, sizeof text, "%.9g", value);
  return text;
}

ConfigNode matrix_node(const Controls& controls) {
  std::vector<ConfigNode> rows;
  for (Index j = 0; j < controls.rows(); ++j) {
    std::vector<ConfigNode> row;
    for (Index c = 0; c < controls.cols(); ++c) row.push_back(ConfigNode::number(controls(j, c)));
    rows.push_back(ConfigNode::sequence(row));
  }
  return ConfigNode::sequence(rows);
}

std::uint64_t seed_of(const ConfigNode& session) { return static_cast<std::uint64_t>(session.at("seed").as_int()); }

/// Where a cell keeps its shapes. @param level of the cell's arm.
fs::path shape_file(const fs::path& folder, std::uint64_t seed, const std::string& level) {
  return folder / "shapes" / ("seed" + std::to_string(seed) + "-" + level + ".h5");
}
std::string width_level(double width) { return "w" + text_of(width); }

/// What the cells' config says about where the cases come from, so that rows of other cases are refused.
std::string describe(const EvaluationCases& cases, const std::string& what) {
  std::string text = what + ", cases: " + cases.source;
  if (cases.dataset) text += " of dataset " + cases.dataset->header.identity;
  return text;
}

const std::string kPosterior = "posterior_";
std::string step_key(const char* what, std::size_t property, Index step) {
  char text[60];
  std::snprintf(text, sizeof text, "%s_%s_%02d", what, kPropertyNames[property], static_cast<int>(step));
  return text;
}

/// The rows of one arm that ran.
std::vector<const AblationRow*> done_rows(const EvaluationColumn& column, std::size_t arm) {
  std::vector<const AblationRow*> rows;
  for (const auto& row : column.rows) {
    if (row.arm == arm && row.failure.empty()) rows.push_back(&row);
  }
  return rows;
}

MaterialProperties truth_of(const AblationRow& row) {
  MaterialProperties q;
  for (std::size_t p = 0; p < 4; ++p) q(static_cast<Index>(p)) = metric(row, std::string("q_") + kPropertyNames[p]);
  return q;
}
MaterialKnowledge knowledge_of(const AblationRow& row, Index step) {
  MaterialKnowledge k;
  for (std::size_t p = 0; p < 4; ++p) {
    k.centre(static_cast<Index>(p)) = metric(row, step_key("c", p, step));
    k.width(static_cast<Index>(p)) = metric(row, step_key("w", p, step));
  }
  return k;
}
Index steps_of(const AblationRow& row) { return static_cast<Index>(metric(row, "segments")); }

MaterialPosterior posterior_of(const AblationRow& row) {
  MaterialPosterior posterior;
  Index at = 0;
  const auto next = [&] { return metric(row, kPosterior + std::to_string(at++)); };
  for (Index p = 0; p < 4; ++p) posterior.mode(p) = next();
  for (Index p = 0; p < 4; ++p) posterior.gradient(p) = next();
  for (Index p = 0; p < 16; ++p) posterior.precision.data()[p] = next();
  return posterior;
}

ordered_json planning_column(const EvaluationColumn& column) {
  ordered_json json{{"goals", column.cases.source}};
  json["complete"] = column.rows.size() == column.plan.arms.size() * column.plan.seeds.size();
  json["cases"] = ordered_json::array();
  json["by_width"] = ordered_json::array();
  for (std::size_t a = 0; a < column.plan.arms.size(); ++a) {
    const double width = column.plan.arms[a].config.at("drawn_width").as_double();
    std::vector<double> errors;
    for (const auto& row : column.rows) {
      if (row.arm != a) continue;
      const auto goal =
          std::find(column.plan.seeds.begin(), column.plan.seeds.end(), row.seed) - column.plan.seeds.begin();
      ordered_json one{{"width", width}, {"goal", goal}, {"seed", row.seed}};
      one["error_mm"] = number(metric(row, "error_mm"));
      if (!row.failure.empty()) {
        one["error_mm"] = nullptr;
        one["failed"] = row.failure;
      } else {
        errors.push_back(metric(row, "error_mm"));
        for (const char* key : {"default_error_mm", "plan_seconds", "first_plan_seconds", "segments", "released"})
          one[key] = number(metric(row, key));
      }
      json["cases"].push_back(one);
    }
    const Spread s = spread_of(errors);
    const double q1 = quantile(errors, 0.25), q3 = quantile(errors, 0.75), reach = 1.5 * (q3 - q1);
    const auto outliers =
        std::count_if(errors.begin(), errors.end(), [&](double e) { return e < q1 - reach || e > q3 + reach; });
    json["by_width"].push_back({{"width", width},
                                {"n", errors.size()},
                                {"mean_mm", number(s.mean)},
                                {"median_mm", number(s.median)},
                                {"sd_mm", number(s.sd)},
                                {"q1_mm", number(q1)},
                                {"q3_mm", number(q3)},
                                {"outliers", outliers}});
  }
  return json;
}

/// One method's figures: Table 1 and what it leaves out.
ordered_json estimation_figures(const EvaluationColumn& column, std::size_t arm) {
  const auto rows = done_rows(column, arm);
  std::vector<MaterialProperties> truth;
  std::vector<MaterialKnowledge> last;
  std::vector<MaterialPosterior> posteriors;
  std::vector<double> seconds;
  for (const auto* row : rows) {
    truth.push_back(truth_of(*row));
    last.push_back(knowledge_of(*row, steps_of(*row)));
    seconds.push_back(metric(*row, "slowest_estimate_seconds"));
    if (std::isfinite(metric(*row, kPosterior + "0"))) posteriors.push_back(posterior_of(*row));
  }
  ordered_json json{{"method", column.plan.arms[arm].levels.front()}, {"n", rows.size()}};
  json["properties"] = ordered_json::object();
  double narrow = 0.0;
  for (std::size_t p = 0; p < 4; ++p) {
    const auto i = static_cast<Index>(p);
    std::vector<double> errors, widths;
    double failures = 0.0;
    for (std::size_t k = 0; k < rows.size(); ++k) {
      const double error = std::abs(last[k].centre(i) - truth[k](i));
      errors.push_back(error);
      widths.push_back(last[k].width(i));
      narrow += last[k].width(i) < 0.02;
      const bool outside = truth[k](i) < last[k].lower()(i) || truth[k](i) > last[k].upper()(i);
      failures += error > 0.1 && outside;
    }
    const IntervalFigures f = interval_figures(last, truth, i);
    const auto n = static_cast<double>(rows.size());
    json["properties"][kPropertyNames[p]] = {
        {"abs_error", json_of(spread_of(errors))},
        {"width", json_of(spread_of(widths))},
        {"failure_rate", number(failures / n)},
        {"coverage", {{"0.5", number(f.coverage50)}, {"0.8", number(f.coverage80)}, {"1", number(f.coverage100)}}},
        {"interval_score", number(f.score)}};
  }
  json["narrow_share"] = number(narrow / (4.0 * static_cast<double>(rows.size())));  // w < 0.02
  json["estimate_seconds"] = {{"median", number(quantile(seconds, 0.5))}, {"max", number(quantile(seconds, 1.0))}};
  if (posteriors.size() == rows.size() && !rows.empty()) {
    const PropertyVector scale = calibrate_deviations(posteriors, truth);
    std::vector<MaterialKnowledge> scaled;
    for (const auto& posterior : posteriors) scaled.push_back(interval_of(posterior.widened(scale)));
    ordered_json coverage = ordered_json::object();
    for (std::size_t p = 0; p < 4; ++p) {
      const IntervalFigures f = interval_figures(scaled, truth, static_cast<Index>(p));
      coverage[kPropertyNames[p]] = {{"0.5", f.coverage50}, {"0.8", f.coverage80}, {"interval_score", f.score}};
    }
    json["calibration"] = {{"deviation_scale", std::vector<double>(scale.data(), scale.data() + 4)},
                           {"coverage_here", coverage}};
  }
  return json;
}

ordered_json estimation_cases(const EvaluationColumn& column, std::size_t arm) {
  auto cases = ordered_json::array();
  const auto list = [](const PropertyVector& v) { return std::vector<double>(v.data(), v.data() + 4); };
  for (const auto& row : column.rows) {
    if (row.arm != arm) continue;
    ordered_json one{{"seed", row.seed}};
    if (!row.failure.empty()) {
      one["failed"] = row.failure;
    } else {
      one["true_material"] = list(truth_of(row));
      one["knowledge"] = ordered_json::array();
      for (Index j = 0; j <= steps_of(row); ++j) {
        const MaterialKnowledge k = j == 0 ? MaterialKnowledge::none() : knowledge_of(row, j);
        one["knowledge"].push_back({{"centre", list(k.centre)}, {"width", list(k.width)}});
      }
      one["slowest_estimate_seconds"] = number(metric(row, "slowest_estimate_seconds"));
    }
    cases.push_back(one);
  }
  return cases;
}

}  // namespace

const Example* EvaluationCases::example(std::uint64_t seed) const {
  if (!dataset) return nullptr;
  return &dataset->examples.at(examples.at(seed));
}

EvaluationCases choose_cases(const std::string& source, std::int64_t count, std::uint64_t seed,
                             std::shared_ptr<const Dataset> dataset) {
  EvaluationCases cases;
  cases.source = source;
  for (std::int64_t i = 0; i < count; ++i) {
    // A session's seed fits an int64 below 9e18.
    cases.seeds.push_back(RandomStream(seed, kCaseStream, static_cast<std::uint64_t>(i)).bits64() >> 2);
  }
  if (source == "fresh") return cases;
  const Split split = split_named(source);
  if (!dataset) throw ConfigError("cases from the " + source + " split need a dataset: --data FOLDER");
  std::vector<std::size_t> released;
  for (const auto i : dataset->select(split)) {
    if (dataset->examples[i].released) released.push_back(i);
  }
  if (static_cast<std::int64_t>(released.size()) < count) {
    throw ConfigError("the " + source + " split holds " + std::to_string(released.size()) +
                      " released examples, fewer than the " + std::to_string(count) + " cases asked for");
  }
  RandomStream random(seed, kCaseStream + 1);
  for (std::size_t i = 0; i < cases.seeds.size(); ++i) {
    std::swap(released[i], released[i + static_cast<std::size_t>(random.below(released.size() - i))]);
    cases.examples[cases.seeds[i]] = released[i];
  }
  cases.dataset = std::move(dataset);
  return cases;
}

AblationPlan planning_evaluation(const ConfigNode& session, const std::vector<double>& widths,
                                 const EvaluationCases& cases) {
  AblationPlan plan;
  plan.description = describe(cases, "planning against the width of the knowledge");
  plan.factors = {"drawn_width"};
  plan.seeds = cases.seeds;
  for (const double width : widths) {
    AblationArm arm;
    arm.name = "w = " + text_of(width);
    arm.levels = {text_of(width)};
    arm.config = session.with("description", ConfigNode::quoted(plan.description))
                     .with("knowledge", ConfigNode::quoted("drawn"))
                     .with("drawn_width", ConfigNode::number(width));
    plan.arms.push_back(std::move(arm));
  }
  return plan;
}

AblationRunner planning_runner(const EvaluationCases& cases, const fs::path& folder) {
  return [cases, folder](const ConfigNode& cell, Host& host) {
    const std::uint64_t seed = seed_of(cell);
    ConfigNode config = cell;
    if (const Example* example = cases.example(seed)) {
      std::vector<ConfigNode> q;
      for (Index p = 0; p < 4; ++p) q.push_back(ConfigNode::number(example->q(p)));
      config = config.with("true_material", ConfigNode::sequence(q));
      config = config.with("goal", ConfigNode::mapping({{"controls", matrix_node(example->controls)}}));
    }
    SessionParams params;
    read_params(config, params);
    const SessionResult result = run_session(params, config, host);
    fs::create_directories(folder / "shapes");
    auto file = Hdf5File::create(shape_file(folder, seed, width_level(params.drawn_width)));
    file.write("/goal", result.goal);
    file.write("/final", result.final_shape);
    file.commit();
    return session_outcome(result);
  };
}

void write_planning_shapes(const EvaluationColumn& column, const Garment& garment, const fs::path& folder,
                           const fs::path& path) {
  std::vector<std::int64_t> goal_of;
  std::vector<bool> has_goal(column.plan.seeds.size());
  std::vector<Positions> goals(column.plan.seeds.size(), garment.positions), finals;
  for (std::size_t a = 0; a < column.plan.arms.size(); ++a) {
    const double width = column.plan.arms[a].config.at("drawn_width").as_double();
    for (const auto& row : column.rows) {
      if (row.arm != a) continue;
      const auto goal = static_cast<std::size_t>(
          std::find(column.plan.seeds.begin(), column.plan.seeds.end(), row.seed) - column.plan.seeds.begin());
      goal_of.push_back(static_cast<std::int64_t>(goal));
      if (!row.failure.empty()) {
        finals.push_back(garment.positions);  // the row has no error, and the page shows none
        continue;
      }
      const auto file = Hdf5File::open(shape_file(folder, row.seed, width_level(width)));
      finals.push_back(file.read_positions("/final"));
      if (!has_goal[goal]) goals[goal] = file.read_positions("/goal");
      has_goal[goal] = true;
    }
  }
  auto file = create_cases_file(path, garment);
  write_shapes(file, "/planning/goals", goals);
  write_shapes(file, "/planning/finals", finals);
  file.write("/planning/goal_of", {static_cast<Index>(goal_of.size())}, goal_of.data());
  file.commit();
}

AblationPlan estimation_evaluation(const ConfigNode& session, const std::vector<std::string>& methods,
                                   const DataParams& data, const EvaluationCases& cases) {
  AblationPlan plan;
  DataParams copy = data;
  std::string made;
  if (!cases.dataset) {
    // What the fresh examples are drawn from is no part of a session's config, and belongs to the rows' identity.
    const auto text =
        describe_params_erased(&copy, [](void* p, ParamVisitor& v) { static_cast<DataParams*>(p)->visit(v); });
    for (const auto& one : text) made += " " + one.name + "=" + one.default_value;
  }
  plan.description = describe(cases, "estimation") + made;
  plan.factors = {"estimation.method"};
  plan.seeds = cases.seeds;
  for (const auto& method : methods) {
    AblationArm arm;
    arm.name = method;
    arm.levels = {method};
    arm.config = session.with("description", ConfigNode::quoted(plan.description))
                     .with("estimation.method", ConfigNode::quoted(method));
    SessionParams params;
    read_params(arm.config, params);  // a wrong method shows here
    plan.arms.push_back(std::move(arm));
  }
  return plan;
}

AblationRunner estimation_runner(const EvaluationCases& cases, const DataParams& data, const fs::path& folder) {
  return [cases, data, folder](const ConfigNode& config, Host& host) {
    SessionParams params;
    read_params(config, params);
    const std::uint64_t seed = seed_of(config);
    const Task task = make_task(params.task, config, host);
    const auto predictor = bound_predictor(place(config, "predictor"), task, host);
    const Estimator estimator(task, predictor, host.create<Optimiser>(params.estimation_optimiser), params.estimation,
                              host);
    Example made;
    const Example* example = cases.example(seed);
    if (example == nullptr) {
      const auto simulator = host.create<Simulator>(task.simulator);
      // A draw that never releases, or fails, is no manipulation to learn from: the next one is taken.
      for (std::int64_t attempt = 0; attempt < 50 && !made.released; ++attempt)
        made = make_example(*simulator, task, data, seed, attempt);
      if (!made.released) throw Error("none of 50 random trajectories was released");
      example = &made;
    }
    const Index vertices = task.garment->vertex_count();
    const auto shape = [&](Index j) {
      Positions positions(vertices, 3);
      const float* from = example->shapes.data() + j * vertices * 3;
      for (Index i = 0; i < positions.size(); ++i) positions.data()[i] = static_cast<double>(from[i]);
      return positions;
    };
    fs::create_directories(folder / "shapes");
    auto file = Hdf5File::create(shape_file(folder, seed, params.estimation.method));
    file.write("/shapes", {example->segments() + 1, vertices, 3}, example->shapes.data());
    file.commit();
    AblationOutcome outcome;
    for (std::size_t p = 0; p < 4; ++p)
      outcome.metrics.emplace_back(std::string("q_") + kPropertyNames[p], example->q(static_cast<Index>(p)));
    outcome.metrics.emplace_back("segments", static_cast<double>(example->segments()));

    Replay replay;
    for (Index j = 0; j <= example->segments(); ++j) replay.shapes.push_back(shape(j));
    replay.state = example->states.row(0).transpose();
    replay.controls = example->controls;
    const auto estimates = replay_estimates(estimator, task, params.observation, replay, seed, host);
    double slowest = 0.0;
    for (Index j = 1; j <= example->segments(); ++j) {
      const auto& estimate = estimates[static_cast<std::size_t>(j - 1)];
      slowest = std::max(slowest, estimate.seconds);
      for (std::size_t p = 0; p < 4; ++p) {
        outcome.metrics.emplace_back(step_key("c", p, j), estimate.knowledge.centre(static_cast<Index>(p)));
        outcome.metrics.emplace_back(step_key("w", p, j), estimate.knowledge.width(static_cast<Index>(p)));
      }
    }
    outcome.metrics.emplace_back("slowest_estimate_seconds", slowest);
    const auto& last = estimates.back();
    outcome.metrics.emplace_back("nll", last.nll);
    outcome.metrics.emplace_back("misfit", last.misfit);
    if (last.posterior) {
      std::vector<double> values;
      const auto& posterior = *last.posterior;
      values.insert(values.end(), posterior.mode.data(), posterior.mode.data() + 4);
      values.insert(values.end(), posterior.gradient.data(), posterior.gradient.data() + 4);
      values.insert(values.end(), posterior.precision.data(), posterior.precision.data() + 16);
      for (std::size_t i = 0; i < values.size(); ++i)
        outcome.metrics.emplace_back(kPosterior + std::to_string(i), values[i]);
    }
    outcome.paired_by = std::to_string(seed);
    return outcome;
  };
}

void write_estimation_shapes(const EvaluationColumn& column, const Garment& garment, const fs::path& folder,
                             const fs::path& path) {
  const Index vertices = garment.vertex_count();
  std::vector<float> shapes;
  std::vector<std::int64_t> first{0};
  for (const auto& row : column.rows) {
    if (row.arm != 0) continue;
    const fs::path kept = shape_file(folder, row.seed, column.plan.arms[0].levels.front());
    // A failed case has none, and rows of before shapes were kept have none either.
    if (row.failure.empty() && fs::exists(kept)) {
      const auto values = Hdf5File::open(kept).read_float("/shapes");
      shapes.insert(shapes.end(), values.begin(), values.end());
    }
    first.push_back(static_cast<std::int64_t>(shapes.size()) / (vertices * 3));
  }
  if (shapes.empty()) return;  // nothing to look at
  auto file = create_cases_file(path, garment);
  file.write("/estimation/shapes", {static_cast<Index>(first.back()), vertices, 3}, shapes.data());
  file.write("/estimation/first", {static_cast<Index>(first.size())}, first.data());
  file.commit();
}

std::string planning_evaluation_json(const std::vector<EvaluationColumn>& columns) {
  ordered_json json = planning_column(columns.front());
  json["columns"] = ordered_json::object();
  for (std::size_t i = 1; i < columns.size(); ++i)
    json["columns"][columns[i].cases.source] = planning_column(columns[i]);
  return json.dump(2, ' ', false, ordered_json::error_handler_t::replace) + "\n";
}

std::string planning_evaluation_csv(const std::vector<EvaluationColumn>& columns) {
  std::string text =
      "goals,width,goal,seed,error_mm,default_error_mm,segments,released,first_plan_seconds,plan_seconds\n";
  for (const auto& column : columns) {
    const ordered_json json = planning_column(column);
    for (const auto& one : json["cases"]) {
      text += column.cases.source;
      for (const char* key : {"width", "goal", "seed", "error_mm", "default_error_mm", "segments", "released",
                              "first_plan_seconds", "plan_seconds"})
        text += "," + (one.contains(key) && !one[key].is_null() ? one[key].dump() : std::string());
      text += "\n";
    }
  }
  return text;
}

std::string estimation_evaluation_json(const std::vector<EvaluationColumn>& columns) {
  ordered_json all = ordered_json::object();
  for (const auto& column : columns) {
    ordered_json methods = ordered_json::object();
    for (std::size_t a = 0; a < column.plan.arms.size(); ++a)
      methods[column.plan.arms[a].name] = estimation_figures(column, a);
    all[column.cases.source] = methods;
  }
  const auto& main = columns.front();
  ordered_json json = all[main.cases.source][main.plan.arms.front().name];
  json["goals"] = main.cases.source;
  json["complete"] = main.rows.size() == main.plan.arms.size() * main.plan.seeds.size();
  json["cases"] = estimation_cases(main, 0);
  json["columns"] = all;
  return json.dump(2, ' ', false, ordered_json::error_handler_t::replace) + "\n";
}

std::string estimation_evaluation_csv(const std::vector<EvaluationColumn>& columns) {
  std::string text = "cases,method,seed,segment,property,q,c,w\n";
  for (const auto& column : columns) {
    for (const auto& row : column.rows) {
      if (!row.failure.empty()) continue;
      const MaterialProperties q = truth_of(row);
      for (Index j = 1; j <= steps_of(row); ++j) {
        const MaterialKnowledge k = knowledge_of(row, j);
        for (std::size_t p = 0; p < 4; ++p) {
          const auto i = static_cast<Index>(p);
          text += column.cases.source + "," + column.plan.arms[row.arm].name + "," + std::to_string(row.seed) + "," +
                  std::to_string(j) + "," + kPropertyNames[p] + "," + text_of(q(i)) + "," + text_of(k.centre(i)) + "," +
                  text_of(k.width(i)) + "\n";
        }
      }
    }
  }
  return text;
}

std::string planning_evaluation_table(const EvaluationColumn& column) {
  const ordered_json json = planning_column(column);
  std::string text = "goals: " + column.cases.source + "\n    w    n    median      mean        sd  outliers   mm\n";
  for (const auto& row : json["by_width"]) {
    if (row["n"] == 0) continue;
    char line[120];
    std::snprintf(line, sizeof line, "%5.2f  %3d  %8.2f  %8.2f  %8.2f  %8d\n", row["width"].get<double>(),
                  row["n"].get<int>(), row["median_mm"].get<double>(), row["mean_mm"].get<double>(),
                  row["sd_mm"].is_null() ? 0.0 : row["sd_mm"].get<double>(), row["outliers"].get<int>());
    text += line;
  }
  return text;
}

std::string estimation_evaluation_table(const std::string& json) {
  std::string text;
  const ordered_json parsed = ordered_json::parse(json);
  for (const auto& [source, methods] : parsed.at("columns").items()) {
    text += "cases: " + source +
            "\nmethod     property     n  median |c-q|  mean |c-q|  median w  failures  held .5  held .8   score\n";
    for (const auto& [method, figures] : methods.items()) {
      if (figures["n"] == 0) continue;
      char line[220];
      for (const char* property : kPropertyNames) {
        const auto& row = figures["properties"][property];
        std::snprintf(line, sizeof line, "%-9s  %-9s  %4d  %12.3f  %10.3f  %8.3f  %6.0f %%  %7.2f  %7.2f  %6.3f\n",
                      method.c_str(), property, figures["n"].get<int>(), row["abs_error"]["median"].get<double>(),
                      row["abs_error"]["mean"].get<double>(), row["width"]["median"].get<double>(),
                      100.0 * row["failure_rate"].get<double>(), row["coverage"]["0.5"].get<double>(),
                      row["coverage"]["0.8"].get<double>(), row["interval_score"].get<double>());
        text += line;
      }
      std::snprintf(line, sizeof line, "%-9s  w < 0.02: %.1f %%; slowest estimate %.2f s", method.c_str(),
                    100.0 * figures["narrow_share"].get<double>(), figures["estimate_seconds"]["max"].get<double>());
      text += line;
      if (figures.contains("calibration")) {
        const auto scale = figures["calibration"]["deviation_scale"];
        std::snprintf(line, sizeof line, "; calibrated here by estimation.deviation_scale=[%.2f, %.2f, %.2f, %.2f]",
                      scale[0].get<double>(), scale[1].get<double>(), scale[2].get<double>(), scale[3].get<double>());
        text += line;
      }
      text += "\n";
    }
  }
  return text;
}

IntervalFigures interval_figures(const std::vector<MaterialKnowledge>& knowledge,
                                 const std::vector<MaterialProperties>& truth, Index property) {
  IntervalFigures figures;
  if (knowledge.empty()) return {kNaN, kNaN, kNaN, kNaN};
  const auto n = static_cast<double>(knowledge.size());
  for (std::size_t i = 0; i < knowledge.size(); ++i) {
    const double q = truth[i](property), c = knowledge[i].centre(property), w = knowledge[i].width(property);
    for (const double a : {0.5, 0.8, 1.0}) {
      const double low = std::max(0.0, c - 0.5 * a * w), high = std::min(1.0, c + 0.5 * a * w);
      const bool held = q >= low && q <= high;
      (a == 0.5 ? figures.coverage50 : a == 0.8 ? figures.coverage80 : figures.coverage100) += held / n;
      if (a < 1.0)
        figures.score += 0.5 / n * (high - low + 2.0 / (1.0 - a) * (std::max(0.0, low - q) + std::max(0.0, q - high)));
    }
  }
  return figures;
}

PropertyVector calibrate_deviations(const std::vector<MaterialPosterior>& posteriors,
                                    const std::vector<MaterialProperties>& truth) {
  PropertyVector scale = PropertyVector::Ones();
  const auto judge = [&](const PropertyVector& candidate, Index property) {
    std::vector<MaterialKnowledge> knowledge;
    for (const auto& posterior : posteriors)
      knowledge.push_back(interval_of(posterior.widened(candidate), kCalibrationSweeps));
    const IntervalFigures f = interval_figures(knowledge, truth, property);
    const double miss = std::max(std::abs(f.coverage50 - 0.5), std::abs(f.coverage80 - 0.8));
    // Misses below what so few cases can tell count alike; the score decides among them.
    const double noise = 0.5 / std::sqrt(static_cast<double>(posteriors.size()));
    return std::max(miss, 0.5 * noise) + 1e-3 * f.score;
  };
  // Properties interact through the posteriors' correlations and the box only: two rounds, the second one finer.
  for (const auto& [reach, count] : {std::pair{8.0, 13}, {1.5, 9}}) {
    for (Index p = 0; p < 4; ++p) {
      const double middle = scale(p);
      double best = std::numeric_limits<double>::infinity();
      for (int k = 0; k < count; ++k) {
        PropertyVector candidate = scale;
        candidate(p) = middle * std::pow(reach, 2.0 * k / (count - 1) - 1.0);
        const double loss = judge(candidate, p);
        if (loss < best) {
          best = loss;
          scale(p) = candidate(p);
        }
      }
    }
  }
  return scale;
}

}  // namespace weft
