#include "weft/predictor.hpp"

#include "weft/trainable.hpp"

namespace weft {

std::vector<CaseGradient> Prediction::pullback(const std::vector<std::vector<ShapeCotangent>>&) const {
  throw Unsupported("this predictor has no gradients (capability gradients)");
}

std::vector<std::vector<std::vector<ShapeCotangent>>> Prediction::jvp(
    const std::vector<std::vector<CaseDirection>>&) const {
  throw Unsupported("this predictor has no directional derivatives (capability jvp)");
}

PlainPrediction::PlainPrediction(std::vector<std::vector<ShapeDistribution>> shapes, std::vector<std::string> failures)
    : shapes_(std::move(shapes)), failures_(std::move(failures)) {
  if (failures_.empty()) failures_.resize(shapes_.size());
  require_shape("prediction: failures", failures_.size(), shapes_.size());
}

void check_cases(const std::string& who, const Task& task, const std::vector<PredictionCase>& cases,
                 std::optional<Index> max_segments) {
  if (!task.garment || !task.trajectory) throw Error(who + ": predict() before bind()");
  const Index vertices = task.garment->vertex_count();
  const auto states = task.trajectory->state().size(), controls = task.trajectory->controls().size();
  for (std::size_t i = 0; i < cases.size(); ++i) {
    const auto& one = cases[i];
    const std::string where = who + ": case " + std::to_string(i) + ": ";
    if (!one.shape) throw ShapeError(where + "has no shape");
    require_shape(where + "shape rows", one.shape->rows(), vertices);
    if (one.previous) require_shape(where + "previous rows", one.previous->rows(), vertices);
    require_shape(where + "state", one.state.size(), states);
    require_shape(where + "control columns", one.controls.cols(), controls);
    const Index segments = one.controls.rows();
    if (max_segments && segments > *max_segments) {
      throw ShapeError(where + "control rows = " + std::to_string(segments) + ", must be at most " +
                       std::to_string(*max_segments));
    }
    Index before = 0;
    for (const Index segment : one.segments) {
      if (segment <= before || segment > segments) {
        throw ShapeError(where + "segments must ascend within [1, " + std::to_string(segments) + "], got " +
                         std::to_string(segment));
      }
      before = segment;
    }
    const auto require_finite = [&](const char* what, bool is_finite) {
      if (!is_finite) throw Error(where + what + " must be finite");
    };
    require_finite("shape", one.shape->allFinite());
    require_finite("previous", !one.previous || one.previous->allFinite());
    require_finite("state", one.state.allFinite());
    require_finite("controls", one.controls.allFinite());
    require_finite("knowledge", one.knowledge.centre.allFinite() && one.knowledge.width.allFinite());
  }
}

CalibrationReport TrainablePredictor::calibrate(const Dataset&, const std::vector<std::size_t>&, const Task&,
                                                const CalibrationOptions&) {
  throw ConfigError("this predictor cannot recalibrate a trained model");
}

}  // namespace weft
