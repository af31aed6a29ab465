#include "experiments/prediction_evaluation.hpp"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>
#include <map>
#include <nlohmann/json.hpp>
#include <numbers>
#include <numeric>
#include <set>
#include <tuple>

#include "learning/held_out.hpp"
#include "report/cases_file.hpp"

namespace weft {
namespace {

using nlohmann::ordered_json;

constexpr std::size_t kShownExamples = 50;  // with their shapes, on the page

/// Collects cases of one row of the table.
struct Tally {
  std::vector<double> errors, inside, square;  // per case; the last two are means over its coordinates
  std::vector<std::size_t> examples;           // per case
  double steps = 0.0, nll = 0.0, sigma = 0.0;

  void add(std::size_t example, const ShapeDistribution& predicted, const Positions& truth, Index ahead) {
    add(example, predicted.mean, truth, ahead);
    double likelihood = 0.0, within = 0.0, squares = 0.0, sigmas = 0.0;
    for (Index i = 0; i < truth.size(); ++i) {
      const double s = predicted.sigma.data()[i] * 1e3;
      const double r = (predicted.mean.data()[i] - truth.data()[i]) * 1e3 / s;
      likelihood += 0.5 * r * r + std::log(s) + 0.5 * std::log(2.0 * std::numbers::pi);
      within += std::abs(r) <= 1.0;
      squares += r * r;
      sigmas += s;
    }
    const auto coordinates = static_cast<double>(truth.size());
    nll += likelihood / coordinates;
    sigma += sigmas / coordinates;
    inside.push_back(within / coordinates);
    square.push_back(squares / coordinates);
  }
  void add(std::size_t example, const Positions& predicted, const Positions& truth, Index ahead) {
    steps += static_cast<double>(ahead);
    errors.push_back(mean_distance_mm(predicted, truth));
    examples.push_back(example);
  }
  /// Mean and its standard error, when the cases of an example are one observation; NaN of one.
  std::pair<double, double> mean(const std::vector<double>& values) const {
    if (values.empty()) return {};
    const auto n = static_cast<double>(values.size());
    const double mean = std::accumulate(values.begin(), values.end(), 0.0) / n;
    std::map<std::size_t, double> deviations;
    for (std::size_t k = 0; k < values.size(); ++k) deviations[examples[k]] += values[k] - mean;
    double squares = 0.0;
    for (const auto& [example, deviation] : deviations) squares += deviation * deviation;
    return {mean, deviations.size() > 1 ? std::sqrt(squares) / n : std::numeric_limits<double>::quiet_NaN()};
  }
  PredictionFigures figures() const {
    PredictionFigures f;
    f.n = static_cast<Index>(errors.size());
    if (f.n == 0) return f;
    const auto n = static_cast<double>(f.n);
    std::vector<double> sorted = errors;
    std::sort(sorted.begin(), sorted.end());
    f.examples = static_cast<Index>(std::set<std::size_t>(examples.begin(), examples.end()).size());
    std::tie(f.mean_mm, f.mean_mm_se) = mean(errors);
    const std::size_t middle = sorted.size() / 2;
    f.median_mm = sorted.size() % 2 == 1 ? sorted[middle] : 0.5 * (sorted[middle - 1] + sorted[middle]);
    f.steps = steps / n;
    f.nll = nll / n;
    f.sigma_mm = sigma / n;
    std::tie(f.coverage_1sigma, f.coverage_1sigma_se) = mean(inside);
    std::tie(f.nse, f.nse_se) = mean(square);
    return f;
  }
};

/// What a lookup or a linear model may know before the fold: the material, and the path of the hands by progress.
Vector describe_example(const Example& e, const Trajectory& trajectory) {
  constexpr Index kPoints = 6;
  const Index s = e.states.cols();
  Vector features(4 + kPoints * s + 1);
  features.head<4>() = e.q;
  std::vector<double> progress;
  for (Index j = 0; j <= e.segments(); ++j) progress.push_back(trajectory.progress(e.states.row(j).transpose()));
  Index at = 0;
  for (Index p = 0; p < kPoints; ++p) {
    const double wanted = progress.back() * static_cast<double>(p + 1) / static_cast<double>(kPoints);
    while (at + 1 < e.segments() && progress[static_cast<std::size_t>(at + 1)] < wanted) ++at;
    const double a = progress[static_cast<std::size_t>(at)], b = progress[static_cast<std::size_t>(at + 1)];
    const double t = b > a ? std::clamp((wanted - a) / (b - a), 0.0, 1.0) : 1.0;
    features.segment(4 + p * s, s) = ((1.0 - t) * e.states.row(at) + t * e.states.row(at + 1)).transpose();
  }
  features(features.size() - 1) = static_cast<double>(e.segments());
  return features;
}

/// @param learn whether the train split may be learned from: not when it is what is predicted.
std::map<std::string, PredictionFigures> measure_baselines(const Dataset& dataset, const std::vector<std::size_t>& test,
                                                           const Trajectory& trajectory, Index components, bool learn) {
  std::vector<std::size_t> train;
  for (const auto i : dataset.select(Split::train)) {
    if (learn && dataset.examples[i].released) train.push_back(i);
  }
  std::map<std::string, Tally> tallies;
  const auto settled = [&](std::size_t i) { return dataset.shape(i, dataset.examples[i].segments()); };
  for (const auto i : test) {
    const auto& e = dataset.examples[i];
    tallies["persistence"].add(i, dataset.shape(i, e.segments() - 1), settled(i), 1);
    tallies["start_shape"].add(i, dataset.shape(i, 0), settled(i), e.segments());
  }
  std::map<std::string, PredictionFigures> figures;
  if (train.size() >= 2) {
    const Index n = dataset.header.vertices * 3;
    const auto m = static_cast<Index>(train.size());
    Eigen::MatrixXf shapes(n, m);
    std::vector<Vector> features;
    for (Index k = 0; k < m; ++k) {
      const Positions shape = settled(train[static_cast<std::size_t>(k)]);
      shapes.col(k) = Eigen::Map<const Vector>(shape.data(), n).cast<float>();
      features.push_back(describe_example(dataset.examples[train[static_cast<std::size_t>(k)]], trajectory));
    }
    const Index f = features.front().size();
    Vector mean = Vector::Zero(f), sd = Vector::Zero(f);
    for (const auto& x : features) mean += x / static_cast<double>(m);
    for (const auto& x : features) sd += (x - mean).cwiseAbs2() / static_cast<double>(m);
    sd = sd.cwiseSqrt().cwiseMax(1e-9);
    // Linear model: ridge regression from the features to the principal components of the settled shapes.
    const Eigen::VectorXf centre = shapes.rowwise().mean();
    const Index some = std::min<Index>(m, 1000);
    Eigen::MatrixXf sample(n, some);
    for (Index k = 0; k < some; ++k) sample.col(k) = shapes.col(k * m / some) - centre;
    const Eigen::SelfAdjointEigenSolver<Matrix> gram((sample.transpose() * sample).cast<double>());
    const Index rank = std::min(components, some - 1);
    Eigen::MatrixXf basis(n, rank);
    for (Index c = 0; c < rank; ++c) {
      basis.col(c) = sample * gram.eigenvectors().col(some - 1 - c).cast<float>();
      basis.col(c).normalize();
    }
    const Matrix codes = (basis.transpose() * (shapes.colwise() - centre)).cast<double>();
    Matrix design(m, f + 1);
    for (Index k = 0; k < m; ++k) {
      design.row(k).head(f) = (features[static_cast<std::size_t>(k)] - mean).cwiseQuotient(sd).transpose();
      design(k, f) = 1.0;
    }
    Matrix normal = design.transpose() * design;
    normal.diagonal().array() += 1e-3 * static_cast<double>(m);
    const Matrix weights = normal.ldlt().solve(design.transpose() * codes.transpose());
    const auto positions = [&](const Eigen::VectorXf& flat) {
      const Vector wide = flat.cast<double>();
      return Positions(Eigen::Map<const Positions>(wide.data(), n / 3, 3));
    };
    for (const auto i : test) {
      const auto& e = dataset.examples[i];
      const Positions truth = settled(i);
      const Index k = e.segments();
      tallies["mean_shape"].add(i, positions(centre), truth, k);
      Vector x(f + 1);
      x.head(f) = (describe_example(e, trajectory) - mean).cwiseQuotient(sd);
      x(f) = 1.0;
      tallies["linear_pca"].add(i, positions(centre + basis * (weights.transpose() * x).cast<float>()), truth, k);
      Index nearest_inputs = 0, nearest_shape = 0;
      (design.rowwise() - x.transpose()).rowwise().squaredNorm().minCoeff(&nearest_inputs);
      const Eigen::VectorXf flat = Eigen::Map<const Vector>(truth.data(), n).cast<float>();
      (shapes.colwise() - flat).colwise().squaredNorm().minCoeff(&nearest_shape);
      tallies["nearest_example"].add(i, positions(shapes.col(nearest_inputs)), truth, k);
      tallies["nearest_example_oracle"].add(i, positions(shapes.col(nearest_shape)), truth, k);
    }
  }
  for (const auto& [name, tally] : tallies) figures[name] = tally.figures();
  return figures;
}

struct Start {
  std::size_t example = 0;  // position in the dataset
  Index segment = 0;
};
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
    RandomStream random(seed, 0x7374617274ull, static_cast<std::uint64_t>(e.index));
    std::vector<Index> segments;
    for (Index j = 1; j < e.segments(); ++j) segments.push_back(j);
    for (std::size_t k = 0; k < segments.size() && k < static_cast<std::size_t>(count); ++k) {
      std::swap(segments[k], segments[k + random.below(segments.size() - k)]);
      starts.push_back({i, segments[k]});
    }
  }
  return starts;
}

}  // namespace

