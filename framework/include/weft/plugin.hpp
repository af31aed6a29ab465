#pragma once
#include <Eigen/Core>
#include <array>
#include <string_view>

#include "weft/host.hpp"
#include "weft/params.hpp"
#include "weft/types.hpp"

namespace weft {

/// Describes a plugin library. Plain data: the loader reads it before it makes any C++ call.
extern "C" struct WeftPluginInfo {
  char magic[8];  ///< "weftplu"
  char abi_tag[96];
  char kind[32];
  char name[64];
  char version[32];
  int interface_version;
  unsigned sizes[24];  ///< bytes of crossing_types(), in their order; then zeros
};

// Instructions beyond the oldest x86-64 that a library was compiled for (-march). A note in the file says which, so that
// the loader can refuse a library that this processor cannot run before it executes anything of it.
constexpr unsigned kAvx = 1, kAvx2 = 2, kFma = 4, kBmi2 = 8, kAvx512f = 16, kAvx512bw = 32, kAvx512dq = 64,
                   kAvx512vl = 128;
constexpr unsigned kCompiledFor = 0
#ifdef __AVX__
                                  | kAvx
#endif
#ifdef __AVX2__
                                  | kAvx2
#endif
#ifdef __FMA__
                                  | kFma
#endif
#ifdef __BMI2__
                                  | kBmi2
#endif
#ifdef __AVX512F__
                                  | kAvx512f
#endif
#ifdef __AVX512BW__
                                  | kAvx512bw
#endif
#ifdef __AVX512DQ__
                                  | kAvx512dq
#endif
#ifdef __AVX512VL__
                                  | kAvx512vl
#endif
    ;

/// An ELF note: sizes of name and description, type, name, description.
extern "C" struct WeftInstructionsNote {
  unsigned name_size = sizeof(name), size = sizeof(instructions), type = 1;
  char name[8] = "weftisa";
  unsigned instructions = kCompiledFor;
};
constexpr const char* kInstructionsNoteName = "weftisa";

// Everything two libraries must agree on before they exchange C++ objects, besides crossing_types().
#define WEFT_STRINGIFY_(x) #x
#define WEFT_STRINGIFY(x) WEFT_STRINGIFY_(x)
#ifdef _GLIBCXX_DEBUG
#define WEFT_DEBUG_TAG " glibcxx_debug"
#else
#define WEFT_DEBUG_TAG ""
#endif
#ifdef EIGEN_DEFAULT_TO_ROW_MAJOR
#define WEFT_ORDER_TAG " row_major"
#else
#define WEFT_ORDER_TAG ""
#endif
#define WEFT_EIGEN_VERSION_TAG \
  WEFT_STRINGIFY(EIGEN_WORLD_VERSION) "." WEFT_STRINGIFY(EIGEN_MAJOR_VERSION) "." WEFT_STRINGIFY(EIGEN_MINOR_VERSION)
#define WEFT_EIGEN_TAG                                                                                    \
  " eigen" WEFT_EIGEN_VERSION_TAG                                                                         \
  " align" WEFT_STRINGIFY(EIGEN_MAX_ALIGN_BYTES) " index " WEFT_STRINGIFY(EIGEN_DEFAULT_DENSE_INDEX_TYPE) \
      WEFT_ORDER_TAG
#define WEFT_CXX_TAG "weft3 gxxabi" WEFT_STRINGIFY(__GXX_ABI_VERSION) " cxx11abi" WEFT_STRINGIFY(_GLIBCXX_USE_CXX11_ABI)
#define WEFT_ABI_TAG WEFT_CXX_TAG WEFT_EIGEN_TAG WEFT_DEBUG_TAG

/// The types that a plugin of this interface exchanges with the program, and their sizes here.
template <class Interface>
constexpr auto crossing_types() {
  std::array<TypeSize, 3 + std::size(Interface::kCrossing)> types{
      {{"Host", sizeof(Host)}, {"ConfigNode", sizeof(ConfigNode)}, {Interface::kKind, sizeof(Interface)}}};
  for (std::size_t i = 3; i < types.size(); ++i) types[i] = Interface::kCrossing[i - 3];
  return types;
}

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
  constexpr auto types = crossing_types<Interface>();
  static_assert(types.size() < std::size(info.sizes));
  for (std::size_t i = 0; i < types.size(); ++i) info.sizes[i] = static_cast<unsigned>(types[i].bytes);
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

#ifdef WEFT_PLUGIN_KIND  // by weft_add_plugin()
#define WEFT_CHECK_PLUGIN_(Interface, name, version)                                                               \
  static_assert(std::string_view(Interface::kKind) == WEFT_PLUGIN_KIND,                                            \
                "WEFT_PLUGIN has another kind than weft_add_plugin(... KIND " WEFT_PLUGIN_KIND ")");               \
  static_assert(std::string_view(name) == WEFT_PLUGIN_NAME,                                                        \
                "WEFT_PLUGIN has another name than weft_add_plugin(" WEFT_PLUGIN_NAME " ...)");                    \
  static_assert(std::string_view(WEFT_PLUGIN_VERSION).empty() || std::string_view(version) == WEFT_PLUGIN_VERSION, \
                "WEFT_PLUGIN has another version than weft_add_plugin(... VERSION " WEFT_PLUGIN_VERSION ")");
#else
#define WEFT_CHECK_PLUGIN_(Interface, name, version)
#endif

/// Exports one plugin from a library: WEFT_PLUGIN(weft::Trajectory, my::Line, my::Params, "line", "1.0.0").
/// The create and visit functions may throw weft::Error; the loader catches. In a library of weft_add_plugin(), kind,
/// name and, if given, version are those of weft_add_plugin().
#define WEFT_PLUGIN(Interface, Impl, Params, name, version)                                              \
  WEFT_CHECK_PLUGIN_(Interface, name, version)                                                           \
  [[gnu::section(".note.weft"), gnu::used]] alignas(                                                     \
      4) static const ::weft::WeftInstructionsNote weft_plugin_instructions{};                           \
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
