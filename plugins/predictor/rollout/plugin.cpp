#include "weft/plugin.hpp"
#include "rollout.hpp"

WEFT_PLUGIN(weft::Predictor, weft::rollout::RolloutPredictor, weft::rollout::Params, "rollout", "1.0.0")
