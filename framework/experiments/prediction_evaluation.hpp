#pragma once
#include <functional>
#include <map>
#include <string>
#include <vector>

#include "experiments/prediction_figures.hpp"
#include "processes/work_status.hpp"
#include "weft/dataset.hpp"
#include "weft/host.hpp"
#include "weft/params.hpp"
#include "weft/predictor.hpp"
#include "weft/task.hpp"

namespace weft {

/// Settings of `weft evaluate prediction`.
struct PredictionEvaluationParams {
  std::string split = "test";
  std::int64_t max_examples = 0;
  std::int64_t batch = 16;
  std::int64_t random_starts = 4;
  bool baselines = true;
  std::int64_t linear_components = 32;

  template <class Visitor>
  void visit(Visitor& v) {
    v("split", split, choice({"train", "validation", "test", "all"}),
      "Examples to predict; `all` is for datasets that the model was neither trained nor calibrated on.");
    v("max_examples", max_examples, range(0, 1e9), "Largest number of these examples; 0: all.", Decides::nothing);
    v("batch", batch, range(1, 4096), "Cases per call of the predictor.");
    v("random_starts", random_starts, range(1, 200),
      "Number of start segments per example for predictions that begin after its first segment.");
    v("baselines", baselines,
      "Also measure the baselines. Those that learn from the train split are left out if it is the split to predict.");
    v("linear_components", linear_components, range(1, 512), "PCA components of the linear baseline.");
  }
};

/// A released example, predicted from its start with known material.
struct PredictedExample {
  std::int64_t index = 0;  ///< in the dataset
  Index segments = 0;      ///< predicted ahead
  double error_mm = 0.0;   ///< mean vertex distance of the settled shape
  /// Mean over the vertices of the root of their three summed variances. If sigma is right, error_mm is near it.
  double sigma_mm = 0.0;
};

/// Where a prediction begins.
struct PredictionStart {
  std::size_t example = 0;  ///< position in the dataset
  Index segment = 0;
};
/// The prediction of the rest of an example, compared with the recorded shapes.
struct ScoredPrediction {
  std::string failure;                 ///< why there is none; empty: there is one
  std::vector<PredictionScore> steps;  ///< after 1, 2, ... segments
  double settled_sigma_mm = 0.0;       ///< of the last shape, see PredictedExample::sigma_mm
  Positions settled;                   ///< mean of the last shape; empty unless it was asked for
};
struct ScoredBatch {
  std::vector<ScoredPrediction> cases;  ///< one per start; empty: the process that predicted them failed
  double seconds = 0.0;                 ///< inside predict()
  WorkFailure failure = {WorkStatus::done, ""};
};
struct PredictionBatch {
  std::vector<PredictionStart> starts;
  bool has_knowledge = false;
  bool wants_shapes = false;  ///< ScoredPrediction::settled
};
/// Predicts a batch: in this process, or in another one.
using PredictBatch = std::function<ScoredBatch(const PredictionBatch& batch)>;
/// The first. @param dataset whose examples the starts name.
ScoredBatch predict_batch(const Predictor& predictor, const Dataset& dataset, const PredictionBatch& batch);

/// A batch whose process crashed or hung.
struct FailedBatch {
  WorkFailure failure;
  std::size_t cases = 0;
};

struct PredictionEvaluation {
  PredictionFigures from_start, from_random, no_knowledge;  ///< the settled shape
  std::vector<PredictionFigures> by_step, by_step_from_random, by_step_no_knowledge;
  std::map<std::string, PredictionFigures> baselines;  ///< settled shape; only n, mean_mm and median_mm
  Index failed = 0;                                    ///< cases without a prediction
  std::vector<FailedBatch> failures;                   ///< among them, those whose process failed
  Index shortened = 0;   ///< cases longer than the predictor's max_segments(), so not predicted to their end
  double seconds = 0.0;  ///< inside predict()
  std::vector<PredictedExample> examples;     ///< those in from_start
  std::vector<Positions> settled, predicted;  ///< of the first examples, for the page
};

/// Measures a bound predictor on a split of a dataset. The figures include the paper's accuracy claims for its network.
/// @param predict predicts the batches; empty: this process does. A batch whose process fails costs its cases.
/// @throws ConfigError if the split is empty.
PredictionEvaluation evaluate_prediction(const Predictor& predictor, const Task& task, const Dataset& dataset,
                                         const PredictionEvaluationParams& params, std::uint64_t seed, Host& host,
                                         PredictBatch predict = {});
/// prediction.json (docs/file-formats.md).
std::string prediction_evaluation_json(const PredictionEvaluation& result);
/// Its times, for times.json.
std::string prediction_times_json(const PredictionEvaluation& result);
/// cases.h5 of the page: settled and predicted shapes of the first of prediction.json's `cases`.
void write_prediction_shapes(const PredictionEvaluation& result, const Garment& garment,
                             const std::filesystem::path& file);
std::string prediction_evaluation_csv(const PredictionEvaluation& result);

}  // namespace weft
