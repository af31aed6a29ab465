// An honest plugin. It is compiled twice, each time with a definition that changes the types which cross.
#include "bad_plugins/bad_plugin.hpp"

WEFT_PLUGIN(weft::Trajectory, weft::test::Toy, weft::test::NoParams, "other_flags", "1.0.0")
