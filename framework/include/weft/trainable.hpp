#pragma once
#include <cstdint>
#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "weft/dataset.hpp"
#include "weft/predictor.hpp"

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

struct CalibrationOptions {
  std::uint64_t seed = 0;
  std::filesystem::path model;  ///< where the model is written with its new calibration; whole or absent
};

/// What was found for predictions of one kind: sigma' = factor sqrt(sigma^2 + added^2), by the number of segments.
struct CalibrationRow {
  bool from_start = true;  ///< from the start of a session, or from within one
  bool is_known = true;    ///< material known exactly, or not at all
  std::int64_t predictions = 0;
  std::vector<std::int64_t> shapes;     ///< [segments] shapes of the first dataset that were compared
  std::vector<double> factor, added_m;  ///< [segments]; m
};

struct CalibrationReport {
  std::int64_t examples = 0;
  std::vector<CalibrationRow> rows;
  std::string json;  ///< what else the predictor has to say of it, a JSON object; empty: nothing
};

/// A predictor that learns from examples. Reached through Predictor::trainable(): RTTI does not reach across plugins.
class WEFT_API TrainablePredictor {
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
  /// Finds anew how wide the sigma of the model that it holds must be, on these examples alone; the means that it
  /// predicts stay. What is found is to hold for the first of the datasets; the others help out where it has too few
  /// shapes. Writes the model to options.model and holds it afterwards.
  /// @param examples positions in dataset.examples, ascending; as of Dataset::unseen(trained_on()).
  /// @throws ConfigError when this predictor cannot do that, holds no model, or data and task do not fit; Unsupported.
  virtual CalibrationReport calibrate(const Dataset& dataset, const std::vector<std::size_t>& examples,
                                      const Task& task, const CalibrationOptions& options);
  /// The datasets of the last calibrate() of the model it holds; empty when its calibration is the fit's own.
  virtual std::vector<DatasetOrigin> calibrated_on() const { return {}; }
};

}  // namespace weft
