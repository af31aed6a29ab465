#include "bad_plugins/bad_plugin.hpp"

// The info of some other version of weft, shorter than today's.
struct ShortInfo {
  char magic[8] = {'w', 'e', 'f', 't', 'p', 'l', 'u', 0};
  char name[24] = "wrong_size";
};
extern "C" WEFT_API const ShortInfo weft_plugin_info;
const ShortInfo weft_plugin_info{};
EXPORT_FUNCTIONS(weft::test::Toy, weft::test::NoParams)
