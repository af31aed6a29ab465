#include "experiments/prediction_evaluation.hpp"

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <nlohmann/json.hpp>
#include <numeric>
#include <optional>
#include <utility>

#include "experiments/prediction_baselines.hpp"
#include "report/cases_file.hpp"
#include "weft/error.hpp"
#include "weft/random.hpp"

namespace weft {
namespace {

using nlohmann::ordered_json;

constexpr std::size_t kShownExamples = 50;  // with their shapes, on the page

using Start = PredictionStart;
std::vector<Start> first_starts(const std::vector<std::size_t>& examples) {
  std::vector<Start> starts;
  for (const std::size_t i : examples) starts.push_back({i, 0});
  return starts;
}
/// Segments drawn from each example without repetition, never its first, which from_start measures.
std::vector<Start> random_starts(const Dataset& dataset, const std::vector<std::size_t>& examples, std::int64_t count,
                                 std::uint64_t seed) {
  std::vector<Start> starts;
  for (const std::size_t i : examples) {
    const auto& e = dataset.examples[i];
    RandomStream random(seed, 0x7374617274ull, e.index);
    std::vector<Index> segments;
    for (Index j = 1; j < e.segments(); ++j) segments.push_back(j);
    for (std::size_t k = 0; k < segments.size() && std::cmp_less(k, count); ++k) {
      std::swap(segments[k], segments[k + random.below(segments.size() - k)]);
      starts.push_back({i, segments[k]});
    }
  }
  return starts;
}

/// A case that predicts the rest of an example. @param most segments that the predictor takes.
PredictionCase case_from(const Dataset& dataset, const Start& start, bool has_knowledge, std::optional<Index> most) {
  const auto& e = dataset.examples[start.example];
  PredictionCase one;
  one.shape = std::make_shared<const Positions>(dataset.shape(start.example, start.segment));
  if (start.segment > 0)
    one.previous = std::make_shared<const Positions>(dataset.shape(start.example, start.segment - 1));
  one.state = e.states.row(start.segment).transpose();
  const Index left = e.segments() - start.segment;
  one.controls = e.controls.middleRows(start.segment, std::min(left, most.value_or(left)));
  one.knowledge = has_knowledge ? MaterialKnowledge::certain(e.q) : MaterialKnowledge::none();
  for (Index j = 1; j <= one.controls.rows(); ++j) one.segments.push_back(j);
  return one;
}

/// Figures of one kind of prediction: of the settled shapes, and after 1, 2, ... segments.
struct Tallies {
  PredictionTally settled;
  std::vector<PredictionTally> by_step;
};

/// @param from_start collects the example's error and the first shapes for the page; null: it does not.
void add_prediction(Tallies& tallies, const Dataset& dataset, const Start& start, const ScoredPrediction& prediction,
                    PredictionEvaluation* from_start) {
  const auto& e = dataset.examples[start.example];
  const auto& steps = prediction.steps;
  if (tallies.by_step.size() < steps.size()) tallies.by_step.resize(steps.size());
  for (std::size_t j = 0; j < steps.size(); ++j) {
    const Index ahead = j + 1;
    tallies.by_step[j].add(start.example, steps[j], ahead);
    if (start.segment + ahead < e.segments() || !e.released) continue;
    tallies.settled.add(start.example, steps[j], ahead);
    if (from_start == nullptr) continue;
    from_start->examples.push_back({e.index, ahead, steps[j].error_mm, prediction.settled_sigma_mm});
    if (prediction.settled.size() > 0 && from_start->settled.size() < kShownExamples) {
      from_start->settled.push_back(dataset.shape(start.example, start.segment + ahead));
      from_start->predicted.push_back(prediction.settled);
    }
  }
}

}  // namespace

ScoredBatch predict_batch(const Predictor& predictor, const Dataset& dataset, const PredictionBatch& batch) {
  std::vector<PredictionCase> cases;
  for (const auto& start : batch.starts)
    cases.push_back(case_from(dataset, start, batch.has_knowledge, predictor.max_segments()));
  ScoredBatch result;
  const auto started = std::chrono::steady_clock::now();
  const auto prediction = predictor.predict(cases, {.moments = Moments::mean_and_sigma});
  result.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - started).count();
  for (std::size_t b = 0; b < batch.starts.size(); ++b) {
    ScoredPrediction& scored = result.cases.emplace_back();
    scored.failure = prediction->failure(b);
    if (!scored.failure.empty()) continue;
    const auto& shapes = prediction->shapes()[b];
    const Start& start = batch.starts[b];
    for (std::size_t j = 0; j < shapes.size(); ++j)
      scored.steps.push_back(score_of(shapes[j], dataset.shape(start.example, start.segment + j + 1)));
    if (shapes.empty()) continue;
    scored.settled_sigma_mm = 1e3 * shapes.back().sigma.rowwise().norm().mean();
    if (batch.wants_shapes) scored.settled = shapes.back().mean;
  }
  return result;
}