PredictionEvaluation evaluate_prediction(const Predictor& predictor, const Task& task, const Dataset& dataset,
                                         const PredictionEvaluationParams& params, std::uint64_t seed, Host& host) {
  const auto split = split_or_all(params.split);
  std::vector<std::size_t> chosen = dataset.select(split);
  if (params.max_examples > 0 && static_cast<std::size_t>(params.max_examples) < chosen.size())
    chosen.resize(static_cast<std::size_t>(params.max_examples));
  if (chosen.empty()) throw ConfigError("the dataset has no example in split " + params.split + "; make more examples");

  PredictionEvaluation result;
  // The three ways to ask, over all of their steps at once.
  struct Way {
    bool from_random, has_knowledge;
    PredictionFigures* settled;
    std::vector<PredictionFigures>* by_step;
  };
  const Way ways[] = {{false, true, &result.from_start, &result.by_step},
                      {true, true, &result.from_random, &result.by_step_from_random},
                      {false, false, &result.no_knowledge, &result.by_step_no_knowledge}};
  for (const auto& way : ways) {
    Tally settled;
    std::vector<Tally> by_step;
    const std::vector<Start> starts =
        way.from_random ? random_starts(dataset, chosen, params.random_starts, seed) : first_starts(chosen);
    for (std::size_t first = 0; first < starts.size() && !host.cancelled();
         first += static_cast<std::size_t>(params.batch)) {
      const std::size_t count = std::min(static_cast<std::size_t>(params.batch), starts.size() - first);
      std::vector<PredictionCase> cases;
      for (std::size_t b = 0; b < count; ++b) {
        const auto [i, start] = starts[first + b];
        const auto& e = dataset.examples[i];
        PredictionCase one;
        one.shape = std::make_shared<const Positions>(dataset.shape(i, start));
        if (start > 0) one.previous = std::make_shared<const Positions>(dataset.shape(i, start - 1));
        one.state = e.states.row(start).transpose();
        const Index left = e.segments() - start, steps = std::min(left, predictor.max_segments().value_or(left));
        result.shortened += steps < left;
        one.controls = e.controls.middleRows(start, steps);
        one.knowledge = way.has_knowledge ? MaterialKnowledge::certain(e.q) : MaterialKnowledge::none();
        for (Index j = 1; j <= one.controls.rows(); ++j) one.segments.push_back(j);
        cases.push_back(std::move(one));
      }
      const auto started = std::chrono::steady_clock::now();
      const auto prediction = predictor.predict(cases, {.moments = Moments::mean_and_sigma});
      result.seconds += std::chrono::duration<double>(std::chrono::steady_clock::now() - started).count();
      for (std::size_t b = 0; b < count; ++b) {
        if (!prediction->failure(b).empty()) {
          ++result.failed;
          continue;
        }
        const auto [i, start] = starts[first + b];
        const auto steps = static_cast<std::size_t>(cases[b].controls.rows());
        if (by_step.size() < steps) by_step.resize(steps);
        for (std::size_t j = 0; j < steps; ++j) {
          const ShapeDistribution& shape = prediction->shapes()[b][j];
          const Index ahead = static_cast<Index>(j) + 1;
          const Positions truth = dataset.shape(i, start + ahead);
          by_step[j].add(i, shape, truth, ahead);
          if (start + ahead < dataset.examples[i].segments() || !dataset.examples[i].released) continue;
          settled.add(i, shape, truth, ahead);
          if (way.settled != &result.from_start) continue;
          result.examples.push_back({dataset.examples[i].index, ahead, mean_distance_mm(shape.mean, truth),
                                     1e3 * shape.sigma.rowwise().norm().mean()});
          if (result.settled.size() < kShownExamples) {
            result.settled.push_back(truth);
            result.predicted.push_back(shape.mean);
          }
        }
      }
    }
    *way.settled = settled.figures();
    for (const auto& tally : by_step) way.by_step->push_back(tally.figures());
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
  json["shortened"] = r.shortened;
  json["predict_seconds"] = r.seconds;
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
