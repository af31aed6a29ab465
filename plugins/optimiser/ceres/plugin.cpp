#include "weft/plugin.hpp"

#include "ceres.hpp"

WEFT_PLUGIN(weft::Optimiser, weft::ceres_solver::Ceres, weft::ceres_solver::Params, "ceres", "1.0.0")
