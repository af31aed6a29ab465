#pragma once
#include <cstdint>
#include <string>
#include <vector>

#include "context.hpp"
#include "experiments/prediction_evaluation.hpp"
#include "learning/generate.hpp"
#include "paper_options.hpp"
#include "weft/trainable.hpp"
#include "work_options.hpp"

/// What `weft generate`, `train`, `calibrate` and `evaluate prediction` do, for their command lines and for `weft learn`. Each
/// takes --out, --set, --seed and the like from the context, and returns the exit code of its command.
namespace weft::app {

struct GenerateCall {
  std::string config;
  std::int64_t examples = 0;
  std::string shard = {};  ///< --shard i/n; empty: all
  WorkOptions work = {};
  GenerateProgress progress = {};  ///< empty: lines are printed
};
/// @param report gets what was made, unless it is null.
int make_examples(Context& context, const GenerateCall& call, GenerateReport* report = nullptr);

struct TrainCall {
  std::string config;
  std::vector<std::string> data;  ///< folders; empty: `dataset` of the config
  ClusterOptions cluster = {};
  int ranks = 1;
  bool in_memory = false;     ///< shapes are read at once, not example by example
  FitObserver progress = {};  ///< empty: lines are printed
};
int train_model(Context& context, const TrainCall& call);

struct CalibrateCall {
  std::string config;
  std::vector<std::string> data;
  ClusterOptions cluster = {};
};
int calibrate_model(Context& context, const CalibrateCall& call);

struct PredictionCall {
  std::string config;
  std::vector<std::string> data;  ///< folders; empty: `dataset` of the config
  WorkOptions work = {};
  PaperOptions paper = {};
};
/// @param figures gets what was measured, unless it is null.
int evaluate_predictor(Context& context, const PredictionCall& call, PredictionEvaluation* figures = nullptr);

}  // namespace weft::app
