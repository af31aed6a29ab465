#include "bad_plugins/bad_plugin.hpp"

namespace {

constexpr weft::WeftPluginInfo wrong_info() {
  weft::WeftPluginInfo info = GOOD_INFO("wrong_abi");
  for (char& c : info.abi_tag) c = 0;
  weft::copy_info_text(info.abi_tag, "weft1 gxxabi1002 cxx11abi0 eigen3.3.9 align16");
  return info;
}

}  // namespace

EXPORT_INFO(wrong_info())
EXPORT_FUNCTIONS(weft::test::Toy, weft::test::NoParams)
