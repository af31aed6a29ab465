#include "bad_plugins/bad_plugin.hpp"

WEFT_PLUGIN(weft::Trajectory, weft::test::Toy, weft::test::NoParams, "bad_version", "1.0\n\033[31m")
