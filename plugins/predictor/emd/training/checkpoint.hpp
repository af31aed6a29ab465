#pragma once
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "../model.hpp"

namespace weft::emd {

struct FitJob;

/// One evaluation on the validation split.
struct CurvePoint {
  std::int64_t iteration = 0;
  double training_loss = 0.0, validation_loss = 0.0, validation_error_mm = 0.0, rate = 0.0;
};

/// State of a fit between two iterations. Batches are functions of (seed, iteration). So a fit that resumes from this
/// state and the model's normalisation gives the same bits.
struct FitState {
  std::vector<float> weights, average;             ///< [Layout::size]; average: moving average of the weights
  std::vector<float> first_moment, second_moment;  ///< [Layout::size], of Adam; SignSGD has no second_moment
  std::vector<float> best_weights;                 ///< [Layout::size]; empty before the first evaluation
  std::int64_t iteration = 0;                      ///< iterations done
  std::int64_t best_iteration = 0;
  std::int64_t without_best = 0;  ///< evaluations since the best one
  double rate = 0.0;              ///< learning rate
  double time_used = 0.0;         ///< share of the time limit used up at the last evaluation, in [0, 1]
  double seconds = 0.0;           ///< spent by all processes up to the checkpoint
  std::int64_t loss_count = 0;    ///< iterations since the last evaluation
  double loss_sum = 0.0;          ///< of their training losses
  double training_loss = 0.0;     ///< their mean, at the last evaluation
  double validation_loss = 0.0, validation_error_mm = 0.0;
  double best_loss = 0.0, best_error_mm = 0.0;
  std::vector<CurvePoint> curve;

  double mean_training_loss() const { return loss_count > 0 ? loss_sum / loss_count : 0.0; }
};

/// The file from which a killed fit resumes. Without a path it does nothing.
class Checkpoint {
 public:
  /// @param train, validation numbers of examples: a checkpoint belongs to one fit, with its data and settings.
  Checkpoint(const FitJob& job, std::size_t train, std::size_t validation);
  void save(const FitState& state, const Model& model) const;
  /// Reads the state, and the normalisation into the model. @return nothing when there is no file.
  /// @throws ConfigError when the file is damaged or belongs to another fit.
  std::optional<FitState> load(Model& model) const;
  void remove() const;
  /// Data and settings of the fit.
  const std::string& identity() const { return identity_; }

 private:
  std::filesystem::path path_;
  std::string identity_;
  bool accept_changed_, has_second_moment_;
};

}  // namespace weft::emd
