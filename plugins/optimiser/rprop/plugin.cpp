#include "weft/plugin.hpp"

#include "rprop.hpp"

WEFT_PLUGIN(weft::Optimiser, weft::rprop::Rprop, weft::rprop::Params, "rprop", "1.0.0")