PredictionEvaluation evaluate_prediction(const Predictor& predictor, const Task& task, const Dataset& dataset,
                                         const PredictionEvaluationParams& params, std::uint64_t seed, Host& host,
                                         PredictBatch predict) {
  if (!predict) predict = [&](const PredictionBatch& batch) { return predict_batch(predictor, dataset, batch); };
  const auto split = split_or_all(params.split);
  std::vector<std::size_t> chosen = dataset.select(split);
  if (params.max_examples > 0 && std::cmp_less(params.max_examples, chosen.size())) chosen.resize(params.max_examples);
  if (chosen.empty()) throw ConfigError("the dataset has no example in split " + params.split + "; make more examples");

  PredictionEvaluation result;
  // The three kinds of prediction, with all of their steps.
  struct Way {
    bool from_random, has_knowledge;
    PredictionFigures* settled;
    std::vector<PredictionFigures>* by_step;
  };
  const Way ways[] = {{false, true, &result.from_start, &result.by_step},
                      {true, true, &result.from_random, &result.by_step_from_random},
                      {false, false, &result.no_knowledge, &result.by_step_no_knowledge}};
  for (const auto& way : ways) {
    Tallies tallies;
    const std::vector<Start> starts =
        way.from_random ? random_starts(dataset, chosen, params.random_starts, seed) : first_starts(chosen);
    for (std::size_t first = 0; first < starts.size() && !host.cancelled(); first += params.batch) {
      const std::size_t count = std::min<std::size_t>(params.batch, starts.size() - first);
      const bool from_start = way.settled == &result.from_start;
      const auto begin = starts.begin() + static_cast<std::ptrdiff_t>(first);
      const PredictionBatch batch{{begin, begin + static_cast<std::ptrdiff_t>(count)},
                                  way.has_knowledge,
                                  from_start && result.settled.size() < kShownExamples};
      const ScoredBatch scored = predict(batch);
      if (host.cancelled()) break;
      result.seconds += scored.seconds;
      if (scored.failure.status != WorkStatus::done) {
        result.failed += count;
        result.failures.push_back({scored.failure, count});
        continue;
      }
      for (std::size_t b = 0; b < count; ++b) {
        const Start& start = starts[first + b];
        const Index left = dataset.examples[start.example].segments() - start.segment;
        result.shortened += predictor.max_segments().value_or(left) < left;
        if (scored.cases[b].failure.empty())
          add_prediction(tallies, dataset, start, scored.cases[b], from_start ? &result : nullptr);
        else
          ++result.failed;
      }
    }
    *way.settled = tallies.settled.figures();
    for (const auto& tally : tallies.by_step) way.by_step->push_back(tally.figures());
  }
  if (params.baselines) {
    std::vector<std::size_t> released;
    for (const auto i : chosen) {
      if (dataset.examples[i].released) released.push_back(i);
    }
    const bool is_train_apart = split && *split != Split::train;
    result.baselines = measure_baselines(dataset, released, *task.trajectory, params.linear_components, is_train_apart);
  }
  return result;
}

namespace {

ordered_json to_json(const PredictionFigures& f) {
  return {{"steps", f.steps},
          {"n", f.n},
          {"examples", f.examples},
          {"mean_mm", f.mean_mm},
          {"mean_mm_se", f.mean_mm_se},
          {"median_mm", f.median_mm},
          {"nll", f.nll},
          {"nse", f.nse},
          {"nse_se", f.nse_se},
          {"coverage_1sigma", f.coverage_1sigma},
          {"coverage_1sigma_se", f.coverage_1sigma_se},
          {"sigma_mm", f.sigma_mm}};
}

}  // namespace

