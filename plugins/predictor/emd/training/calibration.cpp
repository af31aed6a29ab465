// The calibration pass: compares predictions of examples with their recorded shapes, and finds the factors and lengths
// that fit sigma to the errors. Part of the training library; libtorch runs the network.
#include "calibration.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <nlohmann/json.hpp>
#include <numeric>

#include "../model_file.hpp"
#include "../training_library.hpp"
#include "passes.hpp"
#include "sigma_layer.hpp"
#include "sigma_tally.hpp"
#include "weft/random.hpp"

namespace weft::emd {
namespace {

constexpr std::uint64_t kCalibrationStream = 0x63616c6962ull;  // "calib"

/// The predictions that one row of the calibration is for.
struct Kind {
  bool from_start;  ///< or from within a session
  bool is_known;    ///< material known exactly, or not at all
};

/// One for the first dataset and one for all others together, since their distributions differ.
template <class T>
using PerSource = std::array<T, 2>;

PerSource<std::vector<Sequence>> sequences_of(const Passes& passes, const std::vector<std::size_t>& examples, Kind kind,
                                              const RandomStream& streams) {
  constexpr int kStarts = 4;  // within each example
  PerSource<std::vector<Sequence>> all;
  for (const std::size_t i : examples) {
    RandomStream random = streams.child(i);
    const auto& e = passes.example(i);
    // At start 0 the network sees no velocity and makes other errors. It counts for the rows from the start only.
    if (!kind.from_start && e.segments() < 2) continue;
    for (int repeat = 0; repeat < (kind.from_start ? 1 : kStarts); ++repeat) {
      Sequence s;
      s.example = i;
      s.start = kind.from_start ? 0 : 1 + random.below(e.segments() - 1);
      s.steps = e.segments() - s.start;
      s.knowledge = kind.is_known ? MaterialKnowledge::certain(e.q) : MaterialKnowledge::none();
      for (Index j = 1; j <= s.steps; ++j) s.decoded.push_back(j);
      all[passes.dataset().source(i) > 0].push_back(s);
    }
  }
  return all;
}

/// Adds the errors of the sequences' predictions to `steps`, by the number of segments.
void tally_errors(Passes& passes, const Graph& graph, const std::vector<Sequence>& sequences,
                  std::vector<SigmaTally>& steps) {
  std::vector<std::vector<SigmaTally>> of_batch(Passes::batches(sequences));
  passes.side_by_side(of_batch.size(), [&](std::size_t b) {
    const at::NoGradGuard guard;
    const Batch batch = passes.batch(sequences, b);  // one at a time: together they would hold every shape many times
    const Graph::Output out = passes.forward(graph, batch);
    const Tensor error = (out.mean - passes.target(batch)).contiguous(),
                 sigma = sigma_of(passes.model(), out.log_sigma).value.contiguous();
    const Index n = error.size(1);
    of_batch[b].resize(batch.steps.front());
    for (std::size_t w = 0; w < batch.wanted.size(); ++w) {
      of_batch[b][batch.wanted[w].step - 1].add(error.data_ptr<float>() + w * n, sigma.data_ptr<float>() + w * n, n);
    }
  });
  for (const auto& tally : of_batch) {
    steps.resize(std::max(steps.size(), tally.size()));
    for (std::size_t j = 0; j < tally.size(); ++j) steps[j].add(tally[j]);
  }
}

/// The shapes that choose sigma after j + 1 segments. Few sequences are long, so a number of segments with few shapes
/// borrows more: from the other datasets, though no more than it has itself, then from its neighbours, from theirs, and
/// so on.
/// @param enough it stops borrowing at this number of shapes.
SigmaTally with_neighbours(const PerSource<std::vector<SigmaTally>>& steps, std::size_t j, double enough) {
  SigmaTally sum;
  const auto fill = [&](const std::vector<SigmaTally>& of, std::size_t from, std::size_t to) {
    for (std::size_t reach = from; reach < to; ++reach) {
      if (reach <= j) sum.add_up_to(enough, of[j - reach]);
      if (reach > 0 && j + reach < of.size()) sum.add_up_to(enough, of[j + reach]);
    }
  };
  sum.add(steps[0][j]);
  sum.add_up_to(std::min(enough, 2.0 * sum.shapes()), steps[1][j]);
  const std::size_t near = 2 + (j + 1) / 8;
  fill(steps[0], 1, near);
  fill(steps[1], sum.shapes() > 0.0 ? 1 : 0, near);
  for (std::size_t reach = near; reach < steps[0].size(); ++reach) {
    for (const auto& of : steps) fill(of, reach, reach + 1);
  }
  return sum;
}

/// Sigma's factor and added length by the number of segments, as the model holds them.
struct Curves {
  std::vector<float> factor, added;
};

/// One row of the calibration. @param curves out.
CalibrationRow find_row(Passes& passes, const std::vector<CalibrationPart>& parts, Kind kind,
                        const RandomStream& streams, Curves& curves) {
  CalibrationRow row;
  row.from_start = kind.from_start;
  row.is_known = kind.is_known;
  PerSource<std::vector<SigmaTally>> steps;
  for (const auto& part : parts) {
    const Graph graph(passes.model(), part.weights.data(), nullptr);
    const auto sequences = sequences_of(passes, part.examples, kind, streams);
    for (int source = 0; source < 2; ++source) {
      row.predictions += sequences[source].size();
      tally_errors(passes, graph, sequences[source], steps[source]);
    }
  }
  const std::size_t longest = std::max(steps[0].size(), steps[1].size());
  for (auto& of : steps) of.resize(longest);
  const double enough = std::clamp(0.5 * row.predictions, 100.0, 1000.0);
  for (std::size_t j = 0; j < longest; ++j) {
    const SigmaTally::Choice choice = with_neighbours(steps, j, enough).choose();
    curves.factor.push_back(choice.factor);
    curves.added.push_back(choice.added);
    row.shapes.push_back(static_cast<std::int64_t>(steps[0][j].shapes()));
    row.factor.push_back(choice.factor);
    const double added_m = choice.added * kLength;
    row.added_m.push_back(std::round(1e7 * added_m) / 1e7);  // drops the rounding noise of floats
  }
  return row;
}

}  // namespace

std::vector<CalibrationRow> find_calibration(Passes& passes, Model& model, const std::vector<CalibrationPart>& parts,
                                             std::uint64_t seed) {
  const RandomStream streams(seed, kCalibrationStream);
  std::vector<CalibrationRow> rows;
  std::vector<Curves> curves;
  std::size_t longest = 1;
  for (const bool from_start : {true, false}) {
    for (const bool is_known : {true, false}) {
      rows.push_back(find_row(passes, parts, {from_start, is_known}, streams, curves.emplace_back()));
      longest = std::max(longest, curves.back().factor.size());
    }
  }
  const auto joined = [&](std::vector<float> Curves::*curve, float otherwise) {
    std::vector<float> all;
    for (auto& of : curves) {
      auto& values = of.*curve;
      values.resize(longest, values.empty() ? otherwise : values.back());
      all.insert(all.end(), values.begin(), values.end());
    }
    return all;
  };
  model.calibration = joined(&Curves::factor, 1.0f);
  model.calibration_added = joined(&Curves::added, 0.0f);
  return rows;
}

namespace {

constexpr std::size_t kFolds = 3;

/// All examples in parts, and for each part weights that were not fitted to it.
struct Folds {
  std::vector<std::vector<std::size_t>> examples;
  std::vector<std::vector<float>> weights;
};

/// Refits the sigma layer once without each fold and once to all examples. The model gets the layer fitted to all
/// examples if the other refits make their held-out folds likelier than its own layer does. Else nothing changes.
/// @return the weights with which to predict the examples for their errors.
Folds refit_sigma_layer(Passes& passes, CalibrationJob& job) {
  Folds folds;
  const auto& t = job.training;
  nlohmann::ordered_json told{{"passes", t.sigma_passes}, {"tails", t.sigma_tails}};
  bool is_better = false;
  if (t.sigma_passes > 0 && job.examples.size() >= 2 * kFolds) {
    folds.examples.resize(kFolds);
    folds.weights.resize(kFolds);
    for (std::size_t k = 0; k < job.examples.size(); ++k) folds.examples[k % kFolds].push_back(job.examples[k]);
    job.host.log(LogLevel::info, "emd: refitting the sigma layer, " + std::to_string(t.sigma_passes) + " times " +
                                     std::to_string(job.examples.size()) + " examples");
    std::vector<float> of_all;
    std::vector<double> before(kFolds), after(kFolds);
    const auto loss = [&](const std::vector<float>& weights, std::size_t fold) {
      return sigma_layer_loss(passes, weights, folds.examples[fold], t.sigma_tails, job.seed) *
             folds.examples[fold].size() / job.examples.size();
    };
    passes.side_by_side(kFolds + 1, [&](std::size_t p) {
      if (p == kFolds) {
        of_all = fit_sigma_layer(passes, job.examples, t.sigma_passes, t.sigma_tails, job.seed);
        return;
      }
      std::vector<std::size_t> others;
      for (std::size_t k = 0; k < job.examples.size(); ++k) {
        if (k % kFolds != p) others.push_back(job.examples[k]);
      }
      folds.weights[p] = fit_sigma_layer(passes, others, t.sigma_passes, t.sigma_tails, job.seed);
      before[p] = loss(job.model.weights, p);
      after[p] = loss(folds.weights[p], p);
    });
    const double was = std::accumulate(before.begin(), before.end(), 0.0),
                 is = std::accumulate(after.begin(), after.end(), 0.0);
    told["held_out_loss"] = {{"before", was}, {"after", is}};
    is_better = is < was;
    char text[160];
    std::snprintf(text, sizeof(text), "emd: sigma layer refitted: loss on held-out examples %.4f, before %.4f%s", is,
                  was, is_better ? "" : "; not better, no weight changes");
    job.host.log(LogLevel::info, text);
    if (is_better) {
      if (fits_half(job.model)) {
        for (float& w : of_all) w = round_to_half(w);
      }
      job.model.weights = std::move(of_all);
    }
  }
  told["fitted"] = is_better;
  job.report.json = nlohmann::ordered_json{{"sigma_layer", told}}.dump();
  if (!is_better) folds = {{job.examples}, {job.model.weights}};  // the old layer was not fitted to any of them
  return folds;
}

}  // namespace

void calibrate(CalibrationJob& job) {
  Passes passes(job.dataset, job.model, job.host);
  const Folds folds = refit_sigma_layer(passes, job);
  std::vector<CalibrationPart> parts;
  for (std::size_t p = 0; p < folds.examples.size(); ++p) parts.push_back({folds.examples[p], folds.weights[p]});
  job.report.examples = job.examples.size();
  job.report.rows = find_calibration(passes, job.model, parts, job.seed);
  if (job.host.cancelled()) throw Error("emd: stopped; no calibration was kept");
}

}  // namespace weft::emd
