#include "weft/plugin.hpp"

#include "emd.hpp"

WEFT_PLUGIN(weft::Predictor, weft::emd::EmdPredictor, weft::emd::Params, "emd", "1.1.0")
