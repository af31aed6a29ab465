#include <optional>

#include "loader/checked.hpp"
#include "loader/guard.hpp"
#include "weft/predictor.hpp"
#include "weft/trainable.hpp"

namespace weft {
namespace {

/// The sizes that results for a case must have.
struct CaseSizes {
  Index rows, columns;  // of the controls
  Index states;         // of the control state
  Index segments;       // requested shapes
};

/// What a Prediction of a plugin must look like.
struct PredictionSizes {
  std::vector<CaseSizes> cases;
  Index vertices = 0;
  bool has_sigma = true, has_state_gradients = false, has_shape_gradients = false;
};

PredictionSizes sizes_of(const std::vector<PredictionCase>& cases, const PredictionRequest& request,
                         const PredictorCapabilities& capabilities) {
  PredictionSizes sizes;
  for (const auto& one : cases) {
    sizes.cases.push_back(
        {one.controls.rows(), one.controls.cols(), one.state.size(), static_cast<Index>(one.segments.size())});
    if (one.shape) sizes.vertices = one.shape->rows();
  }
  sizes.has_sigma = request.moments == Moments::mean_and_sigma;
  sizes.has_state_gradients = request.state_gradients && capabilities.state_gradients;
  sizes.has_shape_gradients = request.shape_gradients && capabilities.shape_gradients;
  return sizes;
}

bool all_finite_cotangent(const std::vector<ShapeCotangent>& cotangents) {
  for (const auto& c : cotangents)
    if (!all_finite(c.mean) || !all_finite(c.sigma)) return false;
  return true;
}

class CheckedPrediction final : public Prediction {
 public:
  /// Checks the shapes at once. @param keep keeps the predictor's library loaded.
  CheckedPrediction(const Guard& guard, std::unique_ptr<Prediction> plugin, PredictionSizes sizes,
                    std::shared_ptr<const void> keep)
      : guard_(guard), keep_(std::move(keep)), sizes_(std::move(sizes)), plugin_(std::move(plugin)) {
    if (!plugin_) guard_.fail("predict() returned no prediction");
    const auto& shapes = plugin_->shapes();
    guard_.want_size("the list of cases from predict()", std::ssize(shapes), std::ssize(sizes_.cases));
    for (std::size_t i = 0; i < shapes.size(); ++i) {
      failed_.push_back(!plugin_->failure(i).empty());
      guard_.want_size("the list of shapes of a case from predict()", std::ssize(shapes[i]),
                       failed_[i] ? 0 : sizes_.cases[i].segments);
      for (const auto& shape : shapes[i]) check(shape);
    }
  }

  const std::vector<std::vector<ShapeDistribution>>& shapes() const override {
    return guard_.call(
        "shapes()", [&]() -> const auto& { return plugin_->shapes(); });
  }
  const std::string& failure(std::size_t i) const override {
    return guard_.call(
        "failure()", [&]() -> const auto& { return plugin_->failure(i); });
  }

  std::vector<CaseGradient> pullback(const std::vector<std::vector<ShapeCotangent>>& cotangents) const override {
    guard_.want_from_caller("cotangents, counted in cases,", std::ssize(cotangents), std::ssize(sizes_.cases));
    return guard_.call("pullback()", [&] {
      auto gradients = plugin_->pullback(cotangents);
      guard_.want_size("the list of gradients from pullback()", std::ssize(gradients), std::ssize(sizes_.cases));
      for (std::size_t i = 0; i < gradients.size(); ++i)
        if (!failed_[i]) check(gradients[i], sizes_.cases[i], cotangents[i]);
      return gradients;
    });
  }

