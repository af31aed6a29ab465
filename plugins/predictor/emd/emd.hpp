#pragma once
#include <memory>
#include <mutex>

#include "inputs.hpp"
#include "network.hpp"
#include "weft/host.hpp"
#include "weft/trainable.hpp"

namespace weft::emd {

/// The learned predictor (section 2.3), after the EM*D family: an encoder, a recurrent prediction module, and a decoder
/// to mean and sigma. Prediction and its derivatives are written by hand and need no library. Only training and
/// calibration need libtorch, and only they load it.
class EmdPredictor final : public Predictor, public TrainablePredictor {
 public:
  EmdPredictor(const Params& params, Host& host) : params_(params), host_(host) {}
  PredictorCapabilities capabilities() const override;
  /// @throws ConfigError when there is no model or it does not fit the task.
  void bind(const Task& task) override;
  std::unique_ptr<Prediction> predict(const std::vector<PredictionCase>& cases,
                                      const PredictionRequest& request) const override;
  std::optional<Box> control_range() const override;
  TrainablePredictor* trainable() override { return this; }
  TrainingCapabilities training_capabilities() const override {
    return {.ranks = true, .stored_shapes = true, .parts = params_.training.batch_parts()};
  }

  FitReport fit(const Dataset& dataset, const Task& task, const FitOptions& options,
                const FitObserver& observer) override;
  void save(const std::filesystem::path& file) const override;
  void load(const std::filesystem::path& file) override;
  std::vector<DatasetOrigin> trained_on() const override;
  CalibrationReport calibrate(const Dataset& dataset, const std::vector<std::size_t>& examples, const Task& task,
                              const CalibrationOptions& options) override;
  std::vector<DatasetOrigin> calibrated_on() const override;

  /// Everything that predictions share and keep alive.
  struct Bound {
    Task task;
    std::shared_ptr<const Model> model;
    std::unique_ptr<const Network> network;
  };

 private:
  Params params_;
  Host& host_;
  std::shared_ptr<const Model> model_;
  std::shared_ptr<const Bound> bound_;
};

}  // namespace weft::emd