std::string prediction_evaluation_json(const PredictionEvaluation& r) {
  ordered_json json;
  json["settled"] = {{"from_start", to_json(r.from_start)},
                     {"from_random", to_json(r.from_random)},
                     {"no_knowledge", to_json(r.no_knowledge)}};
  const auto list = [](const std::vector<PredictionFigures>& all) {
    auto array = ordered_json::array();
    for (const auto& f : all) array.push_back(to_json(f));
    return array;
  };
  json["by_step"] = list(r.by_step);
  json["by_step_from_random"] = list(r.by_step_from_random);
  json["by_step_no_knowledge"] = list(r.by_step_no_knowledge);
  json["baselines"] = ordered_json::object();
  for (const auto& [name, f] : r.baselines)
    json["baselines"][name] = {{"n", f.n}, {"mean_mm", f.mean_mm}, {"median_mm", f.median_mm}};
  json["cases"] = ordered_json::array();
  for (const auto& e : r.examples)
    json["cases"].push_back(
        {{"example", e.index}, {"segments", e.segments}, {"error_mm", e.error_mm}, {"sigma_mm", e.sigma_mm}});
  json["failed"] = r.failed;
  if (!r.failures.empty()) {
    json["failures"] = ordered_json::array();
    for (const auto& [failure, cases] : r.failures)
      json["failures"].push_back(
          {{"status", to_string(failure.status)}, {"failure", failure.message}, {"cases", cases}});
  }
  json["shortened"] = r.shortened;
  return json.dump(2) + "\n";
}

void write_prediction_shapes(const PredictionEvaluation& r, const Garment& garment, const std::filesystem::path& path) {
  if (r.settled.empty()) return;
  std::vector<std::int64_t> goal_of(r.settled.size());
  std::iota(goal_of.begin(), goal_of.end(), 0);
  auto file = create_cases_file(path, garment);
  write_shapes(file, "/prediction/goals", r.settled);
  write_shapes(file, "/prediction/finals", r.predicted);
  file.write("/prediction/goal_of", {static_cast<Index>(goal_of.size())}, goal_of.data());
  file.commit();
}

std::string prediction_times_json(const PredictionEvaluation& r) {
  return ordered_json{{"predict_seconds", r.seconds}}.dump(2) + "\n";
}

std::string prediction_evaluation_csv(const PredictionEvaluation& r) {
  std::string text =
      "what,steps,n,mean_mm,median_mm,nll,coverage_1sigma,nse,sigma_mm,examples,mean_mm_se,coverage_1sigma_se,nse_se\n";
  const auto row = [&](const std::string& what, const PredictionFigures& f, bool has_sigma) {
    char line[320];
    if (has_sigma) {
      std::snprintf(line, sizeof(line), ",%.9g,%td,%.9g,%.9g,%.9g,%.9g,%.9g,%.9g,%td,%.9g,%.9g,%.9g\n", f.steps, f.n,
                    f.mean_mm, f.median_mm, f.nll, f.coverage_1sigma, f.nse, f.sigma_mm, f.examples, f.mean_mm_se,
                    f.coverage_1sigma_se, f.nse_se);
    } else {
      std::snprintf(line, sizeof(line), ",%.9g,%td,%.9g,%.9g,,,,,%td,%.9g,,\n", f.steps, f.n, f.mean_mm, f.median_mm,
                    f.examples, f.mean_mm_se);
    }
    text += what + line;
  };
  row("settled.from_start", r.from_start, true);
  row("settled.from_random", r.from_random, true);
  row("settled.no_knowledge", r.no_knowledge, true);
  for (const auto& f : r.by_step) row("by_step", f, true);
  for (const auto& f : r.by_step_from_random) row("by_step_from_random", f, true);
  for (const auto& f : r.by_step_no_knowledge) row("by_step_no_knowledge", f, true);
  for (const auto& [name, f] : r.baselines) row("baselines." + name, f, false);
  return text;
}

}  // namespace weft
