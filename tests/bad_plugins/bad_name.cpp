#include "bad_plugins/bad_plugin.hpp"

WEFT_PLUGIN(weft::Trajectory, weft::test::Toy, weft::test::NoParams, "a/b c", "1.0.0")
