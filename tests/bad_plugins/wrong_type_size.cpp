#include "bad_plugins/bad_plugin.hpp"

namespace {

// As if Variable had been a number longer when this was compiled.
constexpr weft::WeftPluginInfo wrong_info() {
  weft::WeftPluginInfo info = GOOD_INFO("wrong_type_size");
  constexpr auto types = weft::crossing_types<weft::Trajectory>();
  for (std::size_t i = 0; i < types.size(); ++i)
    if (std::string_view(types[i].type) == "Variable") info.sizes[i] += 8;
  return info;
}

}  // namespace

EXPORT_INFO(wrong_info())
EXPORT_FUNCTIONS(weft::test::Toy, weft::test::NoParams)
