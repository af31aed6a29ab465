// The laws of a simulator. Sheets are coarse and runs short: the laws check whether a simulator is right, not how
// accurate it is. More than 700 lines: a table of laws, one function each.
#include <algorithm>
#include <functional>
#include <numbers>

#include "conformance/simulator_kit.hpp"
#include "meshes/intersections.hpp"
#include "meshes/sewing.hpp"
#include "weft/rest_shape.hpp"

namespace weft::conformance {
namespace of_simulators {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
constexpr Index kCorners[] = {0, kSide*(kSide - 1)};  // of the edge x = 0

Scene free_space() {
  Scene scene;
  scene.ground_height.reset();
  return scene;
}

Positions held(const Simulator& simulator) {
  const auto vertices = simulator.grasped();
  Positions points(vertices.size(), 3);
  for (std::size_t i = 0; i < vertices.size(); ++i) points.row(i) = simulator.positions().row(vertices[i]);
  return points;
}

/// Targets of two hands, `frame` frames after they grasped the edge at `start`: half a circle over the sheet along
/// `heading`.
constexpr Index kCarryFrames = 48;
Positions carry(const Positions& start, Index frame, const Vec3& heading = {1.0, 0.0, 0.0}) {
  const double t = std::numbers::pi * static_cast<double>(std::min(frame, kCarryFrames)) / kCarryFrames;
  constexpr double radius = 0.12;
  Positions targets = start;
  targets.rowwise() += (radius * (1.0 - std::cos(t)) * heading).transpose();
  targets.col(2).array() += radius * std::sin(t) + 0.005 * (1.0 - std::cos(t));
  return targets;
}

/// The standard run: a sheet on the ground, two corners carried for `frames` frames.
struct Carry {
  explicit Carry(std::shared_ptr<Simulator> simulator) : sim(std::move(simulator)) {
    sim->reset(sheet(), plain_fabric(), Scene());
    sim->grasp(kCorners);
    start = held(*sim);
  }
  void run(Index from, Index to) {
    for (Index k = from; k < to; ++k) sim->step(carry(start, k + 1));
  }
  std::shared_ptr<Simulator> sim;
  Positions start;
};

// ---------------------------------------------------------------------------------------------------------------------

double fall_error(Simulator& sim, const Vec3& gravity, const Vec3& velocity) {
  Scene scene = free_space();
  scene.gravity = gravity;
  scene.initial_velocity = velocity;
  sim.reset(sheet(1.0), plain_fabric(), scene);
  const Positions start = sim.positions();
  constexpr Index frames = 30;
  for (Index k = 0; k < frames; ++k) sim.step(kNothing);
  const double t = frames * kFrameSeconds;
  const Vec3 fall = 0.5 * t * t * gravity;
  const Positions wanted = start.rowwise() + (t * velocity + fall).transpose();
  return (sim.positions() - wanted).rowwise().norm().maxCoeff() / fall.norm();
}

Outcome falls_freely(const Bench& bench) {
  return {fall_error(*bench.make<Simulator>(), {0.0, 0.0, -kGravity}, {0.3, -0.2, 0.5}), ""};
}

Outcome gravity_any_direction(const Bench& bench) {
  const auto sim = bench.make<Simulator>();
  const Vec3 gravity(4.0, -3.0, 2.0);
  if (sim->capabilities().gravity_any_direction) return {fall_error(*sim, gravity, Vec3::Zero()), ""};
  Refusals refusals;
  Scene scene = free_space();
  scene.gravity = gravity;
  refusals.wants<Unsupported, ConfigError>("a tilted gravity", [&] { sim->reset(sheet(1.0), plain_fabric(), scene); });
  return refusals.outcome().measured > 0 ? refusals.outcome() : undeclared();
}

Outcome rest_stays_at_rest(const Bench& bench) {
  const auto sim = bench.make<Simulator>();
  sim->reset(sheet(), plain_fabric(), Scene());
  const Positions start = sim->positions();
  for (Index k = 0; k < 60; ++k) sim->step(kNothing);
  return {(sim->positions() - start).rowwise().norm().maxCoeff(), ""};
}

Outcome reset_lifts_to_contact_height(const Bench& bench) {
  const auto sim = bench.make<Simulator>();
  Scene scene;
  scene.ground_height = 0.25;
  const Fabric fabric = plain_fabric();
  const auto garment = sheet(0.0);
  sim->reset(garment, fabric, scene);
  const double wanted = 0.25 + fabric.thickness_m;
  const Positions& x = sim->positions();
  return {std::max((x.col(2).array() - wanted).abs().maxCoeff(),
                   (x - garment->positions).leftCols<2>().cwiseAbs().maxCoeff()),
          ""};
}

/// Two sheets over each other in one garment: a chart, and layers 0 and 1.
std::shared_ptr<const Garment> two_sheets() {
  const auto one = sheet();
  const Index n = one->vertex_count();
  Mesh mesh;
  mesh.source = "conformance two sheets";
  mesh.positions.resize(2 * n, 3);
  mesh.positions << one->positions, one->positions;
  mesh.rest.resize(2 * n, 2);
  mesh.rest << one->rest, one->rest;
  mesh.faces.resize(2 * one->face_count(), 3);
  mesh.faces << one->faces, (one->faces.array() + static_cast<int>(n)).matrix();
  GarmentForm form;
  form.layers.assign(2 * n, 0.0);
  std::fill(form.layers.begin() + static_cast<std::ptrdiff_t>(n), form.layers.end(), 1.0);
  return std::make_shared<const Garment>(make_garment(mesh, "two sheets", {}, std::move(form)));
}

Outcome reset_lays_layers_above_each_other(const Bench& bench) {
  const auto sim = bench.make<Simulator>();
  Scene scene;
  scene.ground_height = 0.25;
  const Fabric fabric = plain_fabric();
  const auto garment = two_sheets();
  sim->reset(garment, fabric, scene);
  Worst worst;
  for (Index v = 0; v < garment->vertex_count(); ++v)
    worst.add(std::abs(sim->positions()(v, 2) - 0.25 - (garment->layer(v) + 1.0) * fabric.thickness_m));
  return worst.outcome();
}

/// A simulator without the capability must refuse this garment.
Outcome refuses_form(Simulator& sim, const std::shared_ptr<const Garment>& garment, const std::string& what) {
  Refusals refusals;
  refusals.wants<ConfigError>("a garment with " + what, [&] { sim.reset(garment, plain_fabric(), Scene()); });
  return refusals.outcome().measured > 0 ? refusals.outcome() : undeclared();
}

/// The garment is drawn a fifth too narrow, and its frames are those of the sheet as it should be.
Outcome frames_are_the_rest_shape(const Bench& bench) {
  const auto right = sheet();
  Mesh mesh;
  mesh.source = "conformance frames";
  mesh.positions = right->positions;
  mesh.positions.col(0) *= 0.8;
  mesh.faces = right->faces;
  GarmentForm form;
  form.frames = frames_of_shape(right->positions, right->faces, {false, Vec3(0.8, 0.6, 0.0)});
  const auto garment = std::make_shared<const Garment>(make_garment(mesh, "frames", {}, std::move(form)));
  const auto sim = bench.make<Simulator>();
  if (!sim->capabilities().rest_frames) return refuses_form(*sim, garment, "rest frames");
  const Fabric fabric = plain_fabric();
  sim->reset(garment, fabric, Scene());
  const Positions start = positions_on_ground(*right, 0.0, fabric.thickness_m);
  sim->set_state(start, Positions::Zero(start.rows(), 3), {});
  for (Index k = 0; k < 60; ++k) sim->step(kNothing);
  return {(sim->positions() - start).rowwise().norm().maxCoeff(), ""};
}

/// A sheet is bent sharply along a seam, in free space and without gravity. Nothing straightens it.
Outcome seams_carry_no_moment(const Bench& bench) {
  const auto flat = sheet();
  Mesh mesh{flat->positions, flat->faces, flat->rest, "conformance seam"};
  GarmentForm form;
  constexpr Index middle = kSide / 2;
  form.seams.resize(kSide - 1, 2);
  for (Index r = 0; r + 1 < kSide; ++r)
    form.seams.row(r) << static_cast<int>(r * kSide + middle), static_cast<int>((r + 1) * kSide + middle);
  const auto garment = std::make_shared<const Garment>(make_garment(mesh, "seam", {}, std::move(form)));
  const auto sim = bench.make<Simulator>();
  if (!sim->capabilities().rest_frames) return refuses_form(*sim, garment, "seams");
  Scene scene = free_space();
  scene.gravity.setZero();
  sim->reset(garment, plain_fabric(), scene);
  Positions start = flat->positions;
  const double edge = start(middle, 0);
  for (Index v = 0; v < start.rows(); ++v) {
    const double beyond = start(v, 0) - edge;
    if (beyond > 0.0) start.row(v) << edge + 0.5 * beyond, start(v, 1), std::sqrt(0.75) * beyond;
  }
  sim->set_state(start, Positions::Zero(start.rows(), 3), {});
  for (Index k = 0; k < 30; ++k) sim->step(kNothing);
  return {(sim->positions() - start).rowwise().norm().maxCoeff(), ""};
}

/// A pillowcase, open at one side, carried like the sheet of the other laws.
Outcome sewn_layers_do_not_cross(const Bench& bench) {
  const auto front = sheet();
  const double open = front->positions.col(0).maxCoeff() - 1e-9;
  SewnMesh sewn = sew_front_and_back({front->positions, front->faces, RestPositions(0, 2), "conformance pillowcase"},
                                     [&](const Vec2& a, const Vec2& b) { return a.x() < open || b.x() < open; });
  const auto garment = std::make_shared<const Garment>(make_garment(sewn.mesh, "pillowcase", {}, std::move(sewn.form)));
  const auto sim = bench.make<Simulator>();
  if (!sim->capabilities().rest_frames) return refuses_form(*sim, garment, "rest frames and layers");
  if (!sim->capabilities().self_contact) return undeclared_without_call();
  sim->reset(garment, damped_fabric(), Scene());
  Index crossings = count_intersections(sim->positions(), garment->faces);
  sim->grasp(kCorners);
  const Positions start = held(*sim);
  for (Index k = 0; k < kCarryFrames; ++k) {
    sim->step(carry(start, k + 1));
    crossings = std::max(crossings, count_intersections(sim->positions(), garment->faces));
  }
  sim->release();
  sim->settle({});
  crossings = std::max(crossings, count_intersections(sim->positions(), garment->faces));
  return {static_cast<double>(crossings), ""};
}

Outcome reset_forgets(const Bench& bench) {
  Carry used(bench.make<Simulator>());
  used.run(0, 20);
  Carry again(used.sim), fresh(bench.make<Simulator>());
  if (again.sim->frame() != 0) return failed("frame() = " + std::to_string(again.sim->frame()) + " after reset");
  again.run(0, 20);
  fresh.run(0, 20);
  return {differing_state(*again.sim, *fresh.sim), ""};
}

Outcome pinned_stays_pinned(const Bench& bench) {
  const auto sim = bench.make<Simulator>();
  Scene scene = free_space();
  scene.pins = {0, kSide - 1, kSide * kSide - 1};
  if (!sim->capabilities().pins) {
    Refusals refusals;
    refusals.wants<Unsupported, ConfigError>("a scene with pins",
                                             [&] { sim->reset(sheet(1.0), plain_fabric(), scene); });
    return refusals.outcome().measured > 0 ? refusals.outcome() : undeclared();
  }
  scene.initial_velocity = {0.2, 0.0, 0.0};
  sim->reset(sheet(1.0), plain_fabric(), scene);
  const Positions start = sim->positions();
  double worst = 0.0;
  for (Index k = 0; k < 30; ++k) {
    sim->step(kNothing);
    for (Index pin : scene.pins) worst = std::max(worst, (sim->positions().row(pin) - start.row(pin)).norm());
  }
  if ((sim->positions() - start).rowwise().norm().maxCoeff() < 0.01) return failed("no vertex moved");
  return {worst, ""};
}

Outcome grasp_moves_nothing(const Bench& bench) {
  const auto sim = bench.make<Simulator>();
  sim->reset(sheet(), plain_fabric(), Scene());
  const Positions before = sim->positions();
  sim->grasp(kCorners);
  double worst = (sim->positions() - before).cwiseAbs().maxCoeff();
  const Positions hold = held(*sim);
  for (Index k = 0; k < 5; ++k) sim->step(hold);
  sim->release();
  if (!sim->grasped().empty()) return failed("grasped() is not empty after release()");
  for (Index k = 0; k < 10; ++k) sim->step(kNothing);
  worst = std::max(worst, (sim->positions() - before).cwiseAbs().maxCoeff());
  return {worst, ""};
}

Outcome held_vertex_follows_its_target(const Bench& bench) {
  Carry run(bench.make<Simulator>());
  double worst = 0.0;
  for (Index k = 0; k < 30; ++k) {
    const Positions targets = carry(run.start, k + 1);
    run.sim->step(targets);
    worst = std::max(worst, (held(*run.sim) - targets).cwiseAbs().maxCoeff());
  }
  // Targets are in the order of grasped(), also after one of three vertices is released.
  const Index middle = kSide * (kSide / 2);
  run.sim->grasp(std::span(&middle, 1));
  if (run.sim->grasped() != std::vector<Index>{kCorners[0], kCorners[1], middle})
    return failed("grasped() is not in the order of the calls to grasp()");
  run.sim->release(std::span(kCorners, 1));
  if (run.sim->grasped() != std::vector<Index>{kCorners[1], middle})
    return failed("grasped() is wrong after release(vertices)");
  Positions targets = held(*run.sim);
  for (Index k = 0; k < 5; ++k) {
    targets.col(2).array() += 0.002;
    run.sim->step(targets);
    worst = std::max(worst, (held(*run.sim) - targets).cwiseAbs().maxCoeff());
  }
  return {worst, ""};
}

Outcome release_leaves_no_kick(const Bench& bench) {
  // The vertices swing upwards at 1.2 m/s. After release they start at rest.
  const auto sim = bench.make<Simulator>();
  sim->reset(sheet(0.5), plain_fabric(), Scene());
  sim->grasp(kCorners);
  Positions targets = held(*sim);
  for (Index k = 0; k < 10; ++k) {
    targets.col(2).array() += 0.02;
    sim->step(targets);
  }
  const Positions before = sim->positions();
  sim->release();
  double worst = (sim->positions() - before).cwiseAbs().maxCoeff() / kFrameSeconds;
  for (Index v : kCorners) worst = std::max(worst, sim->velocities().row(v).norm());
  return {worst, ""};
}

Outcome one_hand_lets_go(const Bench& bench) {
  const auto sim = bench.make<Simulator>();
  sim->reset(sheet(), plain_fabric(), Scene());
  sim->grasp(kCorners);
  Positions targets = held(*sim);
  const Index freed = kCorners[0], kept = kCorners[1];
  const auto up = [&](Index frames, double step) {
    for (Index k = 0; k < frames; ++k) {
      targets.col(2).array() += step;
      sim->step(targets);
    }
  };
  const double low = sim->positions()(freed, 2);
  up(20, 0.008);
  const double high = sim->positions()(freed, 2);
  sim->release(std::span(&freed, 1));
  if (sim->grasped() != std::vector<Index>{kept}) return failed("grasped() is not the vertex of the other hand");
  if (sim->velocities().row(freed).norm() > 1e-9) return failed("the vertex that was let go gets a kick");
  targets = held(*sim);
  for (Index k = 0; k < 3; ++k) {
    up(10, 0.001);
    if ((held(*sim) - targets).cwiseAbs().maxCoeff() > 1e-12) return failed("the other vertex leaves its target");
  }
  return {(sim->positions()(freed, 2) - low) / (high - low), ""};
}

Outcome frames_are_counted(const Bench& bench) {
  Carry run(bench.make<Simulator>());
  double wrong = run.sim->frame() == 0 ? 0.0 : 1.0;
  run.run(0, 7);
  if (run.sim->frame() != 7) ++wrong;
  SettleCriterion criterion;
  criterion.max_frames = 5;
  criterion.speed = 1e-12;
  const auto settled = run.sim->settle(criterion);
  if (settled.frames > 5) ++wrong;
  if (run.sim->frame() != 7 + settled.frames) ++wrong;
  return {wrong, wrong > 0 ? "frame() = " + std::to_string(run.sim->frame()) + " after 7 + " +
                                 std::to_string(settled.frames) + " frames"
                           : ""};
}

Outcome settles(const Bench& bench) {
  const auto sim = bench.make<Simulator>();
  sim->reset(sheet(0.02), damped_fabric(), Scene());
  SettleCriterion criterion;
  criterion.max_frames = 600;
  const auto result = sim->settle(criterion);
  const double speed = sim->velocities().rowwise().norm().maxCoeff();
  if (!result.settled) return failed("not settled after 600 frames, speed " + number(result.max_speed) + " m/s");
  if (speed >= criterion.speed) return failed("called settled at " + number(speed) + " m/s");
  if (std::abs(speed - result.max_speed) > 1e-9)
    return failed("reports " + number(result.max_speed) + " m/s, moves at " + number(speed) + " m/s");
  if (result.frames < criterion.hold_frames) return failed("settled before hold_frames had passed");
  return {(sim->positions().col(2).array() - plain_fabric().thickness_m).abs().maxCoeff(), ""};
}

Outcome settle_keeps_held_vertices(const Bench& bench) {
  Carry run(bench.make<Simulator>());
  run.run(0, 12);
  const Positions before = held(*run.sim);
  SettleCriterion criterion;
  criterion.max_frames = 20;
  run.sim->settle(criterion);
  if (run.sim->grasped().size() != 2) return failed("settle() changed what is held");
  return {(held(*run.sim) - before).cwiseAbs().maxCoeff(), ""};
}

Outcome settle_can_be_split(const Bench& bench) {
  const auto settle = [&](Index at_once) {
    Carry run(bench.make<Simulator>());
    run.run(0, 12);
    run.sim->release();
    // A sheet that stops completely ends the one call early, and the others too.
    bool stopped = false;
    for (Index done = 0; done < 5 && !stopped; done += at_once) stopped = run.sim->settle({1e-12, 1, at_once}).settled;
    return run.sim;
  };
  return {differing_state(*settle(5), *settle(1)), ""};
}

Outcome set_state_is_taken(const Bench& bench) {
  const auto sim = bench.make<Simulator>();
  sim->reset(sheet(), plain_fabric(), Scene());
  Positions x = sim->positions(), v = Positions::Zero(x.rows(), 3);
  RandomStream random(3);
  for (Index i = 0; i < x.rows(); ++i) {
    x(i, 2) += 0.3 + 0.001 * random.normal();
    v.row(i) << 0.01 * random.normal(), 0.01 * random.normal(), 0.01 * random.normal();
  }
  const std::vector<Index> hands = {kCorners[1], kCorners[0]};
  for (Index hand : hands) v.row(hand).setZero();
  sim->set_state(x, v, hands);
  double wrong = differing(sim->positions(), x) + differing(sim->velocities(), v);
  if (sim->grasped() != hands) ++wrong;
  // Two runs from the same observed state agree, also after different histories.
  Carry used(bench.make<Simulator>());
  used.run(0, 20);
  used.sim->set_state(x, v, hands);
  const Positions targets = held(*sim);
  for (Index k = 0; k < 6; ++k) {
    sim->step(targets);
    used.sim->step(targets);
  }
  wrong += differing(sim->positions(), used.sim->positions());
  return {wrong, ""};
}

Outcome nothing_sinks(const Bench& bench) {
  // A sheet dropped from 3 cm, then folded over.
  const auto sim = bench.make<Simulator>();
  const Fabric fabric = plain_fabric();
  double worst = 0.0;
  const auto look = [&] {
    worst = std::max(worst, (fabric.thickness_m - sim->positions().col(2).minCoeff()) / fabric.thickness_m);
  };
  sim->reset(sheet(0.03), fabric, Scene());
  for (Index k = 0; k < 40; ++k) {
    sim->step(kNothing);
    look();
  }
  Carry run(sim);
  for (Index k = 0; k < kCarryFrames; ++k) {
    run.run(k, k + 1);
    look();
  }
  sim->release();
  for (Index k = 0; k < 30; ++k) {
    sim->step(kNothing);
    look();
  }
  return {worst, ""};
}

/// The small fold of the self-contact laws: carry, release, settle; `look` after every frame.
void fold(Simulator& sim, const std::function<void(bool last)>& look) {
  sim.reset(sheet(), damped_fabric(), Scene());
  sim.grasp(kCorners);
  const Positions start = held(sim);
  for (Index k = 0; k < kCarryFrames; ++k) {
    sim.step(carry(start, k + 1));
    look(false);
  }
  sim.release();
  for (Index k = 0; k < 60; ++k) {
    sim.step(kNothing);
    look(k == 59);
  }
}

Outcome layers_do_not_cross(const Bench& bench) {
  const auto sim = bench.make<Simulator>();
  if (!sim->capabilities().self_contact) return undeclared_without_call();
  const auto garment = sheet();
  Index worst = 0;
  fold(*sim, [&](bool) { worst = std::max(worst, count_intersections(sim->positions(), garment->faces)); });
  return {static_cast<double>(worst), ""};
}

/// Distance of a point to a triangle [Ericson 2005, Real-Time Collision Detection, sec. 5.1.5].
double distance(const Vec3& p, const Vec3& a, const Vec3& b, const Vec3& c) {
  const Vec3 ab = b - a, ac = c - a, ap = p - a;
  const double d1 = ab.dot(ap), d2 = ac.dot(ap);
  if (d1 <= 0 && d2 <= 0) return ap.norm();
  const Vec3 bp = p - b;
  const double d3 = ab.dot(bp), d4 = ac.dot(bp);
  if (d3 >= 0 && d4 <= d3) return bp.norm();
  const double vc = d1 * d4 - d3 * d2;
  if (vc <= 0 && d1 >= 0 && d3 <= 0) return (ap - d1 / (d1 - d3) * ab).norm();
  const Vec3 cp = p - c;
  const double d5 = ab.dot(cp), d6 = ac.dot(cp);
  if (d6 >= 0 && d5 <= d6) return cp.norm();
  const double vb = d5 * d2 - d1 * d6;
  if (vb <= 0 && d2 >= 0 && d6 <= 0) return (ap - d2 / (d2 - d6) * ac).norm();
  const double va = d3 * d6 - d5 * d4;
  if (va <= 0 && d4 - d3 >= 0 && d5 - d6 >= 0) return (bp - (d4 - d3) / ((d4 - d3) + (d5 - d6)) * (c - b)).norm();
  const double whole = va + vb + vc;
  return (ap - vb / whole * ab - vc / whole * ac).norm();
}

Outcome layers_keep_their_distance(const Bench& bench) {
  const auto sim = bench.make<Simulator>();
  if (!sim->capabilities().self_contact) return undeclared_without_call();
  const Faces faces = sheet()->faces;
  double least = std::numeric_limits<double>::infinity();
  fold(*sim, [&](bool last) {
    if (!last) return;
    const Positions& x = sim->positions();
    for (Index v = 0; v < x.rows(); ++v) {
      for (Index f = 0; f < faces.rows(); ++f) {
        if ((faces.row(f).array() == static_cast<int>(v)).any()) continue;
        least = std::min(least, distance(x.row(v), x.row(faces(f, 0)), x.row(faces(f, 1)), x.row(faces(f, 2))));
      }
    }
  });
  return {1.0 - least / damped_fabric().thickness_m, "least distance " + number(1e3 * least) + " mm"};
}

/// Mean distance, m, that a sheet slides down an incline in half a second. tan(incline) = `slope` times the friction
/// coefficient.
double slide(Simulator& sim, double slope) {
  const Fabric fabric = plain_fabric();
  const double alpha = std::atan(slope * fabric.friction);
  Scene scene;
  scene.gravity = {kGravity * std::sin(alpha), 0.0, -kGravity * std::cos(alpha)};
  sim.reset(sheet(), fabric, scene);
  const Positions start = sim.positions();
  for (Index k = 0; k < 30; ++k) sim.step(kNothing);
  return (sim.positions() - start).col(0).mean();
}

Outcome sticks_below_the_friction_threshold(const Bench& bench) {
  const auto sim = bench.make<Simulator>();
  const auto capabilities = sim->capabilities();
  if (!capabilities.ground_friction) return undeclared_without_call();
  if (!capabilities.gravity_any_direction) return failed("ground_friction needs gravity_any_direction to be measured");
  return {std::abs(slide(*sim, 0.9)), ""};
}

Outcome slides_above_the_friction_threshold(const Bench& bench) {
  const auto sim = bench.make<Simulator>();
  const auto capabilities = sim->capabilities();
  if (!capabilities.ground_friction) return undeclared_without_call();
  if (!capabilities.gravity_any_direction) return failed("ground_friction needs gravity_any_direction to be measured");
  const double mu = plain_fabric().friction, alpha = std::atan(1.3 * mu), t = 30 * kFrameSeconds;
  const double wanted = 0.5 * kGravity * (std::sin(alpha) - mu * std::cos(alpha)) * t * t;
  const double got = slide(*sim, 1.3);
  return {std::abs(got / wanted - 1.0), "slid " + number(got) + " m, Coulomb says " + number(wanted) + " m"};
}

/// Mean elongation, m, over two seconds, of a strip that hangs by one edge along x (warp) or y (weft) in free space.
double elongation(Simulator& sim, const Fabric& fabric, bool along_weft) {
  Scene scene = free_space();
  scene.gravity = along_weft ? Vec3(0.0, kGravity, 0.0) : Vec3(kGravity, 0.0, 0.0);
  sim.reset(sheet(), fabric, scene);
  std::vector<Index> hands, ends;
  for (Index i = 0; i < kSide; ++i) {
    hands.push_back(along_weft ? i : kSide * i);
    ends.push_back(along_weft ? kSide * (kSide - 1) + i : kSide * i + kSide - 1);
  }
  const Positions start = sim.positions();
  sim.grasp(hands);
  const Positions hold = held(sim);
  double sum = 0.0;
  constexpr Index frames = 120;
  for (Index k = 0; k < frames; ++k) {
    sim.step(hold);
    for (Index v : ends) sum += (sim.positions() - start)(v, along_weft ? 1 : 0);
  }
  return sum / static_cast<double>(frames * kSide);
}

/// Not orthotropic: a fabric whose warp and weft differ is refused, and the message names the key.
Outcome refuses_two_stiffnesses(Simulator& sim, const Fabric& stretch) {
  Fabric bend = plain_fabric(), tables = plain_fabric();
  bend.bend_warp_n_m = 2.0 * bend.bend_weft_n_m;
  tables.tables = std::make_shared<const MaterialTables>();
  Refusals refusals;
  const auto refuses = [&](const char* key, const Fabric& fabric) {
    try {
      sim.reset(sheet(), fabric, Scene());
      refusals.miss(std::string("a fabric whose ") + key + " differs between warp and weft was accepted");
    } catch (const ConfigError& error) {
      if (std::string(error.what()).find(key) == std::string::npos)
        refusals.miss(std::string("the refusal does not name ") + key + ": " + error.what());
    } catch (const std::exception& error) {
      refusals.miss(std::string(key) + " threw no ConfigError: " + error.what());
    }
  };
  refuses("stretch_n_per_m", stretch);
  refuses("bend_n_m", bend);
  refuses("tables", tables);
  const Outcome outcome = refusals.outcome();
  return outcome.measured > 0 ? outcome : Outcome{0.0, "not declared; throws ConfigError"};
}

Outcome stretches_by_direction(const Bench& bench) {
  const auto sim = bench.make<Simulator>();
  const auto capabilities = sim->capabilities();
  Fabric fabric = plain_fabric();
  fabric.stretch_warp_n_per_m = 80.0;
  fabric.stretch_weft_n_per_m = 20.0;
  if (!capabilities.orthotropic) return refuses_two_stiffnesses(*sim, fabric);
  if (!capabilities.gravity_any_direction) return failed("orthotropic needs gravity_any_direction to be measured");
  const double warp = elongation(*sim, fabric, false), weft = elongation(*sim, fabric, true);
  return {std::abs(std::log(weft / warp / 4.0)), "weft / warp = " + number(weft / warp) + ", stiffness says 4"};
}

Outcome restored_run_is_bit_exact(const Bench& bench, bool other_object) {
  Carry run(bench.make<Simulator>());
  if (!run.sim->capabilities().snapshots) {
    struct Foreign final : SimulatorSnapshot {};
    Refusals refusals;
    refusals.wants<Unsupported>("save()", [&] { run.sim->save(); });
    refusals.wants<Unsupported>("restore()", [&] { run.sim->restore(Foreign()); });
    return refusals.outcome().measured > 0 ? refusals.outcome() : undeclared();
  }
  // Saved while vertices are held; restored after the run went another way.
  run.run(0, 15);
  const auto snapshot = run.sim->save();
  const Positions x = run.sim->positions();
  run.run(15, 30);
  const auto reference = run.sim->save();
  const Positions wanted_x = run.sim->positions(), wanted_v = run.sim->velocities();
  const Index wanted_frame = run.sim->frame();

  Carry again(other_object ? bench.make<Simulator>() : run.sim);
  again.run(0, 3);
  again.sim->release();
  again.sim->step(kNothing);
  again.sim->restore(*snapshot);
  double wrong = differing(again.sim->positions(), x);
  again.start = run.start;
  again.run(15, 30);
  wrong += differing(again.sim->positions(), wanted_x) + differing(again.sim->velocities(), wanted_v);
  if (again.sim->frame() != wanted_frame) ++wrong;
  // The first snapshot can be used twice. The later one continues as the run itself does.
  again.sim->restore(*snapshot);
  wrong += differing(again.sim->positions(), x);
  again.sim->restore(*reference);
  wrong += differing(again.sim->positions(), wanted_x);
  again.sim->release();
  Carry straight(bench.make<Simulator>());
  straight.run(0, 30);
  straight.sim->release();
  for (Index k = 0; k < 5; ++k) {
    again.sim->step(kNothing);
    straight.sim->step(kNothing);
  }
  return {wrong + differing_state(*again.sim, *straight.sim), ""};
}
Outcome restores_in_place(const Bench& bench) { return restored_run_is_bit_exact(bench, false); }
Outcome restores_in_another_object(const Bench& bench) { return restored_run_is_bit_exact(bench, true); }

Outcome foreign_snapshots_are_refused(const Bench& bench) {
  const auto sim = bench.make<Simulator>();
  if (!sim->capabilities().snapshots) return undeclared();  // restored_run_is_bit_exact checks for Unsupported
  struct Foreign final : SimulatorSnapshot {};
  Refusals refusals;
  sim->reset(towel(4, 0.2), plain_fabric(), Scene());
  const auto other = sim->save();
  sim->reset(sheet(), plain_fabric(), Scene());
  refusals.wants<Error>("a snapshot of another plugin", [&] { sim->restore(Foreign()); });
  refusals.wants<Error>("a snapshot of another garment", [&] { sim->restore(*other); });
  return refusals.outcome();
}

Outcome same_calls_same_bits(const Bench& bench) {
  Carry a(bench.make<Simulator>()), b(bench.make<Simulator>());
  // The two objects take turns, to show that they do not affect one another.
  for (Index k = 0; k < 24; ++k) {
    a.run(k, k + 1);
    b.run(k, k + 1);
  }
  return {differing_state(*a.sim, *b.sim), ""};
}

Outcome same_bits_on_two_threads(const Bench& bench) {
  Carry alone(bench.make<Simulator>());
  alone.run(0, 24);
  std::shared_ptr<Simulator> sims[2] = {bench.make<Simulator>(), bench.make<Simulator>()};
  const auto go = [](const std::shared_ptr<Simulator>& sim) {
    Carry run(sim);
    run.run(0, 24);
  };
  on_two_threads([&] { go(sims[0]); }, [&] { go(sims[1]); });
  return {differing_state(*alone.sim, *sims[0]) + differing_state(*alone.sim, *sims[1]), ""};
}

/// Largest difference between the standard run and the same run in a world moved by (turn, shift), m.
double moved_run_error(const Bench& bench, double turn, const Vec3& shift) {
  Eigen::Matrix3d r = Eigen::Matrix3d::Identity();
  r.topLeftCorner<2, 2>() << std::cos(turn), -std::sin(turn), std::sin(turn), std::cos(turn);
  const auto move = [&](const Positions& x) {
    Positions y = x * r.transpose();
    y.rowwise() += shift.transpose();
    return y;
  };
  Carry plain(bench.make<Simulator>());
  auto garment = std::make_shared<Garment>(*sheet());
  garment->positions = move(garment->positions);
  const auto sim = bench.make<Simulator>();
  sim->reset(garment, plain_fabric(), Scene());
  sim->grasp(kCorners);
  double worst = 0.0;
  for (Index k = 0; k < 24; ++k) {
    const Positions targets = carry(plain.start, k + 1);
    plain.sim->step(targets);
    sim->step(move(targets));
    worst = std::max(worst, (sim->positions() - move(plain.sim->positions())).rowwise().norm().maxCoeff());
  }
  return worst;
}
Outcome translation_changes_nothing(const Bench& bench) { return {moved_run_error(bench, 0.0, {0.5, -0.25, 0.0}), ""}; }
Outcome turn_about_z_changes_nothing(const Bench& bench) { return {moved_run_error(bench, 0.7, Vec3::Zero()), ""}; }

Outcome refuses_nan(const Bench& bench) {
  Carry run(bench.make<Simulator>());
  run.run(0, 3);
  Refusals refusals;
  Positions bad = carry(run.start, 4);
  bad(1, 2) = kNaN;
  refusals.wants<Error>("step() with a NaN target", [&] { run.sim->step(bad); });
  bad(1, 2) = std::numeric_limits<double>::infinity();
  refusals.wants<Error>("step() with an infinite target", [&] { run.sim->step(bad); });
  Positions x = run.sim->positions(), v = run.sim->velocities();
  x(5, 0) = kNaN;
  refusals.wants<Error>("set_state() with a NaN position", [&] { run.sim->set_state(x, v, {}); });
  x = run.sim->positions();
  v(5, 0) = kNaN;
  refusals.wants<Error>("set_state() with a NaN velocity", [&] { run.sim->set_state(x, v, {}); });
  if (!run.sim->positions().allFinite() || !run.sim->velocities().allFinite())
    refusals.miss("a refused call left NaN in the state");
  return refusals.outcome();
}

Outcome refuses_bad_shapes(const Bench& bench) {
  Carry run(bench.make<Simulator>());
  Refusals refusals;
  const auto grasp = [&](Index v) { run.sim->grasp(std::span(&v, 1)); };
  const Index n = run.sim->positions().rows();
  refusals.wants<ShapeError>("step() with too few targets", [&] { run.sim->step(run.start.topRows(1)); });
  refusals.wants<ShapeError>("step() with too many targets", [&] { run.sim->step(Positions::Zero(3, 3)); });
  refusals.wants<ShapeError>("grasp() of vertex -1", [&] { grasp(-1); });
  refusals.wants<ShapeError>("grasp() of a vertex beyond the last", [&] { grasp(n); });
  refusals.wants<ShapeError>("grasp() of a held vertex", [&] { grasp(kCorners[0]); });
  refusals.wants<ShapeError>("set_state() with too few positions",
                             [&] { run.sim->set_state(Positions::Zero(n - 1, 3), Positions::Zero(n, 3), {}); });
  refusals.wants<ShapeError>("set_state() with too few velocities",
                             [&] { run.sim->set_state(run.sim->positions(), Positions::Zero(n - 1, 3), {}); });
  if (run.sim->grasped() != std::vector<Index>(std::begin(kCorners), std::end(kCorners)))
    refusals.miss("a refused call changed the held vertices");
  if (run.sim->capabilities().pins) {
    Scene scene;
    scene.pins = {3};
    run.sim->reset(sheet(), plain_fabric(), scene);
    refusals.wants<ShapeError>("grasp() of a pinned vertex", [&] { grasp(3); });
  }
  return refusals.outcome();
}

Outcome non_finite_state_never_leaves(const Bench& bench) {
  // The squares of these targets overflow. The run may end in Diverged, but never in non-finite numbers.
  Carry run(bench.make<Simulator>());
  double wrong = 0.0;
  std::string detail;
  for (const double far : {1e3, 1e100, 1e200, 1e300}) {
    Positions targets = run.start;
    targets.col(2).setConstant(far);
    try {
      run.sim->step(targets);
      SettleCriterion criterion;
      criterion.max_frames = 3;
      run.sim->settle(criterion);
    } catch (const Diverged&) {
    } catch (const std::exception& error) {
      ++wrong;
      detail = std::string("threw no Diverged: ") + error.what();
      break;
    }
    if (!run.sim->positions().allFinite() || !run.sim->velocities().allFinite()) {
      ++wrong;
      detail = "non-finite numbers after a target at " + number(far) + " m";
      break;
    }
    run = Carry(run.sim);  // a reset must be enough to continue
    run.run(0, 2);
  }
  return {wrong, detail};
}

}  // namespace
}  // namespace of_simulators

