#include "weft/predictor.hpp"

#include "weft/trainable.hpp"

namespace weft {

std::vector<std::vector<std::vector<ShapeCotangent>>> Prediction::jvp(
    const std::vector<std::vector<CaseDirection>>&) const {
  throw Unsupported("this predictor has no directional derivatives (capability jvp)");
}

CalibrationReport TrainablePredictor::calibrate(const Dataset&, const std::vector<std::size_t>&, const Task&,
                                                const CalibrationOptions&) {
  throw ConfigError("this predictor cannot calibrate a model that is trained already");
}

}  // namespace weft
