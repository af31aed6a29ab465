// The calibration pass: what a model predicts of examples beside what became of them, and the factors and lengths that
// follow. Part of the training library; libtorch runs the network.
#include "calibration.hpp"

#include <algorithm>
#include <cmath>

#include "passes.hpp"
#include "training.hpp"
#include "weft/random.hpp"

namespace weft::emd {

std::vector<CalibrationRow> find_calibration(Passes& passes, Model& model, const std::vector<float>& weights,
                                             const std::vector<std::size_t>& examples, std::uint64_t seed) {
  constexpr int kStarts = 4;
  const Graph graph(model, weights.data(), nullptr);
  const RandomStream streams(seed, 0x63616c6962ull);
  std::vector<CalibrationRow> rows;
  std::vector<std::vector<float>> factors, added;
  std::size_t longest = 1;
  for (const bool from_start : {true, false}) {
    for (const bool is_certain : {true, false}) {
      // Further datasets are of other distributions; what is predicted is of the first one's.
      std::vector<Sequence> all[2];  // of the first dataset, of the others
      for (const std::size_t i : examples) {
        RandomStream random = streams.child(i);
        const auto& e = passes.example(i);
        // From start 0 the network sees no velocity, and its errors are others: that is the first rows' alone.
        if (!from_start && e.segments() < 2) continue;
        for (int repeat = 0; repeat < (from_start ? 1 : kStarts); ++repeat) {
          Sequence s;
          s.example = i;
          s.start = from_start ? 0 : 1 + static_cast<Index>(random.below(static_cast<std::uint64_t>(e.segments() - 1)));
          s.steps = e.segments() - s.start;
          s.knowledge = is_certain ? MaterialKnowledge::certain(e.q) : MaterialKnowledge::none();
          for (Index j = 1; j <= s.steps; ++j) s.decoded.push_back(j);
          all[passes.dataset().source(i) > 0].push_back(s);
        }
      }
      std::vector<SigmaTally> steps[2];
      for (int other = 0; other < 2; ++other) {
        std::vector<std::vector<SigmaTally>> parts(Passes::batches(all[other]));
        passes.side_by_side(parts.size(), [&](std::size_t b) {
          const at::NoGradGuard guard;
          const Batch batch = passes.batch(all[other], b);  // one at a time: all of them would be all shapes many times
          const Graph::Output out = passes.forward(graph, batch);
          const Tensor error = (out.mean - passes.target(batch)).contiguous(),
                       sigma = passes.sigma_of(out).contiguous();
          const Index n = error.size(1);
          parts[b].resize(batch.running.size());
          for (std::size_t w = 0; w < batch.wanted.size(); ++w) {
            const auto at = static_cast<Index>(w) * n;
            parts[b][static_cast<std::size_t>(batch.wanted[w].step) - 1].add(error.data_ptr<float>() + at,
                                                                             sigma.data_ptr<float>() + at, n);
          }
        });
        for (const auto& part : parts) {
          for (auto& to : steps) to.resize(std::max(to.size(), part.size()));
          for (std::size_t j = 0; j < part.size(); ++j) steps[other][j].add(part[j]);
        }
      }
      // Few sequences are long: a number of segments with few shapes borrows from the other datasets and then from
      // its neighbours.
      const double enough = std::clamp(0.5 * static_cast<double>(all[0].size() + all[1].size()), 100.0, 400.0);
      const auto around = [&](std::size_t j) {
        SigmaTally sum = steps[0][j];
        if (sum.shapes() < enough) sum.add(steps[1][j]);
        for (std::size_t reach = 1; sum.shapes() < enough && reach < steps[0].size(); ++reach) {
          for (const auto& of : steps) {
            if (reach <= j) sum.add(of[j - reach]);
            if (j + reach < of.size()) sum.add(of[j + reach]);
          }
        }
        return sum;
      };
      auto& factor_curve = factors.emplace_back();
      auto& added_curve = added.emplace_back();
      auto& row = rows.emplace_back();
      row.from_start = from_start;
      row.is_known = is_certain;
      row.predictions = static_cast<std::int64_t>(all[0].size() + all[1].size());
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

}  // namespace weft::emd

extern "C" WEFT_API void weft_emd_calibrate(weft::emd::CalibrationJob& job) {
  using namespace weft::emd;
  translated([&] {
    Passes passes(job.dataset, job.model, job.host);
    job.rows = find_calibration(passes, job.model, job.model.weights, job.examples, job.seed);
    if (job.host.cancelled()) throw weft::Error("emd: stopped; no calibration was kept");
  });
}
