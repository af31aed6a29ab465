// A plugin that compiles only when weft_add_plugin() and WEFT_PLUGIN say the same; CMakeLists.txt gives what the first
// one says.
#include "unit/toy_trajectory.hpp"

namespace {

class Toy final : public weft::test::ToyTrajectory {
 public:
  explicit Toy(const weft::test::NoParams&) {}
};

}  // namespace

WEFT_PLUGIN(weft::Trajectory, Toy, weft::test::NoParams, "toy", "1.0.0")
