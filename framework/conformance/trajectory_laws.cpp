// The laws of a trajectory.
#include <algorithm>
#include <functional>
#include <set>

#include "conformance/kit.hpp"

namespace weft::conformance {
namespace of_trajectories {
namespace {

constexpr Index kHorizon = 25;  // the planner's first b (section 4)

/// Grasp points at contact height, on a line that is oblique to d, for any number of hands.
Manipulation skew(const Trajectory& trajectory, int which) {
  Manipulation m;
  const Index hands = trajectory.hands();
  m.grasp_points.resize(hands, 3);
  m.contact_height = 0.002;
  m.drop_height = 0.06;
  for (Index i = 0; i < hands; ++i) {
    m.grasp_vertices.push_back(i);
    const double along = hands > 1 ? static_cast<double>(i) / static_cast<double>(hands - 1) - 0.5 : 0.0;
    m.grasp_points.row(i) << 0.05 + 0.03 * along, -0.1 + 0.4 * along, m.contact_height;
  }
  m.displacement = which == 0 ? Vec2(0.5, 0.0) : Vec2(-0.28, 0.31);
  return m;
}

template <class Each>
void for_manipulations(const Trajectory& trajectory, Each&& each) {
  for (int which = 0; which < 2; ++which) each(skew(trajectory, which));
}

Vector scales(const std::vector<Variable>& variables) {
  Vector s(variables.size());
  for (Index i = 0; i < s.size(); ++i) s[i] = variables[i].scale;
  return s;
}

/// Controls inside their bounds: the default plus or minus up to one scale.
Vector random_control(const Trajectory& trajectory, RandomStream& random) {
  const auto variables = trajectory.controls();
  Vector c(variables.size());
  for (Index i = 0; i < c.size(); ++i) {
    const auto& v = variables[i];
    c[i] = std::clamp(v.default_value + v.scale * random.uniform(-1.0, 1.0), v.lower, v.upper);
  }
  return c;
}

/// The state after some segments of random controls, before release.
Vector random_state(const Trajectory& trajectory, const Manipulation& m, RandomStream& random) {
  Vector state = trajectory.initial_state(m);
  const std::uint64_t frames = 3 + random.below(40);
  for (std::uint64_t k = 0; k < frames; ++k) {
    const Vector next = trajectory.advance(m, state, random_control(trajectory, random));
    if (trajectory.progress(next) > 0.9) break;
    state = next;
  }
  return state;
}

Vector normals(Index size, RandomStream& random) {
  Vector v(size);
  for (Index i = 0; i < size; ++i) v[i] = random.normal();
  return v;
}

/// Relative error of a gradient against central differences of f at x, in units of the scales. Fourth order.
double gradient_error(const std::function<double(const Vector&)>& f, const Vector& x, const Vector& gradient,
                      const Vector& scale) {
  require_shape("size of a gradient", gradient.size(), x.size());
  Vector slope(x.size());
  for (Index i = 0; i < x.size(); ++i) {
    const double h = 1e-3;
    const auto at = [&](double steps) {
      Vector moved = x;
      moved[i] += steps * h * scale[i];
      return f(moved);
    };
    slope[i] = (8.0 * (at(1) - at(-1)) - (at(2) - at(-2))) / (12.0 * h);
  }
  return (gradient.cwiseProduct(scale) - slope).norm() / std::max(slope.norm(), 1e-6);
}

// ---------------------------------------------------------------------------------------------------------------------

Outcome variables_are_well_formed(const Bench& bench) {
  const auto t = bench.make<Trajectory>();
  Refusals wrong;
  if (t->hands() < 1) wrong.miss("hands() < 1");
  for (const auto& [what, variables] : {std::pair{"control", t->controls()}, std::pair{"state", t->state()}}) {
    if (variables.empty()) wrong.miss(std::string("no ") + what + " variable");
    std::set<std::string> names;
    for (const auto& v : variables) {
      const std::string name = std::string(what) + " '" + v.name + "'";
      if (v.name.empty() || !names.insert(v.name).second) wrong.miss(name + " has an empty or repeated name");
      if (!std::isfinite(v.lower) || !std::isfinite(v.upper) || v.lower > v.upper)
        wrong.miss(name + " has bounds that are not finite or not ascending");
      if (!(v.default_value >= v.lower && v.default_value <= v.upper))
        wrong.miss(name + " has a default outside its bounds");
      if (!(v.scale > 0.0) || !std::isfinite(v.scale)) wrong.miss(name + " has no scale > 0");
    }
  }
  for_manipulations(*t, [&](const Manipulation& m) {
    if (t->initial_state(m).size() != std::ssize(t->state())) wrong.miss("initial_state() has another size");
  });
  return wrong.outcome();
}

Outcome starts_at_the_grasp_points(const Bench& bench) {
  const auto t = bench.make<Trajectory>();
  Worst worst;
  for_manipulations(*t, [&](const Manipulation& m) {
    const Positions g = t->targets(m, t->initial_state(m));
    require_shape("rows of targets()", g.rows(), t->hands());
    worst.add((g - m.grasp_points).cwiseAbs());
  });
  return worst.outcome();
}

Outcome advance_pullback_is_exact(const Bench& bench) {
  const auto t = bench.make<Trajectory>();
  RandomStream random(11);
  Worst worst;
  for_manipulations(*t, [&](const Manipulation& m) {
    for (int trial = 0; trial < 10; ++trial) {
      const Vector state = random_state(*t, m, random), control = random_control(*t, random);
      const Vector w = normals(state.size(), random).cwiseQuotient(scales(t->state()));
      // Wrong sizes and values: both must be overwritten, not added to.
      Vector d_state = Vector::Constant(2, 99.0), d_control = Vector::Constant(7, 99.0);
      t->advance_pullback(m, state, control, w, d_state, d_control);
      worst.add(gradient_error([&](const Vector& x) { return t->advance(m, x, control).dot(w); }, state, d_state,
                               scales(t->state())));
      worst.add(gradient_error([&](const Vector& x) { return t->advance(m, state, x).dot(w); }, control, d_control,
                               scales(t->controls())));
    }
  });
  return worst.outcome();
}

Outcome targets_pullback_is_exact(const Bench& bench) {
  const auto t = bench.make<Trajectory>();
  RandomStream random(12);
  Worst worst;
  for_manipulations(*t, [&](const Manipulation& m) {
    for (int trial = 0; trial < 10; ++trial) {
      const Vector state = random_state(*t, m, random);
      Positions w(t->hands(), 3);
      for (Index i = 0; i < w.size(); ++i) w.data()[i] = random.normal();
      const auto value = [&](const Vector& x) { return t->targets(m, x).cwiseProduct(w).sum(); };
      worst.add(gradient_error(value, state, t->targets_pullback(m, state, w), scales(t->state())));
    }
  });
  return worst.outcome();
}

Outcome path_is_continuous(const Bench& bench) {
  const auto t = bench.make<Trajectory>();
  RandomStream random(13);
  Worst worst;
  for_manipulations(*t, [&](const Manipulation& m) {
    for (int trial = 0; trial < 6; ++trial) {
      Vector state = t->initial_state(m);
      Positions before = t->targets(m, state);
      for (Index segment = 0; segment < kHorizon; ++segment) {
        const Vector control =
            trial == 0 ? Vector(t->default_controls(1).row(0).transpose()) : random_control(*t, random);
        const auto path = t->segment(m, state, control);
        for (const auto& g : path.targets) {
          worst.add((g - before).rowwise().norm());
          before = g;
        }
        state = path.end_state;
      }
    }
  });
  return worst.outcome();
}

Outcome never_below_contact_height(const Bench& bench) {
  const auto t = bench.make<Trajectory>();
  RandomStream random(14);
  Worst worst;
  for_manipulations(*t, [&](const Manipulation& m) {
    for (int trial = 0; trial < 6; ++trial) {
      Vector state = t->initial_state(m);
      for (Index frame = 0; frame < kHorizon * kFramesPerSegment; ++frame) {
        state = t->advance(m, state, random_control(*t, random));
        worst.add(m.contact_height - t->targets(m, state).col(2).array());
      }
    }
  });
  return worst.outcome();
}

Outcome default_controls_release(const Bench& bench) {
  const auto t = bench.make<Trajectory>();
  double worst = 0.0;
  for_manipulations(*t, [&](const Manipulation& m) {
    Vector state = t->initial_state(m);
    if (!(std::abs(t->progress(state)) <= 1e-12)) {
      worst = std::numeric_limits<double>::infinity();  // progress is 0 at the start
      return;
    }
    const Controls controls = t->default_controls(1);
    Index segments = 0;
    while (!t->released(state) && segments < 1000) {
      for (Index k = 0; k < kFramesPerSegment; ++k) state = t->advance(m, state, controls.row(0).transpose());
      ++segments;
    }
    worst = std::max(worst, static_cast<double>(segments));
  });
  return {worst, worst > 1e3 ? "progress is not 0 at the start" : ""};
}

/// Decision vectors inside the box, spread over it.
Vector random_decision(const Trajectory& t, Index horizon, RandomStream& random) {
  const Box box = t.decision_bounds(horizon);
  Vector x(box.lower.size());
  for (Index i = 0; i < x.size(); ++i) x[i] = random.uniform(box.lower[i], box.upper[i]);
  return x;
}

Outcome decode_encode_round_trip(const Bench& bench) {
  const auto t = bench.make<Trajectory>();
  RandomStream random(15);
  Worst worst;
  for_manipulations(*t, [&](const Manipulation& m) {
    const Vector state = t->initial_state(m);
    for (Index horizon : {1, 4, 9}) {
      const Controls controls = t->decode(random_decision(*t, horizon, random), horizon, state);
      require_shape("rows of decode()", controls.rows(), horizon);
      const Controls again = t->decode(t->encode(controls, state), horizon, state);
      const Vector scale = scales(t->controls());
      worst.add(((again - controls).array().rowwise() / scale.transpose().array()).abs());
    }
  });
  return worst.outcome();
}

Outcome decode_pullback_is_exact(const Bench& bench) {
  const auto t = bench.make<Trajectory>();
  RandomStream random(16);
  Worst worst;
  const Manipulation m = skew(*t, 1);
  const Vector state = t->initial_state(m);
  for (Index horizon : {1, 3}) {
    const Vector x = t->encode(t->default_controls(horizon), state);
    Controls w(horizon, t->controls().size());
    for (Index i = 0; i < w.size(); ++i) w.data()[i] = random.normal();
    w.array().rowwise() /= scales(t->controls()).transpose().array();
    const auto value = [&](const Vector& at) { return t->decode(at, horizon, state).cwiseProduct(w).sum(); };
    worst.add(gradient_error(value, x, t->decode_pullback(x, horizon, state, w), t->decision_scale(horizon)));
  }
  return worst.outcome();
}

Outcome decision_box_is_sound(const Bench& bench) {
  const auto t = bench.make<Trajectory>();
  RandomStream random(17);
  Refusals wrong;
  const Vector state = t->initial_state(skew(*t, 0));
  const auto variables = t->controls();
  for (Index horizon : {1, 4, 25}) {
    const Box box = t->decision_bounds(horizon);
    const Index size = t->decision_size(horizon);
    const Vector scale = t->decision_scale(horizon);
    const std::string at = " for horizon " + std::to_string(horizon);
    if (box.lower.size() != size || box.upper.size() != size || scale.size() != size) {
      wrong.miss("the size of bounds or scale is not decision_size()" + at);
      continue;
    }
    if (!box.lower.allFinite() || !box.upper.allFinite() || (box.lower.array() > box.upper.array()).any())
      wrong.miss("the box is not finite or not ascending" + at);
    if (!scale.allFinite() || (scale.array() <= 0.0).any()) wrong.miss("a scale is not > 0" + at);
    const Vector start = t->encode(t->default_controls(horizon), state);
    require_shape("size of encode()", start.size(), size);
    if (!((box.lower - start).array() <= 1e-9 * scale.array()).all() ||
        !((start - box.upper).array() <= 1e-9 * scale.array()).all())
      wrong.miss("the box does not contain the default trajectory" + at);
    const Controls c = t->decode(random_decision(*t, horizon, random), horizon, state);
    require_shape("columns of decode()", c.cols(), variables.size());
    for (Index i = 0; i < c.cols(); ++i) {
      const auto& v = variables[i];
      if (!(c.col(i).array() >= v.lower - 1e-9 * v.scale).all() ||
          !(c.col(i).array() <= v.upper + 1e-9 * v.scale).all())
        wrong.miss("a point in the box decodes to " + v.name + " outside its bounds" + at);
    }
  }
  return wrong.outcome();
}

Outcome same_bits_on_two_threads(const Bench& bench) {
  const auto t = bench.make<Trajectory>();
  const Manipulation m = skew(*t, 1);
  const auto run = [&](Positions& targets, Vector& gradient) {
    RandomStream random(18);
    Vector state = t->initial_state(m);
    for (Index k = 0; k < 200; ++k) state = t->advance(m, state, random_control(*t, random));
    targets = t->targets(m, state);
    gradient = t->targets_pullback(m, t->initial_state(m), Positions::Ones(t->hands(), 3));
  };
  Positions x[3];
  Vector g[3];
  run(x[0], g[0]);
  on_two_threads([&] { run(x[1], g[1]); }, [&] { run(x[2], g[2]); });
  return {differing(x[0], x[1]) + differing(x[0], x[2]) + differing(g[0], g[1]) + differing(g[0], g[2]), ""};
}

Outcome refuses_bad_shapes(const Bench& bench) {
  const auto t = bench.make<Trajectory>();
  const Manipulation m = skew(*t, 0);
  const Vector state = t->initial_state(m);
  const Vector control = t->default_controls(1).row(0).transpose();
  const Vector long_state = Vector::Zero(state.size() + 1), long_control = Vector::Zero(control.size() + 1);
  const Vector x = t->encode(t->default_controls(3), state);
  const Vector long_x = Vector::Zero(x.size() + 1);
  Refusals refusals;
  Vector a, b;
  refusals.wants<ShapeError>("advance() with too long a state", [&] { t->advance(m, long_state, control); });
  refusals.wants<ShapeError>("advance() with too short a state",
                             [&] { t->advance(m, state.head(state.size() - 1), control); });
  refusals.wants<ShapeError>("advance() with too long a control", [&] { t->advance(m, state, long_control); });
  refusals.wants<ShapeError>("targets() with too long a state", [&] { t->targets(m, long_state); });
  refusals.wants<ShapeError>("advance_pullback() with too long a state",
                             [&] { t->advance_pullback(m, long_state, control, state, a, b); });
  refusals.wants<ShapeError>("advance_pullback() with too long a cotangent",
                             [&] { t->advance_pullback(m, state, control, long_state, a, b); });
  refusals.wants<ShapeError>("targets_pullback() with too many hands",
                             [&] { t->targets_pullback(m, state, Positions::Zero(t->hands() + 1, 3)); });
  refusals.wants<ShapeError>("progress() of too long a state", [&] { t->progress(long_state); });
  refusals.wants<ShapeError>("decode() of too long an x", [&] { t->decode(long_x, 3, state); });
  refusals.wants<ShapeError>("decode_pullback() with too few rows",
                             [&] { t->decode_pullback(x, 3, state, t->default_controls(2)); });
  refusals.wants<ShapeError>("encode() with too many columns",
                             [&] { t->encode(Controls::Zero(3, control.size() + 1), state); });
  Manipulation crowded = m;
  crowded.grasp_points = Positions::Zero(t->hands() + 1, 3);
  refusals.wants<Error>("a manipulation with a hand too many", [&] { t->initial_state(crowded); });
  return refusals.outcome();
}

}  // namespace
}  // namespace of_trajectories

void probe_trajectory(const Bench& bench) {
  using namespace of_trajectories;
  const auto t = bench.make<Trajectory>();
  const Manipulation m = skew(*t, 0);
  t->targets(m, t->advance(m, t->initial_state(m), t->default_controls(1).row(0).transpose()));
}

const std::vector<Law>& trajectory_laws() {
  using namespace of_trajectories;
  static const std::vector<Law> laws = {
      {"variables_are_well_formed", "Names are unique, bounds finite around the defaults, scales > 0 (violations).", 0,
       variables_are_well_formed},
      {"starts_at_the_grasp_points", "At initial_state the targets are the grasp points (m).", 1e-12,
       starts_at_the_grasp_points},
      {"advance_pullback_is_exact", "advance_pullback agrees with central differences (relative).", 1e-6,
       advance_pullback_is_exact},
      {"targets_pullback_is_exact", "targets_pullback agrees with central differences (relative).", 1e-6,
       targets_pullback_is_exact},
      {"path_is_continuous", "Targets move little per frame and stay finite for default and random controls (m).", 0.05,
       path_is_continuous},
      {"never_below_contact_height", "Targets never go below contact height (m).", 0, never_below_contact_height},
      {"default_controls_release", "progress() is 0 at the start and reaches 1 under the default controls (segments).",
       25, default_controls_release},
      {"decode_encode_round_trip", "decode(encode(controls)) returns the controls (in scales).", 1e-9,
       decode_encode_round_trip},
      {"decode_pullback_is_exact", "decode_pullback agrees with central differences (relative).", 1e-6,
       decode_pullback_is_exact},
      {"decision_box_is_sound",
       "The decision box is finite, holds the default and decodes into the controls' bounds (violations).", 0,
       decision_box_is_sound},
      {"same_bits_on_two_threads", "Two threads get the bits of one (numbers that differ).", 0,
       same_bits_on_two_threads},
      {"refuses_bad_shapes", "Wrong sizes are refused with ShapeError (accepted).", 0, refuses_bad_shapes},
  };
  return laws;
}

}  // namespace weft::conformance
