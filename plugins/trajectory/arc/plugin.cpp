#include "weft/plugin.hpp"

#include "arc.hpp"

WEFT_PLUGIN(weft::Trajectory, weft::arc::Arc, weft::arc::Params, "arc", "1.0.0")
