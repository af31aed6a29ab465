#include "experiments/estimation_evaluation.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <nlohmann/json.hpp>

#include "experiments/json_numbers.hpp"
#include "experiments/statistics.hpp"
#include "experiments/sweep_rows.hpp"
#include "report/cases_file.hpp"
#include "sdk/files.hpp"
#include "session/replay.hpp"
#include "session/session.hpp"
#include "simulation/fold.hpp"
#include "simulation/task_config.hpp"
#include "weft/config.hpp"
#include "weft/hdf5_file.hpp"

namespace weft {
namespace {

using nlohmann::ordered_json;
namespace fs = std::filesystem;

constexpr const char* kCaseSchema = "weft estimation case 1";
constexpr int kCalibrationSweeps = 600;  // errors of a few per cent in the quantiles, below what so few cases resolve

/// All entries in storage order.
ordered_json numbers(const auto& matrix) {
  auto list = ordered_json::array();
  for (Index i = 0; i < matrix.size(); ++i) list.push_back(json_number(matrix.data()[i]));
  return list;
}
void read_numbers(const ordered_json& list, auto& matrix) {
  for (Index i = 0; i < matrix.size(); ++i) matrix.data()[i] = number_of(list.at(i));
}

/// Case of a row of "weft ablation row 1": numbers by name, such as c_bend_02 for the centre after two segments.
EstimationCase case_of_metrics(const SweepRow& row) {
  EstimationCase one;
  for (std::size_t p = 0; p < 4; ++p) one.truth(p) = row.metric(std::string("q_") + kPropertyNames[p]);
  const auto at_step = [&](const char* what, std::size_t property, int step) {
    char name[60];
    std::snprintf(name, sizeof name, "%s_%s_%02d", what, kPropertyNames[property], step);
    return row.metric(name);
  };
  for (int step = 1; step <= row.metric("segments"); ++step) {
    MaterialKnowledge k;
    for (std::size_t p = 0; p < 4; ++p) {
      k.centre(p) = at_step("c", p, step);
      k.width(p) = at_step("w", p, step);
    }
    one.knowledge.push_back(k);
  }
  Index at = 0;
  const auto next = [&] { return row.metric("posterior_" + std::to_string(at++)); };
  MaterialPosterior posterior;
  for (Index p = 0; p < 4; ++p) posterior.mode(p) = next();
  for (Index p = 0; p < 4; ++p) posterior.gradient(p) = next();
  for (Index p = 0; p < 16; ++p) posterior.precision.data()[p] = next();
  if (std::isfinite(posterior.mode(0))) one.posterior = posterior;
  return one;
}

ordered_json json_of(const BootstrapStatistics& s) {
  return {{"mean", json_number(s.mean)},
          {"sd", json_number(s.sd)},
          {"median", json_number(s.median)},
          {"mean_95", json_interval(s.mean_interval)},
          {"median_95", json_interval(s.median_interval)}};
}

/// The figures of one method: those of Table 1 and more.
ordered_json estimation_figures(const EvaluationColumn& column, std::size_t arm) {
  std::vector<MaterialProperties> truth;
  std::vector<MaterialKnowledge> last;
  std::vector<MaterialPosterior> posteriors;
  for (const auto& row : column.rows) {
    if (row.arm != arm || !row.failure.empty()) continue;
    const EstimationCase one = estimation_case(row);
    truth.push_back(one.truth);
    last.push_back(one.knowledge.back());
    if (one.posterior) posteriors.push_back(*one.posterior);
  }
  const std::size_t count = truth.size();
  ordered_json json{{"method", column.plan.arms[arm].levels.front()}, {"n", count}};
  json["properties"] = ordered_json::object();
  double narrow = 0.0;
  for (std::size_t p = 0; p < 4; ++p) {
    const auto i = static_cast<Index>(p);
    std::vector<double> errors, widths;
    double failures = 0.0;
    for (std::size_t k = 0; k < count; ++k) {
      const double error = std::abs(last[k].centre(i) - truth[k](i));
      errors.push_back(error);
      widths.push_back(last[k].width(i));
      narrow += last[k].width(i) < 0.02;
      const bool outside = truth[k](i) < last[k].lower()(i) || truth[k](i) > last[k].upper()(i);
      failures += error > 0.1 && outside;
    }
    const IntervalFigures f = interval_figures(last, truth, i);
    const auto n = static_cast<double>(count);
    json["properties"][kPropertyNames[p]] = {
        {"abs_error", json_of(bootstrap_statistics(errors, kResamples, kBootstrapKey))},
        {"width", json_of(bootstrap_statistics(widths, kResamples, kBootstrapKey))},
        {"failure_rate", json_number(failures / n)},
        {"coverage",
         {{"0.5", json_number(f.coverage50)}, {"0.8", json_number(f.coverage80)}, {"1", json_number(f.coverage100)}}},
        {"interval_score", json_number(f.score)}};
  }
  json["narrow_share"] = json_number(narrow / (4.0 * static_cast<double>(count)));  // w < 0.02
  if (posteriors.size() == count && count > 0) {
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
      one["status"] = to_string(row.status);
      one["failed"] = row.failure;
    } else {
      const EstimationCase found = estimation_case(row);
      one["true_material"] = list(found.truth);
      one["knowledge"] = ordered_json::array();
      const auto add = [&](const MaterialKnowledge& k) {
        one["knowledge"].push_back({{"centre", list(k.centre)}, {"width", list(k.width)}});
      };
      add(MaterialKnowledge::none());
      for (const auto& k : found.knowledge) add(k);
    }
    cases.push_back(one);
  }
  return cases;
}

/// The times of estimation_figures().
ordered_json estimation_times(const EvaluationColumn& column, std::size_t arm) {
  std::vector<double> seconds;
  for (const auto& row : column.rows)
    if (row.arm == arm && row.failure.empty()) seconds.push_back(row.metric("slowest_estimate_seconds"));
  return {{"estimate_seconds",
           {{"median", json_number(quantile_of(seconds, 0.5))}, {"max", json_number(quantile_of(seconds, 1.0))}}}};
}

/// The manipulation of an example, executed again in the world.
Example executed_in(const Task& world, const Example& example, Host& host) {
  Example made = example;
  const FoldResult fold = simulate_fold(*host.create<Simulator>(world.simulator), world, example.q, example.controls,
                                        [&host] { return host.cancelled(); });
  made.shapes.clear();
  for (const auto& shape : fold.shapes) {
    const auto frame = to_frame(shape);
    made.shapes.insert(made.shapes.end(), frame.begin(), frame.end());
  }
  return made;
}

/// The manipulation of a fresh case. A draw that fails or never releases is skipped.
Example make_released(const Task& task, const DataParams& data, std::uint64_t seed, Host& host) {
  const auto simulator = host.create<Simulator>(task.simulator);
  for (std::int64_t attempt = 0; attempt < 50; ++attempt) {
    Example made = make_example(*simulator, task, data, seed, attempt);
    if (made.released) return made;
  }
  throw Error("none of 50 random trajectories was released");
}

Replay replay_of(const Example& example, Index vertices) {
  Replay replay;
  for (Index j = 0; j <= example.segments(); ++j) {
    Positions positions(vertices, 3);
    const float* from = example.shapes.data() + j * vertices * 3;
    for (Index i = 0; i < positions.size(); ++i) positions.data()[i] = static_cast<double>(from[i]);
    replay.shapes.push_back(std::move(positions));
  }
  replay.state = example.states.row(0).transpose();
  replay.controls = example.controls;
  return replay;
}

}  // namespace

