#pragma once
#include "experiments/prediction_evaluation.hpp"
#include "learning/generate.hpp"
#include "session/session.hpp"

namespace weft {

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
