#include "bad_plugins/bad_plugin.hpp"

WEFT_PLUGIN(weft::Trajectory, weft::test::Toy, weft::test::NoParams, "good", "1.0.0")
