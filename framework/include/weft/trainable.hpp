#pragma once
#include <cstdint>
#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "weft/dataset.hpp"
#include "weft/predictor.hpp"

namespace weft {

/// Processes ("ranks") that fit one model together, as one of them sees them. All of them see one file system.
struct FitRanks {
  int rank = 0, size = 1;
  std::filesystem::path meeting;  ///< file in which rank 0 says where it is reached; one for each start of the ranks
  bool is_one_machine = false;    ///< they talk over loopback
  std::string interface;          ///< network interface for the others; empty: that of the host name
};

struct FitOptions {
  std::uint64_t seed = 0;
  std::filesystem::path model;       ///< file of the best model so far; whole or absent
  std::filesystem::path checkpoint;  ///< state for resuming: read if it exists, rewritten regularly; empty: none
  std::string provenance;            ///< version, commit and plugins, JSON; recorded in the model
  bool accept_changed = false;       ///< go on from a checkpoint of other settings or data, if its sizes fit
  FitRanks ranks;                    ///< only rank 0 writes files and calls the observer
};

/// What fit() of a predictor can do besides.
struct TrainingCapabilities {
  bool ranks = false;          ///< several processes fit one model
  bool stored_shapes = false;  ///< reads shapes by Example::read_shapes(), so that they need not be in memory
  std::int64_t parts = 0;      ///< parts of a batch, of which each rank takes the same number; 0: any number of ranks
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
/// @return false to stop. The fit then writes its checkpoint.
using FitObserver = std::function<bool(const FitProgress&)>;

struct FitReport {
  std::int64_t iterations = 0;
  bool finished = false;  ///< false: the observer or the host stopped it; the same call resumes
  bool resumed = false;
  double seconds = 0.0;  ///< sum over the processes of a resumed fit
  double best_loss = 0.0;
  std::string json;  ///< training.json: settings, curves, what stopped it
};

struct CalibrationOptions {
  std::uint64_t seed = 0;
  std::filesystem::path model;  ///< file for the calibrated model; whole or absent
};

/// The calibration of one kind of prediction: sigma' = factor sqrt(sigma^2 + added^2), per number of segments.
struct CalibrationRow {
  bool from_start = true;  ///< predictions from the start of a session; false: from later in it
  bool is_known = true;    ///< material known exactly; false: not at all
  std::int64_t predictions = 0;
  std::vector<std::int64_t> shapes;     ///< [segments] number of compared shapes from the first dataset
  std::vector<double> factor, added_m;  ///< [segments]; m
};

struct CalibrationReport {
  std::int64_t examples = 0;
  std::vector<CalibrationRow> rows;
  std::string json;  ///< further results as a JSON object, or empty
};

/// A predictor that learns from examples. Predictor::trainable() returns it, since RTTI fails across plugins.
class WEFT_API TrainablePredictor {
 public:
  virtual ~TrainablePredictor() = default;
  virtual TrainingCapabilities training_capabilities() const { return {}; }
  /// Fits the predictor to the train split. Afterwards it holds the model with the lowest loss on the validation split.
  /// A killed fit resumes from its checkpoint. Without a time limit it ends with the same bits. Over ranks all call it
  /// alike, and rank 0 gets the model of one process, bit for bit; any number of ranks resumes.
  /// @throws ConfigError if data and task do not match, or a checkpoint belongs to another fit; Unsupported;
  /// Error when another rank has died.
  virtual FitReport fit(const Dataset& dataset, const Task& task, const FitOptions& options,
                        const FitObserver& observer) = 0;
  virtual void save(const std::filesystem::path& file) const = 0;
  /// @throws ConfigError for a damaged file.
  virtual void load(const std::filesystem::path& file) = 0;
  /// The datasets that the current model was fitted to; empty if there is no model or its file does not list them.
  virtual std::vector<DatasetOrigin> trained_on() const { return {}; }
  /// Refits sigma on these examples. The means do not change. The calibration is for the first dataset; the others fill
  /// in where it has too few shapes. Writes the calibrated model to options.model and keeps it as the current one.
  /// @param examples positions in dataset.examples, ascending, such as those the model was not trained on.
  /// @throws ConfigError if this predictor cannot be calibrated or holds no model, or if data and task do not match;
  /// Unsupported.
  virtual CalibrationReport calibrate(const Dataset& dataset, const std::vector<std::size_t>& examples,
                                      const Task& task, const CalibrationOptions& options);
  /// The datasets of the current model's last calibrate(); empty if it still has the calibration of fit().
  virtual std::vector<DatasetOrigin> calibrated_on() const { return {}; }
};

}  // namespace weft
