#include "bad_plugins/bad_plugin.hpp"

namespace {

constexpr weft::WeftPluginInfo wrong_info() {
  weft::WeftPluginInfo info = GOOD_INFO("wrong_interface_version");
  info.interface_version = 999;
  return info;
}

}  // namespace

EXPORT_INFO(wrong_info())
EXPORT_FUNCTIONS(weft::test::Toy, weft::test::NoParams)
