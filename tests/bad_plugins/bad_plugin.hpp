#pragma once
#include "unit/toy_trajectory.hpp"

// The parts that WEFT_PLUGIN writes, one by one, so that a bad plugin can have exactly one of them wrong.
#define GOOD_INFO(name) weft::make_plugin_info<weft::Trajectory>(name, "1.0.0")
#define EXPORT_INFO(info) extern "C" WEFT_API const weft::WeftPluginInfo weft_plugin_info = info;
#define EXPORT_FUNCTIONS(Impl, Params)                                                                          \
  extern "C" WEFT_API void* weft_plugin_create(weft::Host* host, const weft::ConfigNode* params) {              \
    return static_cast<weft::Trajectory*>(weft::create_plugin<weft::Trajectory, Impl, Params>(*host, *params)); \
  }                                                                                                             \
  extern "C" WEFT_API void weft_plugin_destroy(void* object) { delete static_cast<weft::Trajectory*>(object); } \
  extern "C" WEFT_API void weft_plugin_visit_params(weft::ParamVisitor* visitor) { Params().visit(*visitor); }

namespace weft::test {

/// The toy without parameters.
class Toy final : public ToyTrajectory {
 public:
  explicit Toy(const NoParams&) {}
};

}  // namespace weft::test
