#include "weft/plugin.hpp"

#include "keyframes.hpp"

WEFT_PLUGIN(weft::Trajectory, weft::keyframes::Keyframes, weft::keyframes::Params, "keyframes", "1.0.0")
