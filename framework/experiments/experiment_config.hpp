#pragma once
#include "experiments/prediction_evaluation.hpp"
#include "learning/budget.hpp"
#include "learning/generate.hpp"
#include "session/session.hpp"

namespace weft {

/// An experiment file: a task (usually by `extends:`), its data and its evaluation. `weft generate`, `train` and
/// `evaluate` read the same file, so that one file is enough to learn a garment.
struct ExperimentParams : SessionParams {
  DataParams data;
  std::filesystem::path dataset;
  PredictionEvaluationParams evaluation;
  LearnParams learn;

  template <class Visitor>
  void visit(Visitor& v) {
    SessionParams::visit(v);
    v.group("data", data, "The distribution of the examples.", Decides::examples);
    v("dataset", dataset, "Folder of the examples, for commands that read them.");
    v.group("evaluation", evaluation, "Settings of `weft evaluate prediction`.");
    v.group("learn", learn, "Numbers of `weft learn`.", Decides::nothing);
  }
};

}  // namespace weft
