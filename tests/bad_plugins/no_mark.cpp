#include "bad_plugins/bad_plugin.hpp"

namespace {

constexpr weft::WeftPluginInfo wrong_info() {
  weft::WeftPluginInfo info = GOOD_INFO("no_mark");
  info.magic[0] = 87;
  return info;
}

}  // namespace

EXPORT_INFO(wrong_info())
EXPORT_FUNCTIONS(weft::test::Toy, weft::test::NoParams)
