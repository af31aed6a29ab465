#include "unit/toy_trajectory.hpp"

namespace {

struct Params {
  double speed = 1.0;
  template <class Visitor>
  void visit(Visitor& v) {
    v("speed", speed, weft::range(0.0, 10.0, "m/s"), "Unused.");
  }
};

/// Its progress shows the parameters it was made with.
class Toy final : public weft::test::ToyTrajectory {
 public:
  explicit Toy(const Params& params) : speed_(params.speed) {
    if (params.speed == 9.0) throw weft::ConfigError("toy: speed = 9, which toy refuses itself");
  }
  double progress(weft::ConstVec) const override { return speed_; }

 private:
  double speed_;
};

}  // namespace

WEFT_PLUGIN(weft::Trajectory, Toy, Params, "toy", TOY_VERSION)
