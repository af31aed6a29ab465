#include <stdexcept>

#include "bad_plugins/bad_plugin.hpp"

namespace {

// Its type lives in this library, which is gone once the registry is.
struct OwnError final : weft::ConfigError {
  OwnError() : ConfigError("throws_own_error: an error of its own") {}
  const char* what() const noexcept override { return "throws_own_error: an error of its own"; }
};

class Thrower final : public weft::test::ToyTrajectory {
 public:
  explicit Thrower(const weft::test::NoParams&) { throw OwnError(); }
};

}  // namespace

WEFT_PLUGIN(weft::Trajectory, Thrower, weft::test::NoParams, "throws_own_error", "1.0.0")
