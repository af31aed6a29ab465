#include "loader/checked.hpp"
#include "loader/guard.hpp"
#include "weft/trajectory.hpp"

namespace weft {
namespace {

class CheckedTrajectory final : public Trajectory {
 public:
  CheckedTrajectory(const std::string& name, std::shared_ptr<Trajectory> plugin, PluginChecks checks)
      : guard_(kKind, name, checks == PluginChecks::all), plugin_(std::move(plugin)) {
    controls_ = read_variables("controls()", [&] { return plugin_->controls(); });
    states_ = read_variables("state()", [&] { return plugin_->state(); });
    hands_ = guard_.call("hands()", [&] {
      const Index hands = plugin_->hands();
      if (hands < 1) guard_.fail("hands() = " + std::to_string(hands) + ", must be at least 1");
      return hands;
    });
  }

  std::vector<Variable> controls() const override { return controls_; }
  std::vector<Variable> state() const override { return states_; }
  Index hands() const override { return hands_; }

  Vector initial_state(const Manipulation& manipulation) const override {
    return guard_.set_up("initial_state()", [&] {
      Vector state = plugin_->initial_state(manipulation);
      guard_.want_size("the state from initial_state()", state.size(), std::ssize(states_));
      guard_.want_finite("the state from initial_state()", state);
      return state;
    });
  }

  Positions targets(const Manipulation& manipulation, ConstVec state) const override {
    check_state_given(state);
    return guard_.call("targets()", [&] {
      Positions targets = plugin_->targets(manipulation, state);
      guard_.want_size("targets(), counted in rows,", targets.rows(), hands_);
      guard_.want_finite("a target from targets()", targets, state);
      return targets;
    });
  }

  Vector targets_pullback(const Manipulation& manipulation, ConstVec state, const Positions& d_targets) const override {
    check_state_given(state);
    guard_.want_from_caller("d_targets, counted in rows,", d_targets.rows(), hands_);
    return guard_.call("targets_pullback()", [&] {
      Vector d_state = plugin_->targets_pullback(manipulation, state, d_targets);
      guard_.want_size("the gradient from targets_pullback()", d_state.size(), std::ssize(states_));
      guard_.want_finite("the gradient from targets_pullback()", d_state, state, d_targets);
      return d_state;
    });
  }

  double progress(ConstVec state) const override {
    check_state_given(state);
    return guard_.call("progress()", [&] {
      const double progress = plugin_->progress(state);
      if (!all_finite(&progress, 1) && all_finite(state)) guard_.fail_not_finite("progress()");
      return progress;
    });
  }

  Vector advance(const Manipulation& manipulation, ConstVec state, ConstVec control) const override {
    check_state_given(state);
    check_control_given(control);
    return guard_.call("advance()", [&] {
      Vector next = plugin_->advance(manipulation, state, control);
      guard_.want_size("the state from advance()", next.size(), std::ssize(states_));
      guard_.want_finite("the state from advance()", next, state, control);
      return next;
    });
  }

  void advance_pullback(const Manipulation& manipulation, ConstVec state, ConstVec control, ConstVec d_next,
                        Vector& d_state, Vector& d_control) const override {
    check_state_given(state);
    check_control_given(control);
    guard_.want_from_caller("d_next", d_next.size(), std::ssize(states_));
    guard_.call("advance_pullback()", [&] {
      plugin_->advance_pullback(manipulation, state, control, d_next, d_state, d_control);
      guard_.want_size("d_state from advance_pullback()", d_state.size(), std::ssize(states_));
      guard_.want_size("d_control from advance_pullback()", d_control.size(), std::ssize(controls_));
      guard_.want_finite("d_state from advance_pullback()", d_state, state, control, d_next);
      guard_.want_finite("d_control from advance_pullback()", d_control, state, control, d_next);
    });
  }

  Index decision_size(Index horizon) const override {
    return guard_.call("decision_size()", [&] {
      const Index size = plugin_->decision_size(horizon);
      if (size < 0 || (size == 0 && horizon > 0)) {
        guard_.fail("decision_size(" + std::to_string(horizon) + ") = " + std::to_string(size) +
                    ", must be at least 1");
      }
      return size;
    });
  }