SweepPayload to_payload(const EstimationCase& one) {
  ordered_json json{{"true_material", numbers(one.truth)}, {"knowledge", ordered_json::array()}};
  for (const auto& k : one.knowledge)
    json["knowledge"].push_back({{"centre", numbers(k.centre)}, {"width", numbers(k.width)}});
  if (one.posterior) {
    json["posterior"] = {{"mode", numbers(one.posterior->mode)},
                         {"gradient", numbers(one.posterior->gradient)},
                         {"precision", numbers(one.posterior->precision)}};
  }
  return {kCaseSchema, json.dump()};
}

EstimationCase estimation_case(const SweepRow& row) {
  const auto& payload = row.outcome.payload;
  const auto fail = [&](const std::string& what) {
    throw ConfigError(row.file.string() + ": " + what + "; remove it to run its cell again");
  };
  EstimationCase one;
  if (payload.schema.empty()) {
    one = case_of_metrics(row);
  } else {
    if (payload.schema != kCaseSchema)
      fail("holds a '" + payload.schema + "', this program reads '" + kCaseSchema + "'");
    try {
      const auto json = ordered_json::parse(payload.json);
      read_numbers(json.at("true_material"), one.truth);
      for (const auto& item : json.at("knowledge")) {
        one.knowledge.emplace_back();
        read_numbers(item.at("centre"), one.knowledge.back().centre);
        read_numbers(item.at("width"), one.knowledge.back().width);
      }
      if (const auto posterior = json.find("posterior"); posterior != json.end()) {
        one.posterior.emplace();
        read_numbers(posterior->at("mode"), one.posterior->mode);
        read_numbers(posterior->at("gradient"), one.posterior->gradient);
        read_numbers(posterior->at("precision"), one.posterior->precision);
      }
    } catch (const nlohmann::json::exception& error) {
      fail(std::string("is damaged: ") + error.what());
    }
  }
  if (one.knowledge.empty()) fail("holds no estimate");
  return one;
}

