#include "weft/plugin.hpp"
#include "torchscript.hpp"

WEFT_PLUGIN(weft::Predictor, weft::torchscript::TorchScriptPredictor, weft::torchscript::Params, "torchscript", "1.0.0")
