#include <stdexcept>

#include "bad_plugins/bad_plugin.hpp"

namespace {

class Thrower final : public weft::test::ToyTrajectory {
 public:
  explicit Thrower(const weft::test::NoParams&) { throw 42; }
};

}  // namespace

WEFT_PLUGIN(weft::Trajectory, Thrower, weft::test::NoParams, "throws_no_exception", "1.0.0")
