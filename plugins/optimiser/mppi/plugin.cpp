#include "weft/plugin.hpp"

#include "mppi.hpp"

WEFT_PLUGIN(weft::Optimiser, weft::mppi::Mppi, weft::mppi::Params, "mppi", "1.0.0")