  Controls decode(ConstVec x, Index horizon, ConstVec state) const override {
    check_state_given(state);
    return guard_.call("decode()", [&] {
      Controls controls = plugin_->decode(x, horizon, state);
      guard_.want_size("decode(), counted in rows,", controls.rows(), horizon);
      guard_.want_size("decode(), counted in columns,", controls.cols(), std::ssize(controls_));
      guard_.want_finite("a control from decode()", controls, x, state);
      return controls;
    });
  }

  Vector decode_pullback(ConstVec x, Index horizon, ConstVec state, const Controls& d_controls) const override {
    check_state_given(state);
    return guard_.call("decode_pullback()", [&] {
      Vector d_x = plugin_->decode_pullback(x, horizon, state, d_controls);
      guard_.want_size("the gradient from decode_pullback()", d_x.size(), x.size());
      guard_.want_finite("the gradient from decode_pullback()", d_x, x, state, d_controls);
      return d_x;
    });
  }

  Vector encode(const Controls& controls, ConstVec state) const override {
    check_state_given(state);
    return guard_.call("encode()", [&] {
      Vector x = plugin_->encode(controls, state);
      guard_.want_size("x from encode()", x.size(), plugin_->decision_size(controls.rows()));
      guard_.want_finite("x from encode()", x, controls, state);
      return x;
    });
  }

  Box decision_bounds(Index horizon) const override {
    return guard_.call("decision_bounds()", [&] {
      Box box = plugin_->decision_bounds(horizon);
      const Index size = plugin_->decision_size(horizon);
      guard_.want_size("the lower bound from decision_bounds()", box.lower.size(), size);
      guard_.want_size("the upper bound from decision_bounds()", box.upper.size(), size);
      guard_.want_finite("the lower bound from decision_bounds()", box.lower);
      guard_.want_finite("the upper bound from decision_bounds()", box.upper);
      if ((box.lower.array() > box.upper.array()).any()) guard_.fail("decision_bounds() has a lower bound > the upper");
      return box;
    });
  }

  Vector decision_scale(Index horizon) const override {
    return guard_.call("decision_scale()", [&] {
      Vector scale = plugin_->decision_scale(horizon);
      guard_.want_size("decision_scale()", scale.size(), plugin_->decision_size(horizon));
      guard_.want_finite("decision_scale()", scale);
      if ((scale.array() <= 0.0).any()) guard_.fail("decision_scale() has an entry that is not > 0");
      return scale;
    });
  }

 private:
  template <class Read>
  std::vector<Variable> read_variables(const char* call, Read&& read) const {
    return guard_.call(call, [&] {
      std::vector<Variable> variables = read();
      if (variables.empty()) guard_.fail(std::string(call) + " is empty, must have at least 1 variable");
      for (const auto& v : variables) {
        const double numbers[] = {v.lower, v.upper, v.default_value, v.scale};
        const std::string name = std::string(call) + ": '" + v.name + "' ";
        if (!all_finite(numbers, 4)) guard_.fail_not_finite(name + "has a bound, default or scale that");
        if (v.lower > v.upper) guard_.fail(name + "has a lower bound > the upper");
        if (!(v.scale > 0.0)) guard_.fail(name + "has no scale > 0");
      }
      return variables;
    });
  }
  void check_state_given(ConstVec state) const {
    guard_.want_from_caller("a state", state.size(), std::ssize(states_));
  }
  void check_control_given(ConstVec control) const {
    guard_.want_from_caller("a control", control.size(), std::ssize(controls_));
  }

  Guard guard_;
  std::shared_ptr<Trajectory> plugin_;
  std::vector<Variable> controls_, states_;
  Index hands_ = 0;
};

}  // namespace

std::shared_ptr<Trajectory> checked(const std::string& name, std::shared_ptr<Trajectory> plugin, PluginChecks checks) {
  return std::make_shared<CheckedTrajectory>(name, std::move(plugin), checks);
}

}  // namespace weft
