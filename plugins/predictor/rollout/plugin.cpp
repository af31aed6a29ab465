#include "rollout.hpp"
#include "weft/plugin.hpp"

WEFT_PLUGIN(weft::Predictor, weft::rollout::RolloutPredictor, weft::rollout::Params, "rollout", "1.0.0")
