#include "bad_plugins/bad_plugin.hpp"

EXPORT_INFO(GOOD_INFO("returns_null"))
extern "C" WEFT_API void* weft_plugin_create(weft::Host*, const weft::ConfigNode*) { return nullptr; }
extern "C" WEFT_API void weft_plugin_destroy(void*) {}
extern "C" WEFT_API void weft_plugin_visit_params(weft::ParamVisitor*) {}
