// The calibration pass: what a model predicts of examples beside what became of them, and the factors and lengths that
// follow. Part of the training library; libtorch runs the network.
#include "calibration.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <nlohmann/json.hpp>
#include <numeric>

#include "../model_file.hpp"
#include "../training_library.hpp"
#include "passes.hpp"
#include "sigma_layer.hpp"
#include "weft/random.hpp"

namespace weft::emd {

std::vector<CalibrationRow> find_calibration(Passes& passes, Model& model, const std::vector<CalibrationPart>& parts,
                                             std::uint64_t seed) {
  constexpr int kStarts = 4;
  const RandomStream streams(seed, 0x63616c6962ull);
  std::vector<CalibrationRow> rows;
  std::vector<std::vector<float>> factors, added;
  std::size_t longest = 1;
  for (const bool from_start : {true, false}) {
    for (const bool is_certain : {true, false}) {
      // Further datasets are of other distributions; what is predicted is of the first one's.
      std::vector<SigmaTally> steps[2];  // of the first dataset, of the others
      std::int64_t predictions = 0;
      for (const auto& part : parts) {
        const Graph graph(model, part.weights.data(), nullptr);
        std::vector<Sequence> all[2];
        for (const std::size_t i : part.examples) {
          RandomStream random = streams.child(i);
          const auto& e = passes.example(i);
          // From start 0 the network sees no velocity, and its errors are others: that is the first rows' alone.
          if (!from_start && e.segments() < 2) continue;
          for (int repeat = 0; repeat < (from_start ? 1 : kStarts); ++repeat) {
            Sequence s;
            s.example = i;
            s.start =
                from_start ? 0 : 1 + static_cast<Index>(random.below(static_cast<std::uint64_t>(e.segments() - 1)));
            s.steps = e.segments() - s.start;
            s.knowledge = is_certain ? MaterialKnowledge::certain(e.q) : MaterialKnowledge::none();
            for (Index j = 1; j <= s.steps; ++j) s.decoded.push_back(j);
            all[passes.dataset().source(i) > 0].push_back(s);
          }
        }
        for (int other = 0; other < 2; ++other) {
          predictions += static_cast<std::int64_t>(all[other].size());
          std::vector<std::vector<SigmaTally>> tallies(Passes::batches(all[other]));
          passes.side_by_side(tallies.size(), [&](std::size_t b) {
            const at::NoGradGuard guard;
            const Batch batch =
                passes.batch(all[other], b);  // one at a time: all of them would be all shapes many times
            const Graph::Output out = passes.forward(graph, batch);
            const Tensor error = (out.mean - passes.target(batch)).contiguous(),
                         sigma = passes.sigma_of(out).contiguous();
            const Index n = error.size(1);
            tallies[b].resize(batch.running.size());
            for (std::size_t w = 0; w < batch.wanted.size(); ++w) {
              const auto at = static_cast<Index>(w) * n;
              tallies[b][static_cast<std::size_t>(batch.wanted[w].step) - 1].add(error.data_ptr<float>() + at,
                                                                                 sigma.data_ptr<float>() + at, n);
            }
          });
          for (const auto& tally : tallies) {
            for (auto& to : steps) to.resize(std::max(to.size(), tally.size()));
            for (std::size_t j = 0; j < tally.size(); ++j) steps[other][j].add(tally[j]);
          }
        }
      }
      // Few sequences are long: a number of segments with few shapes borrows from the other datasets, though no more
      // than it has itself, then from its neighbours, from theirs, and from farther off.
      const double enough = std::clamp(0.5 * static_cast<double>(predictions), 100.0, 1000.0);
      const auto around = [&](std::size_t j) {
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
      };
      auto& factor_curve = factors.emplace_back();
      auto& added_curve = added.emplace_back();
      auto& row = rows.emplace_back();
      row.from_start = from_start;
      row.is_known = is_certain;
      row.predictions = predictions;
      for (std::size_t j = 0; j < steps[0].size(); ++j) {
        const SigmaTally::Choice choice = around(j).choose();
        factor_curve.push_back(choice.factor);
        added_curve.push_back(choice.added);
        row.shapes.push_back(static_cast<std::int64_t>(steps[0][j].shapes()));
        row.factor.push_back(static_cast<double>(choice.factor));
        const double added_m = static_cast<double>(choice.added * kLength);
        row.added_m.push_back(std::round(1e7 * added_m) / 1e7);  // without the noise of floats
      }
      longest = std::max(longest, factor_curve.size());
    }
  }
  const auto joined = [&](std::vector<std::vector<float>>& curves, float otherwise) {
    std::vector<float> out;
    for (auto& curve : curves) {
      curve.resize(longest, curve.empty() ? otherwise : curve.back());
      out.insert(out.end(), curve.begin(), curve.end());
    }
    return out;
  };
  model.calibration = joined(factors, 1.0f);
  model.calibration_added = joined(added, 0.0f);
  return rows;
}

namespace {

constexpr std::size_t kFolds = 3;

/// All examples in parts, and for each part weights that its examples had no share in.
struct Folds {
  std::vector<std::vector<std::size_t>> examples;
  std::vector<std::vector<float>> weights;
};

/// Fits the model's sigma layer anew, to all but each fold in turn and to all of the examples; the model keeps the last
/// one when examples of the folds are likelier by the others than they were.
Folds refit_sigma_layer(Passes& passes, CalibrationJob& job) {
  Folds folds;
  const auto& t = job.training;
  nlohmann::ordered_json told{{"passes", t.sigma_passes}, {"tails", t.sigma_tails}};
  bool is_better = false;
  if (t.sigma_passes > 0 && job.examples.size() >= 2 * kFolds) {
    folds.examples.resize(kFolds);
    folds.weights.resize(kFolds);
    for (std::size_t k = 0; k < job.examples.size(); ++k) folds.examples[k % kFolds].push_back(job.examples[k]);
    job.host.log(LogLevel::info, "emd: fitting the sigma layer anew, " + std::to_string(t.sigma_passes) + " times " +
                                     std::to_string(job.examples.size()) + " examples");
    std::vector<float> of_all;
    std::vector<double> before(kFolds), after(kFolds);
    const auto loss = [&](const std::vector<float>& weights, std::size_t fold) {
      return sigma_layer_loss(passes, job.model, weights, folds.examples[fold], t.sigma_tails, job.seed) *
             static_cast<double>(folds.examples[fold].size()) / static_cast<double>(job.examples.size());
    };
    passes.side_by_side(kFolds + 1, [&](std::size_t p) {
      if (p == kFolds) {
        of_all = fit_sigma_layer(passes, job.model, job.examples, t.sigma_passes, t.sigma_tails, job.seed);
        return;
      }
      std::vector<std::size_t> others;
      for (std::size_t k = 0; k < job.examples.size(); ++k) {
        if (k % kFolds != p) others.push_back(job.examples[k]);
      }
      folds.weights[p] = fit_sigma_layer(passes, job.model, others, t.sigma_passes, t.sigma_tails, job.seed);
      before[p] = loss(job.model.weights, p);
      after[p] = loss(folds.weights[p], p);
    });
    const double was = std::accumulate(before.begin(), before.end(), 0.0),
                 is = std::accumulate(after.begin(), after.end(), 0.0);
    told["held_out_loss"] = {{"before", was}, {"after", is}};
    is_better = is < was;
    char text[160];
    std::snprintf(text, sizeof(text), "emd: sigma layer fitted anew: loss on held-out examples %.4f, before %.4f%s", is,
                  was, is_better ? "" : "; not better, all weights stay");
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
  if (!is_better) folds = {{job.examples}, {job.model.weights}};  // which none of them had a share in
  return folds;
}

}  // namespace
}  // namespace weft::emd

extern "C" WEFT_API void weft_emd_calibrate(weft::emd::CalibrationJob& job) {
  using namespace weft::emd;
  translated([&] {
    Passes passes(job.dataset, job.model, job.host);
    const Folds folds = refit_sigma_layer(passes, job);
    std::vector<CalibrationPart> parts;
    for (std::size_t p = 0; p < folds.examples.size(); ++p) parts.push_back({folds.examples[p], folds.weights[p]});
    job.report.examples = static_cast<std::int64_t>(job.examples.size());
    job.report.rows = find_calibration(passes, job.model, parts, job.seed);
    if (job.host.cancelled()) throw weft::Error("emd: stopped; no calibration was kept");
  });
}
