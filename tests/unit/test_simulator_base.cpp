// The common work of SimulatorBase for every simulator that derives from it.
#include <cmath>
#include <limits>

#include "test_support.hpp"
#include "weft/simulator.hpp"

namespace weft {
namespace {

using test::message_of;
using testing::AllOf;
using testing::ElementsAre;
using testing::HasSubstr;

/// Points that glide with their velocity and are braked by drag, and a count of frames that only a snapshot keeps.
class Gliding final : public SimulatorBase {
 public:
  explicit Gliding(SimulatorCapabilities can = {.snapshots = true, .pins = true})
      : SimulatorBase("gliding", {.settle_drag_per_s = 30.0, .grasp_strain_warning = 0.1}), can_(can) {}
  SimulatorCapabilities capabilities() const override { return can_; }

  std::string fail;         ///< thrown as Diverged by the next frame
  bool break_next = false;  ///< the next frame makes numbers that are not finite
  int history = 0;
  std::vector<std::pair<Index, bool>> changes;

 protected:
  void start() override { history = 0; }
  void advance_frame(const Positions& targets, double drag, Positions& x, Positions& v) override {
    if (!fail.empty()) throw Diverged(fail);
    v /= 1.0 + kFrameSeconds * drag;
    x += kFrameSeconds * v;
    for (std::size_t k = 0; k < held().size(); ++k) x.row(held()[k]) = targets.row(k);
    if (break_next) x(0, 0) = std::numeric_limits<double>::quiet_NaN();
    ++history;
  }
  void hold_changed(Index vertex, bool held) override { changes.emplace_back(vertex, held); }
  void state_changed() override { history = -1; }
  std::any save_history() const override { return history; }
  void restore_history(const std::any& saved) override { history = std::any_cast<int>(saved); }

 private:
  SimulatorCapabilities can_;
};

/// A square of 0.1 m of two faces, 5 mm below the ground's contact height but for vertex 3, which is above it.
std::shared_ptr<const Garment> square() {
  Mesh mesh;
  mesh.positions.resize(4, 3);
  mesh.positions << 0, 0, 0, 0.1, 0, 0, 0.1, 0.1, 0, 0, 0.1, 0;
  mesh.faces.resize(2, 3);
  mesh.faces << 0, 1, 2, 0, 2, 3;
  Garment garment = make_garment(mesh, "square");
  garment.positions.col(2) << -0.004, -0.004, -0.004, 0.01;
  return std::make_shared<const Garment>(garment);
}

Positions rows(std::initializer_list<Vec3> points) {
  Positions out(static_cast<Index>(points.size()), 3);
  Index row = 0;
  for (const Vec3& p : points) out.row(row++) = p.transpose();
  return out;
}

struct SimulatorBaseTest : testing::Test {
  SimulatorBaseTest() {
    scene.initial_velocity = {0.6, 0.0, 0.0};
    scene.pins = {0};
    sim.reset(garment, fabric, scene);
  }
  void grasp(std::vector<Index> vertices) { sim.grasp(vertices); }

