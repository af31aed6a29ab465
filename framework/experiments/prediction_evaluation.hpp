#pragma once
#include <map>
#include <string>
#include <vector>

#include "experiments/prediction_figures.hpp"
#include "weft/dataset.hpp"
#include "weft/host.hpp"
#include "weft/params.hpp"
#include "weft/predictor.hpp"
#include "weft/task.hpp"

namespace weft {

/// What `weft evaluate prediction` measures.
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
    v("max_examples", max_examples, range(0, 1e9), "Use that many of them; 0: all.", Decides::nothing);
    v("batch", batch, range(1, 4096), "Cases per call of the predictor.");
    v("random_starts", random_starts, range(1, 200),
      "Segments of an example that predictions from within it begin with: as many as it has, not its first.");
    v("baselines", baselines,
      "Also measure the baselines; those that learn from the train split only where it is not what is predicted.");
    v("linear_components", linear_components, range(1, 512), "PCA components of the linear baseline.");
  }
};

/// A released example, predicted from its start with its material known.
struct PredictedExample {
  std::int64_t index = 0;  ///< in the dataset
  Index segments = 0;      ///< predicted ahead
  double error_mm = 0.0;   ///< mean vertex distance of the settled shape
  double sigma_mm =
      0.0;  ///< root of a vertex's three variances, its mean over the vertices: what error_mm should be like
};

struct PredictionEvaluation {
  PredictionFigures from_start, from_random, no_knowledge;  ///< the settled shape
  std::vector<PredictionFigures> by_step, by_step_from_random, by_step_no_knowledge;
  std::map<std::string, PredictionFigures> baselines;  ///< settled shape; only n, mean_mm and median_mm
  Index failed = 0;                                    ///< cases that the predictor could not predict
  Index shortened = 0;   ///< cases that go on beyond the predictor's max_segments(): not predicted to their end
  double seconds = 0.0;  ///< inside predict()
  std::vector<PredictedExample> examples;     ///< those that from_start counts
  std::vector<Positions> settled, predicted;  ///< of the first examples, for the page
};

/// Measures a bound predictor on a split of a dataset: the paper's accuracy claims for its network, and more.
/// @throws ConfigError when the split is empty.
PredictionEvaluation evaluate_prediction(const Predictor& predictor, const Task& task, const Dataset& dataset,
                                         const PredictionEvaluationParams& params, std::uint64_t seed, Host& host);
/// prediction.json (design section 5; docs/file-formats.md).
std::string prediction_evaluation_json(const PredictionEvaluation& result);
/// cases.h5 of the page: settled and predicted shapes of the first of prediction.json's `cases`.
void write_prediction_shapes(const PredictionEvaluation& result, const Garment& garment,
                             const std::filesystem::path& file);
std::string prediction_evaluation_csv(const PredictionEvaluation& result);

}  // namespace weft
