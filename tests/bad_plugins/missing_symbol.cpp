#include "bad_plugins/bad_plugin.hpp"

// Has the plugin info but no create function.
EXPORT_INFO(GOOD_INFO("missing_symbol"))
