#include "weft/plugin.hpp"

#include "nlopt.hpp"

WEFT_PLUGIN(weft::Optimiser, weft::nlopt_solver::Nlopt, weft::nlopt_solver::Params, "nlopt", "1.0.0")
