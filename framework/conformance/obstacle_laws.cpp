#include <Eigen/Geometry>
#include <cmath>

#include "conformance/simulator_kit.hpp"

namespace weft::conformance {
namespace of_simulators {
namespace {

/// A box whose top goes through the origin, turned about y by `angle`.
Obstacle box(double angle, const Vec3& half_size) {
  Obstacle o;
  o.kind = Obstacle::Kind::box;
  o.name = "box";
  o.axes = Eigen::AngleAxisd(angle, Eigen::Vector3d::UnitY()).toRotationMatrix();
  o.half_size = half_size;
  o.centre = -half_size.z() * o.axes.col(2);
  o.rounding = 0.005;
  return o;
}

/// A cylinder with an upright axis and a bar beside it, both under the sheet, and a slope that it may slide on.
Scene among_obstacles() {
  Scene scene;
  scene.ground_height = -0.1;
  Obstacle post, slope;
  post.kind = Obstacle::Kind::cylinder;
  post.name = "cylinder";
  post.half_size = {0.06, 0.06, 0.05};
  post.centre = {0.15, 0.08, -0.05};
  post.rounding = 0.01;
  Obstacle bar = post;
  bar.axes.col(0) = Vec3(0.0, 0.0, -1.0);
  bar.axes.col(2) = Vec3(1.0, 0.0, 0.0);
  bar.half_size = {0.04, 0.04, 0.2};
  bar.centre = {0.15, 0.24, -0.04};
  slope.axes = Eigen::AngleAxisd(0.3, Eigen::Vector3d::UnitY()).toRotationMatrix();
  slope.centre = {0.3, 0.15, -0.1};
  scene.obstacles = {post, bar, slope};
  return scene;
}

/// The least distance of a vertex to an obstacle, in thicknesses beyond the first: negative where a vertex sinks in.
double clearance(const Scene& scene, const Positions& x) {
  Worst sunk;
  for (const Obstacle& obstacle : scene.obstacles)
    for (Index v = 0; v < x.rows(); ++v)
      sunk.add(1.0 - obstacle_distance(obstacle, x.row(v).transpose()).distance / plain_fabric().thickness_m);
  return -sunk.value();
}

/// A simulator without the capability must refuse a scene with obstacles, and say why.
Outcome refuses_obstacles(Simulator& sim) {
  Refusals refusals;
  try {
    sim.reset(sheet(0.03), plain_fabric(), among_obstacles());
    refusals.miss("a scene with obstacles was accepted");
  } catch (const ConfigError& error) {
    if (std::string(error.what()).find("obstacles") == std::string::npos)
      refusals.miss(std::string("the refusal does not name obstacles: ") + error.what());
  } catch (const std::exception& error) {
    refusals.miss(std::string("obstacles threw no ConfigError: ") + error.what());
  }
  const Outcome outcome = refusals.outcome();
  return outcome.measured > 0 ? outcome : Outcome{0.0, "not declared; throws ConfigError"};
}

Outcome starts_clear_of_obstacles(const Bench& bench) {
  const auto sim = bench.make<Simulator>();
  if (!sim->capabilities().obstacles) return refuses_obstacles(*sim);
  const Scene scene = among_obstacles();
  sim->reset(sheet(), plain_fabric(), scene);
  Worst worst;
  worst.add((sim->positions() - start_positions(*sheet(), scene, plain_fabric().thickness_m)).cwiseAbs());
  return worst.outcome();
}

Outcome nothing_sinks_into_obstacles(const Bench& bench) {
  const auto sim = bench.make<Simulator>();
  if (!sim->capabilities().obstacles) return refuses_obstacles(*sim);
  const Scene scene = among_obstacles();
  sim->reset(sheet(0.03), damped_fabric(), scene);
  Worst worst;
  for (Index k = 0; k < 60; ++k) {
    sim->step(kNothing);
    worst.add(-clearance(scene, sim->positions()));
  }
  return worst.outcome();
}

/// Mean distance, m, that a sheet slides in half a second down a box that is tilted by `slope` times the friction
/// coefficient.
double slide_on_box(Simulator& sim, double slope) {
  const Fabric fabric = plain_fabric();
  Scene scene;
  scene.ground_height.reset();
  scene.obstacles = {box(std::atan(slope * fabric.friction), {2.0, 2.0, 0.2})};
  const auto axes = scene.obstacles[0].axes;
  auto garment = std::make_shared<Garment>(*sheet());
  garment->positions = garment->positions * axes.transpose();
  sim.reset(garment, fabric, scene);
  const Positions start = sim.positions();
  for (Index k = 0; k < 30; ++k) sim.step(kNothing);
  return ((sim.positions() - start) * axes.col(0)).mean();
}

Outcome sticks_to_a_tilted_obstacle(const Bench& bench) {
  const auto sim = bench.make<Simulator>();
  if (!sim->capabilities().obstacles) return refuses_obstacles(*sim);
  return {std::abs(slide_on_box(*sim, 0.9)), ""};
}

Outcome slides_on_a_tilted_obstacle(const Bench& bench) {
  const auto sim = bench.make<Simulator>();
  if (!sim->capabilities().obstacles) return refuses_obstacles(*sim);
  const double mu = plain_fabric().friction, alpha = std::atan(1.3 * mu), t = 30 * kFrameSeconds;
  const double wanted = 0.5 * kGravity * (std::sin(alpha) - mu * std::cos(alpha)) * t * t;
  const double got = slide_on_box(*sim, 1.3);
  return {std::abs(got / wanted - 1.0), "slid " + number(got) + " m, Coulomb says " + number(wanted) + " m"};
}

Outcome restored_among_obstacles_is_bit_exact(const Bench& bench) {
  const auto sim = bench.make<Simulator>(), other = bench.make<Simulator>();
  if (!sim->capabilities().obstacles) return refuses_obstacles(*sim);
  if (!sim->capabilities().snapshots) return undeclared_without_call();
  for (const auto& one : {sim, other}) one->reset(sheet(0.01), damped_fabric(), among_obstacles());
  for (Index k = 0; k < 6; ++k) sim->step(kNothing);  // it touches, and its borders still fall
  const auto snapshot = sim->save();
  for (Index k = 0; k < 20; ++k) sim->step(kNothing);
  other->step(kNothing);
  other->restore(*snapshot);
  for (Index k = 0; k < 20; ++k) other->step(kNothing);
  return {differing_state(*sim, *other), ""};
}

}  // namespace
}  // namespace of_simulators

std::vector<Law> obstacle_laws() {
  using namespace of_simulators;
  return {
      {"starts_clear_of_obstacles",
       "obstacles: reset() moves vertices out of obstacles to the thickness (m); undeclared: obstacles are refused with "
       "ConfigError.",
       1e-9, starts_clear_of_obstacles},
      {"nothing_sinks_into_obstacles",
       "obstacles: no vertex sinks into a post, a bar or a slope in a drop (in thicknesses).", 0.25,
       nothing_sinks_into_obstacles},
      {"sticks_to_a_tilted_obstacle", "obstacles: on a box tilted by tan = 0.9 mu the sheet stays (m, 0.5 s).", 1e-3,
       sticks_to_a_tilted_obstacle},
      {"slides_on_a_tilted_obstacle", "obstacles: at tan = 1.3 mu it slides by Coulomb's law (relative, 0.5 s).", 0.1,
       slides_on_a_tilted_obstacle},
      {"restored_among_obstacles_is_bit_exact",
       "obstacles, snapshots: a run restored while the sheet touches obstacles continues bit for bit (numbers that "
       "differ).",
       0, restored_among_obstacles_is_bit_exact},
  };
}

}  // namespace weft::conformance
