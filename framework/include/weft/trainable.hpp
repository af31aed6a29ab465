#pragma once
#include <cstdint>
#include <filesystem>
#include <functional>
#include <string>

#include "weft/dataset.hpp"

namespace weft {

struct FitOptions {
  std::uint64_t seed = 0;
  std::filesystem::path model;       ///< where the best model so far is kept; always whole
  std::filesystem::path checkpoint;  ///< state for resuming: read when it exists, written now and then; empty: none
  std::string provenance;            ///< version, commit and plugins, JSON; recorded in the model
};

/// State of a running fit, for progress lines.
struct FitProgress {
  std::int64_t iteration = 0, iterations = 0;  ///< done, planned
  double seconds = 0.0, seconds_left = 0.0;    ///< of this process; estimated
  double rate = 0.0;                           ///< learning rate
  double training_loss = 0.0;                  ///< mean since the last report
  double validation_loss = 0.0, best_loss = 0.0;
  double validation_error_mm = 0.0;  ///< mean vertex error at the end of the validation sequences
};
/// @return false to stop; the checkpoint is written then.
using FitObserver = std::function<bool(const FitProgress&)>;

struct FitReport {
  std::int64_t iterations = 0;
  bool finished = false;  ///< false: stopped by the observer or the host; the same call goes on
  bool resumed = false;
  double seconds = 0.0;  ///< over all processes that took part
  double best_loss = 0.0;
  std::string json;  ///< training.json: settings, curves, what stopped it
};

/// A predictor that learns from examples. Reached through Predictor::trainable(): RTTI does not reach across plugins.
class TrainablePredictor {
 public:
  virtual ~TrainablePredictor() = default;
  /// Fits the predictor to the train split, steered by the validation split; afterwards it holds the best model.
  /// A fit that was killed goes on from its checkpoint, and without a time limit ends with the same bits.
  /// @throws ConfigError when data and task do not fit, or a checkpoint belongs to another fit; Unsupported.
  virtual FitReport fit(const Dataset& dataset, const Task& task, const FitOptions& options,
                        const FitObserver& observer) = 0;
  virtual void save(const std::filesystem::path& file) const = 0;
  /// @throws ConfigError for a damaged file.
  virtual void load(const std::filesystem::path& file) = 0;
  /// The datasets that the model it holds was fitted to; empty when there is none, or it does not say.
  virtual std::vector<DatasetOrigin> trained_on() const { return {}; }
};

}  // namespace weft
