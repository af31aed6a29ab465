#include "bad_plugins/bad_plugin.hpp"

// Says what it is but has no create function.
EXPORT_INFO(GOOD_INFO("missing_symbol"))
