#include <stdexcept>

#include "bad_plugins/bad_plugin.hpp"

namespace {

class Thrower final : public weft::test::ToyTrajectory {
 public:
  explicit Thrower(const weft::test::NoParams&) { throw std::runtime_error("the constructor gave up"); }
};

}  // namespace

WEFT_PLUGIN(weft::Trajectory, Thrower, weft::test::NoParams, "throws_at_create", "1.0.0")