void probe_simulator(const Bench& bench) {
  using namespace of_simulators;
  const auto sim = bench.make<Simulator>();
  sim->reset(sheet(), plain_fabric(), Scene());
  sim->step(kNothing);
  sim->diagnostics();
}

namespace of_simulators {
namespace {

/// Those about how a sheet moves.
std::vector<Law> motion_laws() {
  return {
      {"falls_freely", "In free space a sheet follows x0 + v0 t + g t^2 / 2 (error over the distance fallen, 0.5 s).",
       0.02, falls_freely},
      {"gravity_any_direction", "The same with gravity in an oblique direction.", 0.02, gravity_any_direction},
      {"rest_stays_at_rest", "A flat sheet on the ground stays where it is (m, 1 s).", 1e-4, rest_stays_at_rest},
      {"reset_lifts_to_contact_height",
       "reset() lifts lower vertices to ground + thickness and moves none sideways (m).", 1e-9,
       reset_lifts_to_contact_height},
      {"reset_lays_layers_above_each_other", "reset() puts layer n of a garment at ground + (n + 1) thicknesses (m).",
       1e-9, reset_lays_layers_above_each_other},
      {"frames_are_the_rest_shape",
       "rest_frames: a sheet with rest frames, drawn in another size, keeps the size of its frames (m, 1 s).", 1e-4,
       frames_are_the_rest_shape},
      {"seams_carry_no_moment", "rest_frames: a sheet that is bent along a seam stays so in free space (m, 0.5 s).",
       1e-3, seams_carry_no_moment},
      {"sewn_layers_do_not_cross",
       "rest_frames, self_contact: a front and a back that are sewn together never cross in a fold (crossings).", 0,
       sewn_layers_do_not_cross},
      {"reset_forgets", "After reset() a used simulator gives the bits of a new one (numbers that differ).", 0,
       reset_forgets},
      {"pinned_stays_pinned", "Pinned vertices do not move while the rest falls (m).", 0, pinned_stays_pinned},
      {"grasp_moves_nothing", "Grasping, holding still and releasing a sheet at rest moves nothing (m).", 1e-4,
       grasp_moves_nothing},
      {"held_vertex_follows_its_target",
       "A held vertex is on its target after every frame, in the order of grasped() (m).", 1e-12,
       held_vertex_follows_its_target},
      {"release_leaves_no_kick", "A vertex that is released while it moves starts at rest (m/s).", 1e-9,
       release_leaves_no_kick},
      {"one_hand_lets_go",
       "Of two held vertices one is released: it starts at rest and falls, and the other stays on its target (share of its "
       "height left after 0.5 s).",
       0.5, one_hand_lets_go},
      {"frames_are_counted", "frame() counts the frames of step() and settle() since reset() (wrong counts).", 0,
       frames_are_counted},
      {"settles",
       "A sheet dropped from 2 cm settles flat within 10 s, and settle() reports it correctly (m off the ground).",
       2e-3, settles},
      {"settle_keeps_held_vertices", "settle() keeps held vertices still and held (m).", 1e-12,
       settle_keeps_held_vertices},
      {"settle_can_be_split",
       "Five calls of settle() for one frame each give the bits of one call for five (numbers that differ).", 0,
       settle_can_be_split},
      {"set_state_is_taken", "set_state() sets state and held vertices and drops history (numbers that differ).", 0,
       set_state_is_taken},
      {"nothing_sinks", "No vertex sinks below ground + thickness in a drop or a fold (in thicknesses).", 0.05,
       nothing_sinks},
      {"layers_do_not_cross", "self_contact: a folded sheet never intersects itself (edge-face crossings).", 0,
       layers_do_not_cross},
      {"layers_keep_their_distance",
       "self_contact: vertices of a folded sheet keep their distance to the other layer (lack, in thicknesses).", 0.5,
       layers_keep_their_distance},
      {"sticks_below_the_friction_threshold",
       "ground_friction: on an incline of tan = 0.9 mu the sheet stays (m, 0.5 s).", 1e-3,
       sticks_below_the_friction_threshold},
      {"slides_above_the_friction_threshold",
       "ground_friction: at tan = 1.3 mu it slides by Coulomb's law (relative, 0.5 s).", 0.1,
       slides_above_the_friction_threshold},
  };
}

/// Those about fabrics, bits and refusals.
std::vector<Law> other_laws() {
  return {
      {"stretches_by_direction",
       "orthotropic: hanging sheets stretch by their warp and weft stiffness (log ratio); undeclared: a difference is "
       "refused with ConfigError.",
       0.2, stretches_by_direction},
      {"restored_run_is_bit_exact",
       "snapshots: a run restored during a grasp continues bit for bit (numbers that differ).", 0, restores_in_place},
      {"restores_in_another_object", "snapshots: also in a second object with the same garment, fabric and scene.", 0,
       restores_in_another_object},
      {"foreign_snapshots_are_refused", "snapshots: those of another plugin or garment are refused (accepted).", 0,
       foreign_snapshots_are_refused},
      {"same_calls_same_bits", "Two objects agree after the same calls in turns (numbers that differ).", 0,
       same_calls_same_bits},
      {"same_bits_on_two_threads", "The same for two objects on two threads in parallel.", 0, same_bits_on_two_threads},
      {"translation_changes_nothing", "A fold half a metre away is the same fold (m).", 1e-5,
       translation_changes_nothing},
      {"turn_about_z_changes_nothing", "A fold turned about z is the same fold (m).", 1e-4,
       turn_about_z_changes_nothing},
      {"refuses_nan", "Targets and states that are not finite are refused and change nothing (accepted).", 0,
       refuses_nan},
      {"refuses_bad_shapes", "Wrong shapes and vertices are refused with ShapeError (accepted).", 0,
       refuses_bad_shapes},
      {"non_finite_state_never_leaves",
       "Absurd targets end in Diverged or in finite numbers, and reset() recovers (cases).", 0,
       non_finite_state_never_leaves},
  };
}

}  // namespace
}  // namespace of_simulators

const std::vector<Law>& simulator_laws() {
  using namespace of_simulators;
  static const std::vector<Law> laws = [] {
    std::vector<Law> all = motion_laws();
    for (const auto& more : {obstacle_laws(), other_laws()}) all.insert(all.end(), more.begin(), more.end());
    return all;
  }();
  return laws;
}

}  // namespace weft::conformance
