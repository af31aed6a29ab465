#pragma once
#include <Eigen/Core>

#include "weft/host.hpp"
#include "weft/params.hpp"

namespace weft {

/// Describes a plugin library. Plain data: the loader reads it before it makes any C++ call.
extern "C" struct WeftPluginInfo {
  char magic[8];  ///< "weftplu"
  char abi_tag[96];
  char kind[32];
  char name[64];
  char version[32];
  int interface_version;
};

// Everything two libraries must agree on before they exchange C++ objects.
#define WEFT_STRINGIFY_(x) #x
#define WEFT_STRINGIFY(x) WEFT_STRINGIFY_(x)
#define WEFT_ABI_TAG                                                                                                           \
  "weft3 gxxabi" WEFT_STRINGIFY(__GXX_ABI_VERSION) " cxx11abi" WEFT_STRINGIFY(_GLIBCXX_USE_CXX11_ABI) " eigen" WEFT_STRINGIFY( \
      EIGEN_WORLD_VERSION) "." WEFT_STRINGIFY(EIGEN_MAJOR_VERSION) "." WEFT_STRINGIFY(EIGEN_MINOR_VERSION) " align" WEFT_STRINGIFY(EIGEN_MAX_ALIGN_BYTES)

/// Copies `text` into a fixed char array of the info. Text that is too long does not compile.
template <std::size_t N, std::size_t M>
constexpr void copy_info_text(char (&to)[N], const char (&text)[M]) {
  static_assert(M <= N, "plugin info text too long");
  for (std::size_t i = 0; i < M; ++i) to[i] = text[i];
}

template <class Interface, std::size_t N, std::size_t V>
constexpr WeftPluginInfo make_plugin_info(const char (&name)[N], const char (&version)[V]) {
  WeftPluginInfo info{};
  copy_info_text(info.magic, "weftplu");
  copy_info_text(info.abi_tag, WEFT_ABI_TAG);
  for (int i = 0; Interface::kKind[i] != 0; ++i) info.kind[i] = Interface::kKind[i];
  copy_info_text(info.name, name);
  copy_info_text(info.version, version);
  info.interface_version = Interface::kVersion;
  return info;
}

/// Creates the plugin: Impl(const Params&, Host&) when it has that constructor, else Impl(const Params&).
template <class Interface, class Impl, class Params>
Interface* create_plugin(Host& host, const ConfigNode& params_node) {
  Params params;
  read_params(params_node, params);
  if constexpr (std::is_constructible_v<Impl, const Params&, Host&>)
    return new Impl(params, host);
  else
    return new Impl(params);
}

}  // namespace weft

/// Exports one plugin from a library: WEFT_PLUGIN(weft::Trajectory, my::Line, my::Params, "line", "1.0.0").
/// The create and visit functions may throw weft::Error; the loader catches.
#define WEFT_PLUGIN(Interface, Impl, Params, name, version)                                              \
  extern "C" WEFT_API const ::weft::WeftPluginInfo weft_plugin_info =                                    \
      ::weft::make_plugin_info<Interface>(name, version);                                                \
  extern "C" WEFT_API void* weft_plugin_create(::weft::Host* host, const ::weft::ConfigNode* params) {   \
    return static_cast<Interface*>(::weft::create_plugin<Interface, Impl, Params>(*host, *params));      \
  }                                                                                                      \
  extern "C" WEFT_API void weft_plugin_destroy(void* object) { delete static_cast<Interface*>(object); } \
  extern "C" WEFT_API void weft_plugin_visit_params(::weft::ParamVisitor* visitor) {                     \
    Params params;                                                                                       \
    params.visit(*visitor);                                                                              \
  }