  std::vector<std::vector<std::vector<ShapeCotangent>>> jvp(
      const std::vector<std::vector<CaseDirection>>& directions) const override {
    guard_.want_from_caller("directions, counted in cases,", std::ssize(directions), std::ssize(sizes_.cases));
    return guard_.call("jvp()", [&] {
      auto slopes = plugin_->jvp(directions);
      guard_.want_size("the list of cases from jvp()", std::ssize(slopes), std::ssize(sizes_.cases));
      for (std::size_t i = 0; i < slopes.size(); ++i) {
        if (failed_[i]) continue;
        guard_.want_size("the list of directions from jvp()", std::ssize(slopes[i]), std::ssize(directions[i]));
        for (const auto& direction : slopes[i]) {
          guard_.want_size("the list of shapes from jvp()", std::ssize(direction), sizes_.cases[i].segments);
          for (const auto& slope : direction) check(slope);
        }
      }
      return slopes;
    });
  }

 private:
  void check(const ShapeDistribution& shape) const {
    guard_.want_size("a mean from predict(), counted in rows,", shape.mean.rows(), sizes_.vertices);
    guard_.want_size("a sigma from predict(), counted in rows,", shape.sigma.rows(),
                     sizes_.has_sigma ? sizes_.vertices : 0);
    guard_.want_finite("a mean from predict()", shape.mean);
    guard_.want_finite("a sigma from predict()", shape.sigma);
    if (shape.sigma.size() > 0 && !(shape.sigma.minCoeff() > 0.0)) guard_.fail("a sigma from predict() is not > 0");
  }
  void check(const CaseGradient& gradient, const CaseSizes& one, const std::vector<ShapeCotangent>& cotangents) const {
    guard_.want_size("d controls from pullback(), counted in rows,", gradient.controls.rows(), one.rows);
    guard_.want_size("d controls from pullback(), counted in columns,", gradient.controls.cols(), one.columns);
    guard_.want_size("d state from pullback()", gradient.state.size(), sizes_.has_state_gradients ? one.states : 0);
    guard_.want_size("d shape from pullback(), counted in rows,", gradient.shape.rows(),
                     sizes_.has_shape_gradients ? sizes_.vertices : 0);
    if (all_finite(gradient.controls) && all_finite(gradient.centre) && all_finite(gradient.width) &&
        all_finite(gradient.state) && all_finite(gradient.shape))
      return;
    if (all_finite_cotangent(cotangents)) guard_.fail_not_finite("a gradient from pullback()");
  }
  void check(const ShapeCotangent& slope) const {
    guard_.want_size("a mean from jvp(), counted in rows,", slope.mean.rows(), sizes_.vertices);
    guard_.want_size("a sigma from jvp(), counted in rows,", slope.sigma.rows(),
                     sizes_.has_sigma ? sizes_.vertices : 0);
    guard_.want_finite("a mean from jvp()", slope.mean);
    guard_.want_finite("a sigma from jvp()", slope.sigma);
  }

  Guard guard_;
  std::shared_ptr<const void> keep_;
  PredictionSizes sizes_;
  std::vector<bool> failed_;
  std::unique_ptr<Prediction> plugin_;  // the first to die
};

class CheckedTrainable final : public TrainablePredictor {
 public:
  CheckedTrainable(const Guard& guard, TrainablePredictor& plugin) : guard_(guard), plugin_(plugin) {}

