#pragma once
#include <vector>

#include "weft/plugin.hpp"
#include "weft/trajectory.hpp"

namespace weft::test {

/// The smallest possible trajectory: one control that lifts `hands` hands straight up.
class ToyTrajectory : public Trajectory {
 public:
  std::vector<Variable> controls() const override { return {{"dz", "m/frame", 0.0, 0.1, 0.01, 0.01}}; }
  std::vector<Variable> state() const override { return {{"z", "m", 0.0, 10.0, 0.0, 0.1}}; }
  Index hands() const override { return 2; }
  Vector initial_state(const Manipulation&) const override { return Vector::Zero(1); }
  Positions targets(const Manipulation& m, ConstVec state) const override {
    Positions result = m.grasp_points;
    result.col(2).array() += state[0];
    return result;
  }
  Vector targets_pullback(const Manipulation&, ConstVec, const Positions& d_targets) const override {
    return Vector::Constant(1, d_targets.col(2).sum());
  }
  double progress(ConstVec state) const override { return state[0]; }
};

struct NoParams {
  template <class Visitor>
  void visit(Visitor&) {}
};

}  // namespace weft::test
