#pragma once
#include "learning/generate.hpp"
#include "session/session.hpp"

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

/// An experiment file: a task (usually by `extends:`) and what to do with it. Generate, train and evaluate read the
/// same file, so that a garment is learned with one file.
struct ExperimentParams : SessionParams {
  DataParams data;
  std::filesystem::path dataset;
  PredictionEvaluationParams evaluation;

  template <class Visitor>
  void visit(Visitor& v) {
    SessionParams::visit(v);
    v.group("data", data, "How examples are made.", Decides::examples);
    v("dataset", dataset, "Folder of the examples, for commands that read them.");
    v.group("evaluation", evaluation, "What `weft evaluate prediction` measures.");
  }
};

}  // namespace weft
