#include "weft/plugin.hpp"

#include "drag.hpp"

WEFT_PLUGIN(weft::Trajectory, weft::drag::Drag, weft::drag::Params, "drag", "1.0.0")
