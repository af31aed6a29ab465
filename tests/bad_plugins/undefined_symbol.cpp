#include "bad_plugins/bad_plugin.hpp"

// Declared, used, defined nowhere.
double weft_nobody_defines_this(double x);

namespace {

class Toy final : public weft::test::ToyTrajectory {
 public:
  explicit Toy(const weft::test::NoParams&) {}
  double progress(weft::ConstVec state) const override { return weft_nobody_defines_this(state[0]); }
};

}  // namespace

WEFT_PLUGIN(weft::Trajectory, Toy, weft::test::NoParams, "undefined_symbol", "1.0.0")
