#include "weft/plugin.hpp"

#include "spline.hpp"

WEFT_PLUGIN(weft::Trajectory, weft::spline::Spline, weft::spline::Params, "spline", "1.0.0")