  std::shared_ptr<const Garment> garment = square();
  Fabric fabric;
  Scene scene;
  Gliding sim;
};

TEST_F(SimulatorBaseTest, ResetLiftsWhatIsFreeToContactHeight) {
  EXPECT_EQ(sim.positions().col(2), Vector(Eigen::Vector4d(-0.004, fabric.thickness_m, fabric.thickness_m, 0.01)));
  EXPECT_EQ(sim.velocities().col(0), Vector(Eigen::Vector4d(0.0, 0.6, 0.6, 0.6)));
}

TEST_F(SimulatorBaseTest, HeldVerticesKeepTheOrderOfTheCalls) {
  grasp({3, 1});
  grasp({2});
  EXPECT_THAT(sim.grasped(), ElementsAre(3, 1, 2));
  EXPECT_EQ(sim.velocities().row(1).norm(), 0.0);
  const Index middle = 1;
  sim.release(std::span(&middle, 1));
  EXPECT_THAT(sim.grasped(), ElementsAre(3, 2));
  sim.release();
  EXPECT_TRUE(sim.grasped().empty());
  using Change = std::pair<Index, bool>;
  EXPECT_THAT(sim.changes, ElementsAre(Change{3, true}, Change{1, true}, Change{2, true}, Change{1, false},
                                       Change{3, false}, Change{2, false}));
}

TEST_F(SimulatorBaseTest, RefusedCallsChangeNothing) {
  grasp({1});
  const auto refused = [&](std::vector<Index> v) { return message_of<ShapeError>([&] { sim.grasp(v); }); };
  EXPECT_THAT(refused({2, 9}), HasSubstr("gliding: grasp: vertex 9 out of range, must be in [0, 3]"));
  EXPECT_THAT(refused({0}), HasSubstr("is pinned"));
  EXPECT_THAT(refused({1}), HasSubstr("already held"));
  EXPECT_THAT(refused({2, 2}), HasSubstr("already held"));
  const Index other = 2;
  EXPECT_THROW(sim.release(std::span(&other, 1)), ShapeError);
  EXPECT_THROW(sim.step(Positions(0, 3)), ShapeError);
  EXPECT_THROW(sim.step(Positions::Constant(1, 3, std::numeric_limits<double>::infinity())), Error);
  const std::vector<Index> twice = {2, 2};
  EXPECT_THAT(message_of<ShapeError>([&] { sim.set_state(sim.positions(), sim.velocities(), twice); }),
              HasSubstr("named twice"));
  EXPECT_THAT(sim.grasped(), ElementsAre(1));
  EXPECT_EQ(sim.frame(), 0);
}

TEST_F(SimulatorBaseTest, SetStateStopsWhatIsFixedAndDropsHistory) {
  const std::vector<Index> hands = {2};
  sim.step(Positions(0, 3));
  sim.set_state(Positions::Constant(4, 3, 0.5), Positions::Constant(4, 3, 1.0), hands);
  EXPECT_EQ(sim.velocities().rowwise().norm().array().min(1.0).matrix(), Vector(Eigen::Vector4d(0, 1, 0, 1)));
  EXPECT_THAT(sim.grasped(), ElementsAre(2));
  EXPECT_EQ(sim.history, -1);
  EXPECT_EQ(sim.frame(), 1) << "frames are counted since reset()";
}

TEST_F(SimulatorBaseTest, SettleAddsItsDragAndCountsCalmFramesInARow) {
  // The speed falls by 1 + 30 / 60 a frame: 0.6, 0.4, 0.267, 0.178, 0.119, 0.079 m/s.
  const SettleResult result = sim.settle({.speed = 0.2, .hold_frames = 3, .max_frames = 50});
  EXPECT_TRUE(result.settled);
  EXPECT_EQ(result.frames, 5);
  EXPECT_EQ(sim.frame(), 5);
  EXPECT_NEAR(result.max_speed, 0.6 / std::pow(1.5, 5), 1e-12);
  EXPECT_FALSE(sim.settle({.speed = 1e-9, .hold_frames = 1, .max_frames = 2}).settled);
  sim.step(Positions(0, 3));
  EXPECT_NEAR(sim.diagnostics().max_speed, 0.6 / std::pow(1.5, 7), 1e-12) << "step() adds no drag";
}

TEST_F(SimulatorBaseTest, DivergenceNamesTheFrameAndKeepsTheLastGoodState) {
  sim.step(Positions(0, 3));
  const Positions before = sim.positions();
  sim.fail = "too fast";
  EXPECT_EQ(message_of<Diverged>([&] { sim.step(Positions(0, 3)); }), "gliding: diverged in frame 2: too fast");
  EXPECT_EQ(sim.positions(), before);
  sim.fail.clear();
  EXPECT_THAT(message_of<Error>([&] { sim.step(Positions(0, 3)); }), HasSubstr("after divergence in frame 2"));
  sim.reset(garment, fabric, scene);
  sim.break_next = true;
  EXPECT_THAT(message_of<Diverged>([&] { sim.settle({}); }), HasSubstr("frame 1: positions or speeds are not finite"));
  EXPECT_TRUE(sim.positions().allFinite());
  sim.set_state(before, Positions::Zero(4, 3), {});
  sim.break_next = false;
  sim.step(Positions(0, 3));
}

TEST_F(SimulatorBaseTest, SnapshotsKeepHistoryAndBelongToSimulatorAndGarment) {
  grasp({1});
  sim.step(rows({{0.1, 0.0, 0.02}}));
  const auto snapshot = sim.save();
  const Positions x = sim.positions(), v = sim.velocities();
  sim.release();
  sim.step(Positions(0, 3));
  sim.restore(*snapshot);
  EXPECT_EQ(sim.positions(), x);
  EXPECT_EQ(sim.velocities(), v);
  EXPECT_THAT(sim.grasped(), ElementsAre(1));
  EXPECT_EQ(sim.history, 1);
  EXPECT_EQ(sim.frame(), 1);
  EXPECT_THAT(message_of<Error>([&] { sim.restore(SimulatorSnapshot()); }), HasSubstr("another simulator"));
  auto other = *garment;
  ++other.hash;
  sim.reset(std::make_shared<const Garment>(other), fabric, scene);
  EXPECT_THAT(message_of<Error>([&] { sim.restore(*snapshot); }), HasSubstr("another garment"));
  EXPECT_THROW(Gliding(SimulatorCapabilities{}).save(), Unsupported);
}

TEST_F(SimulatorBaseTest, GraspStrainIsThatOfTheFacesAtAHand) {
  grasp({1});
  scene.initial_velocity.setZero();
  sim.set_state(garment->positions, Positions::Zero(4, 3), sim.grasped());
  sim.step(rows({{0.12, 0.0, -0.004}}));  // the edge from vertex 0 is 20 % longer
  const SimulatorDiagnostics d = sim.diagnostics();
  EXPECT_NEAR(d.max_grasp_strain, 0.245957, 1e-6);  // F = [1.2, -0.2; 0, 1]: its largest singular value less 1
  EXPECT_THAT(d.warning, HasSubstr("a grasp stretched the cloth by 24.6 %"));
}

TEST_F(SimulatorBaseTest, WhatIsNotDeclaredIsRefusedByKey) {
  Gliding bare{SimulatorCapabilities{.gravity_any_direction = false}};
  const auto refused = [&](auto&& change) {
    Fabric f;
    f.name = "cord";
    Scene s;
    change(f, s);
    return message_of<ConfigError>([&] { bare.reset(garment, f, s); });
  };
  EXPECT_THAT(refused([](Fabric&, Scene& s) { s.pins = {1}; }), HasSubstr("scene.pins"));
  EXPECT_THAT(refused([](Fabric&, Scene& s) { s.gravity.x() = 1.0; }), HasSubstr("scene.gravity"));
  EXPECT_THAT(refused([](Fabric& f, Scene&) { f.stretch_weft_n_per_m = 165.0; }),
              AllOf(HasSubstr("gliding: fabric.stretch_n_per_m = {warp: 100, weft: 165} (fabric cord), must be equal"),
                    HasSubstr("set both to their mean, 132.5")));
  EXPECT_THAT(refused([](Fabric& f, Scene&) { f.bend_warp_n_m = 1.6e-5; }),
              HasSubstr("fabric.bend_n_m = {warp: 1.6e-05, weft: 2e-05}"));
  EXPECT_THAT(refused([](Fabric& f, Scene&) { f.tables = std::make_shared<const MaterialTables>(); }),
              HasSubstr("tables"));
  EXPECT_NO_THROW(bare.reset(garment, Fabric(), Scene()));
}

}  // namespace
}  // namespace weft