SweepPlan estimation_evaluation(const ConfigNode& session, const std::vector<std::string>& methods,
                                const DataParams& data, const EvaluationCases& cases) {
  SweepPlan plan;
  DataParams copy = data;
  std::string made;
  if (!cases.dataset) {
    // The distribution of fresh examples is not in the session's config, but belongs to the identity of the rows.
    const auto text =
        describe_params_erased(&copy, [](void* p, ParamVisitor& v) { static_cast<DataParams*>(p)->visit(v); });
    for (const auto& one : text) made += " " + one.name + "=" + one.default_value;
  }
  plan.description = describe(cases, "estimation") + made;
  plan.factors = {"estimation.method"};
  plan.seeds = cases.seeds;
  for (const auto& method : methods) {
    SweepArm arm;
    arm.name = method;
    arm.levels = {method};
    arm.config = session.with("description", ConfigNode::quoted(plan.description))
                     .with("estimation.method", ConfigNode::quoted(method));
    SessionParams params;
    read_params(arm.config, params);  // refuses a wrong method
    plan.arms.push_back(std::move(arm));
  }
  return plan;
}

SweepRunner estimation_runner(const EvaluationCases& cases, const DataParams& data, const fs::path& folder) {
  return [cases, data, folder](const ConfigNode& config, Host& host) {
    SessionParams params;
    read_params(config, params);
    const std::uint64_t seed = seed_of(config);
    const Task task = make_task(params.task, config, host);
    const auto predictor = bound_predictor(place(config, "predictor"), task, host);
    const SessionEstimator estimator(task, predictor, host.create<Optimiser>(params.estimation_optimiser),
                                     params.estimation, params.correction.simulator, host);
    const Example* known = cases.example(seed);
    const Task world = world_task(task, params.world, seed);
    const bool is_as_recorded = known != nullptr && params.world.is_the_tasks();
    const Example example = is_as_recorded     ? *known
                            : known != nullptr ? executed_in(world, *known, host)
                                               : make_released(world, data, seed, host);
    const Index vertices = task.garment->vertex_count();
    make_folder_for_results(folder / "shapes");
    auto file = Hdf5File::create(shape_file(folder, seed, params.estimation.method));
    file.write("/shapes", {example.segments() + 1, vertices, 3}, example.shapes.data());
    file.commit();

    const auto estimates =
        replay_estimates(estimator, task, params.observation, replay_of(example, vertices), seed, host);
    EstimationCase found{example.q, {}, estimates.back().posterior};
    double slowest = 0.0;
    for (const auto& estimate : estimates) {
      slowest = std::max(slowest, estimate.seconds);
      found.knowledge.push_back(estimate.knowledge);
    }
    SweepOutcome outcome;
    outcome.metrics = {{"segments", static_cast<double>(example.segments())},
                       {"nll", estimates.back().nll},
                       {"misfit", estimates.back().misfit}};
    outcome.times = {{"slowest_estimate_seconds", slowest}};
    outcome.paired_by = std::to_string(seed);
    outcome.payload = to_payload(found);
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
    // Failed cases have no shapes, and neither have rows of older versions.
    if (row.failure.empty() && fs::exists(kept)) {
      const auto values = Hdf5File::open(kept).read_float("/shapes");
      shapes.insert(shapes.end(), values.begin(), values.end());
    }
    first.push_back(static_cast<std::int64_t>(shapes.size()) / (vertices * 3));
  }
  if (shapes.empty()) return;
  auto file = create_cases_file(path, garment);
  file.write("/estimation/shapes", {static_cast<Index>(first.back()), vertices, 3}, shapes.data());
  file.write("/estimation/first", {static_cast<Index>(first.size())}, first.data());
  file.commit();
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
  json["complete"] = main.rows.size() == main.plan.cells();
  json["cases"] = estimation_cases(main, 0);
  json["columns"] = all;
  add_mixed(json, main.rows, 0);
  return json.dump(2, ' ', false, ordered_json::error_handler_t::replace) + "\n";
}