  TrainingCapabilities training_capabilities() const override {
    return guard_.call("training_capabilities()", [&] { return plugin_.training_capabilities(); });
  }
  FitReport fit(const Dataset& dataset, const Task& task, const FitOptions& options,
                const FitObserver& observer) override {
    const FitObserver watching = [&](const FitProgress& progress) {
      return call_back([&] { return observer(progress); });
    };
    return guard_.set_up("fit()", [&] { return plugin_.fit(dataset, task, options, observer ? watching : nullptr); });
  }
  void save(const std::filesystem::path& file) const override {
    guard_.set_up("save()", [&] { plugin_.save(file); });
  }
  void load(const std::filesystem::path& file) override {
    guard_.set_up("load()", [&] { plugin_.load(file); });
  }
  std::vector<DatasetOrigin> trained_on() const override {
    return guard_.call("trained_on()", [&] { return plugin_.trained_on(); });
  }
  CalibrationReport calibrate(const Dataset& dataset, const std::vector<std::size_t>& examples, const Task& task,
                              const CalibrationOptions& options) override {
    return guard_.set_up("calibrate()", [&] {
      CalibrationReport report = plugin_.calibrate(dataset, examples, task, options);
      for (const auto& row : report.rows) {
        const Index segments = std::ssize(row.factor);
        guard_.want_size("added_m of a row from calibrate()", std::ssize(row.added_m), segments);
        guard_.want_size("shapes of a row from calibrate()", std::ssize(row.shapes), segments);
        if (!all_finite(row.factor) || !all_finite(row.added_m)) guard_.fail_not_finite("a row from calibrate()");
      }
      return report;
    });
  }
  std::vector<DatasetOrigin> calibrated_on() const override {
    return guard_.call("calibrated_on()", [&] { return plugin_.calibrated_on(); });
  }

 private:
  const Guard& guard_;
  TrainablePredictor& plugin_;
};

class CheckedPredictor final : public Predictor {
 public:
  CheckedPredictor(const std::string& name, std::shared_ptr<Predictor> plugin, PluginChecks checks)
      : guard_(kKind, name, checks == PluginChecks::all), plugin_(std::move(plugin)) {
    auto* const trainable = guard_.call("trainable()", [&] { return plugin_->trainable(); });
    if (trainable != nullptr) trainable_.emplace(guard_, *trainable);
  }
  CheckedPredictor(const CheckedPredictor&) = delete;
  CheckedPredictor& operator=(const CheckedPredictor&) = delete;

  PredictorCapabilities capabilities() const override {
    return guard_.call("capabilities()", [&] { return plugin_->capabilities(); });
  }
  void bind(const Task& task) override {
    controls_ = task.trajectory ? std::ssize(task.trajectory->controls()) : 0;
    guard_.set_up("bind()", [&] { plugin_->bind(task); });
  }
  std::unique_ptr<Prediction> predict(const std::vector<PredictionCase>& cases,
                                      const PredictionRequest& request) const override {
    return guard_.call("predict()", [&]() -> std::unique_ptr<Prediction> {
      PredictionSizes sizes = sizes_of(cases, request, plugin_->capabilities());
      return std::make_unique<CheckedPrediction>(guard_, plugin_->predict(cases, request), std::move(sizes), plugin_);
    });
  }
  std::optional<Box> control_range() const override {
    return guard_.call("control_range()", [&] {
      std::optional<Box> range = plugin_->control_range();
      if (!range) return range;
      guard_.want_size("the lower bound from control_range()", range->lower.size(), controls_);
      guard_.want_size("the upper bound from control_range()", range->upper.size(), controls_);
      guard_.want_finite("the lower bound from control_range()", range->lower);
      guard_.want_finite("the upper bound from control_range()", range->upper);
      if ((range->lower.array() > range->upper.array()).any())
        guard_.fail("control_range() has a lower bound > the upper");
      return range;
    });
  }
  TrainablePredictor* trainable() override { return trainable_ ? &*trainable_ : nullptr; }
  std::optional<Index> max_segments() const override {
    return guard_.call("max_segments()", [&] {
      const std::optional<Index> most = plugin_->max_segments();
      if (most && *most < 1) guard_.fail("max_segments() = " + std::to_string(*most) + ", must be at least 1");
      return most;
    });
  }

 private:
  Guard guard_;
  std::shared_ptr<Predictor> plugin_;
  std::optional<CheckedTrainable> trainable_;
  Index controls_ = 0;  // of the bound task's trajectory
};

}  // namespace

std::shared_ptr<Predictor> checked(const std::string& name, std::shared_ptr<Predictor> plugin, PluginChecks checks) {
  return std::make_shared<CheckedPredictor>(name, std::move(plugin), checks);
}

}  // namespace weft
