#include "bad_plugins/bad_plugin.hpp"

namespace {

constexpr weft::WeftPluginInfo wrong_info() {
  weft::WeftPluginInfo info = GOOD_INFO("wrong_kind");
  for (char& c : info.kind) c = 0;
  weft::copy_info_text(info.kind, "teapot");
  return info;
}

}  // namespace

EXPORT_INFO(wrong_info())
EXPORT_FUNCTIONS(weft::test::Toy, weft::test::NoParams)