std::string estimation_times_json(const std::vector<EvaluationColumn>& columns) {
  const auto& main = columns.front();
  ordered_json json = estimation_times(main, 0);
  json["cases"] = ordered_json::array();
  for (const auto& row : main.rows) {
    if (row.arm != 0) continue;
    ordered_json one = ordered_json::object();
    if (row.failure.empty()) one["slowest_estimate_seconds"] = json_number(row.metric("slowest_estimate_seconds"));
    json["cases"].push_back(one);
  }
  json["columns"] = ordered_json::object();
  for (const auto& column : columns)
    for (std::size_t a = 0; a < column.plan.arms.size(); ++a)
      json["columns"][column.cases.source][column.plan.arms[a].name] = estimation_times(column, a);
  return json.dump(2) + "\n";
}

std::string estimation_times_csv(const std::vector<EvaluationColumn>& columns) {
  std::string text = "cases,method,seed,slowest_estimate_seconds\n";
  for (const auto& column : columns)
    for (const auto& row : column.rows)
      if (row.failure.empty())
        text += column.cases.source + "," + column.plan.arms[row.arm].name + "," + std::to_string(row.seed) + "," +
                text_of(row.metric("slowest_estimate_seconds")) + "\n";
  return text;
}

std::string estimation_evaluation_csv(const std::vector<EvaluationColumn>& columns) {
  std::string text = "cases,method,seed,segment,property,q,c,w\n";
  for (const auto& column : columns) {
    for (const auto& row : column.rows) {
      if (!row.failure.empty()) continue;
      const EstimationCase one = estimation_case(row);
      for (std::size_t j = 0; j < one.knowledge.size(); ++j) {
        const MaterialKnowledge& k = one.knowledge[j];
        for (std::size_t p = 0; p < 4; ++p) {
          const auto i = static_cast<Index>(p);
          text += column.cases.source + "," + column.plan.arms[row.arm].name + "," + std::to_string(row.seed) + "," +
                  std::to_string(j + 1) + "," + kPropertyNames[p] + "," + text_of(one.truth(i)) + "," +
                  text_of(k.centre(i)) + "," + text_of(k.width(i)) + "\n";
        }
      }
    }
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
    // Coverage errors below the resolution of so few cases count as equal. The score decides among them.
    const double noise = 0.5 / std::sqrt(static_cast<double>(posteriors.size()));
    return std::max(miss, 0.5 * noise) + 1e-3 * f.score;
  };
  // Properties interact only through the posteriors' correlations and the box, so two rounds are enough; the second one
  // is finer.
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
