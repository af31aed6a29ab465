#include "weft/plugin.hpp"

#include "fling.hpp"

WEFT_PLUGIN(weft::Trajectory, weft::fling::Fling, weft::fling::Params, "fling", "1.0.0")
