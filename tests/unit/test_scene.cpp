#include <nlohmann/json.hpp>

#include "serial_host.hpp"
#include "session/environment.hpp"
#include "simulation/scene.hpp"
#include "simulation/task_config.hpp"
#include "test_support.hpp"

namespace weft {
namespace {

using test::message_of;
using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;

const std::string kScene = R"(simulator: {plugin: fake}
garment: square.obj
fabric: {density_kg_per_m2: 0.2}
duration_s: 0.1
)";

/// Holds the given vertices and lets everything else lie. Records the calls.
class FakeSimulator final : public Simulator {
 public:
  SimulatorCapabilities capabilities() const override {
    SimulatorCapabilities capabilities;
    capabilities.pins = pins_allowed;
    capabilities.orthotropic = true;
    capabilities.ground_friction = has_friction;
    return capabilities;
  }
  void reset(std::shared_ptr<const Garment> garment, const Fabric&, const Scene& scene) override {
    positions_ = garment->positions;
    velocities_ = Positions::Zero(positions_.rows(), 3);
    calls.push_back("reset pins=" + std::to_string(scene.pins.size()));
  }
  void set_state(const Positions&, const Positions&, std::span<const Index>) override {}
  void grasp(std::span<const Index> vertices) override {
    // Newest first: the order is the simulator's own business.
    held_.insert(held_.begin(), vertices.begin(), vertices.end());
    calls.push_back("grasp@" + std::to_string(frame_));
  }
  std::vector<Index> grasped() const override { return held_; }
  void step(const Positions& targets) override {
    require_shape("targets", targets.rows(), static_cast<Index>(held_.size()));
    for (std::size_t i = 0; i < held_.size(); ++i) positions_.row(held_[i]) = targets.row(i);
    ++frame_;
  }
  void release(std::span<const Index> vertices) override {
    for (const Index v : vertices) held_.erase(std::find(held_.begin(), held_.end(), v));
    calls.push_back("release@" + std::to_string(frame_));
  }
  void release() override { held_.clear(); }
  SettleResult settle(const SettleCriterion&) override { return {}; }
  const Positions& positions() const override { return positions_; }
  const Positions& velocities() const override { return velocities_; }
  Index frame() const override { return frame_; }
  SimulatorDiagnostics diagnostics() const override { return {0.25, frame_ == 2 ? 0.5 : 0.125, 0.0, 0, "stretched"}; }

  std::vector<std::string> calls;
  bool pins_allowed = true;
  bool has_friction = true;

 private:
  Positions positions_, velocities_;
  std::vector<Index> held_;
  Index frame_ = 0;
};

class FakeHost final : public test::SerialHost {
 public:
  bool cancelled() const override { return stop; }
  void log(LogLevel, const std::string& message) override { messages.push_back(message); }

  std::shared_ptr<FakeSimulator> simulator = std::make_shared<FakeSimulator>();
  bool stop = false;
  std::vector<std::string> messages;

 protected:
  std::shared_ptr<void> create_erased(const std::string&, const ConfigNode&) override {
    return {simulator, static_cast<Simulator*>(simulator.get())};
  }
};

class SceneFile : public ::testing::Test {
 protected:
  SceneFile() { folder_.write("square.obj", "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3\nf 1 3 4\n"); }
  SceneRun read(const std::string& text) { return read_scene(ConfigNode::parse(text, "scene.yaml", folder_.path())); }
  std::string refusal(const std::string& more) {
    return message_of<ConfigError>([&] { read(kScene + more); });
  }
  test::Folder folder_;
};

TEST_F(SceneFile, FillsInDefaults) {
  const SceneRun run = read(kScene);
  EXPECT_EQ(run.scene.gravity, Vec3(0.0, 0.0, -9.81));
  EXPECT_EQ(run.scene.ground_height, 0.0);
  EXPECT_TRUE(run.grasps.empty());
  EXPECT_EQ(run.output_every_frames, 12);
  EXPECT_EQ(run.frames(), 6);
}

TEST_F(SceneFile, ReadsEveryKey) {
  folder_.write("square.yaml", "mesh: square.obj\nvertices: {corner: 2}\n");
  const SceneRun run = read(R"(
simulator: {plugin: fake, params: {substeps: 3}}
garment: square.yaml
fabric: {density_kg_per_m2: 0.2, friction: 0.4}
gravity_m_per_s2: [1, 2, -3]
ground: none
pins: [0, corner]
initial_velocity_m_per_s: [0.1, 0, 0]
grasps: [{vertices: [1], keyframes: [{time_s: 0, offset_m: [0, 0, 0]}, {time_s: 2, offset_m: [0.4, 0, 0.2]}], release_s: 2.0}]
duration_s: 2.5
output_every_frames: 5
)");
  EXPECT_EQ(run.scene.gravity, Vec3(1, 2, -3));
  EXPECT_FALSE(run.scene.ground_height.has_value());
  EXPECT_THAT(run.scene.pins, ElementsAre(0, 2));
  EXPECT_EQ(run.scene.initial_velocity.x(), 0.1);
  ASSERT_EQ(run.grasps.size(), 1u);
  EXPECT_EQ(run.grasps[0].offset_at(1.0), Vec3(0.2, 0, 0.1));
  EXPECT_EQ(run.grasps[0].offset_at(9.0), Vec3(0.4, 0, 0.2));
  EXPECT_EQ(run.grasps[0].release, 2.0);
  EXPECT_EQ(run.frames(), 150);
  const std::string saved = write_scene(run, "square.obj").to_yaml();
  EXPECT_EQ(write_scene(read(saved), "square.obj").to_yaml(), saved);
}

TEST_F(SceneFile, RefusesWithPlaceAndReason) {
  EXPECT_THAT(refusal("grasp: []\n"), HasSubstr("grasps"));
  EXPECT_THAT(refusal("pins: [4]\n"), AllOf(HasSubstr("scene.yaml:5"), HasSubstr("= 4, must be a vertex in [0, 3]")));
  EXPECT_THAT(refusal("pins: [-1]\n"), HasSubstr("= -1, must be a vertex in [0, 3]"));
  EXPECT_THAT(refusal("pins: [1, 1]\n"), HasSubstr("= 1 is listed twice"));
  EXPECT_THAT(refusal("pins: [corner]\n"), HasSubstr("no vertex is named 'corner'"));
  EXPECT_THAT(refusal("ground: floor\n"), HasSubstr("= floor, must be none or {height_m: ...}"));
  EXPECT_THAT(refusal("ground: {height: 1}\n"), HasSubstr("height_m"));
  EXPECT_THAT(refusal("gravity_m_per_s2: [0, -9.81]\n"), HasSubstr("must be a list of 3 numbers"));
  EXPECT_THAT(refusal("gravity_m_per_s2: [0, 0, .nan]\n"), HasSubstr("gravity_m_per_s2.2"));
  EXPECT_THAT(refusal("output_every_frames: 0\n"), HasSubstr("= 0, must be at least 1"));
  const std::string keys = "keyframes: [{time_s: 0.1, offset_m: [0,0,0]}]";
  EXPECT_THAT(refusal("grasps: [{vertices: [], " + keys + "}]\n"), HasSubstr("must name at least one vertex"));
  EXPECT_THAT(refusal("grasps: [{vertices: [1], keyframes: []}]\n"), HasSubstr("must be a list of {time_s, offset_m}"));
  EXPECT_THAT(refusal("grasps: [{vertices: [1]}]\n"), HasSubstr("keyframes"));
  EXPECT_THAT(refusal("grasps: [{vertices: [1], release_s: 0.1, " + keys + "}]\n"),
              HasSubstr("must be later than the first keyframe"));
  EXPECT_THAT(
      refusal(
          "grasps: [{vertices: [1], keyframes: [{time_s: 1, offset_m: [0,0,0]}, {time_s: 1, offset_m: [0,0,0]}]}]\n"),
      HasSubstr("must be later than the keyframe before it"));
  EXPECT_THAT(refusal("pins: [1]\ngrasps: [{vertices: [1], " + keys + "}]\n"),
              HasSubstr("holds vertex 1, which is pinned"));
  EXPECT_THAT(refusal("grasps: [{vertices: [1], " + keys + "}, {vertices: [2, 1], " + keys + "}]\n"),
              HasSubstr("holds vertex 1, which grasp 0 holds at the same time"));
  EXPECT_THAT(message_of<ConfigError>([&] { read("garment: square.obj\nfabric: {}\n"); }), HasSubstr("duration_s"));
  EXPECT_THAT(message_of<ConfigError>([&] { read("garment: square.obj\nfabric: {}\nduration_s: 0\n"); }),
              HasSubstr("duration_s"));
  EXPECT_THAT(message_of<ConfigError>([&] { read("garment: square.obj\nfabric: {}\nduration_s:\n"); }),
              HasSubstr("duration_s = "));
  EXPECT_THAT(message_of<ConfigError>([&] { read("fabric: {}\nduration_s: 1\n"); }), HasSubstr("garment"));
  EXPECT_THAT(refusal("ground: {}\n"), HasSubstr("height_m"));
  EXPECT_THAT(refusal("grasps: [{vertices: [1], keyframes: [{offset_m: [0,0,0]}]}]\n"), HasSubstr("time_s"));
  EXPECT_THAT(refusal("grasps: [{vertices: [1], keyframes: [{time_s: 1}]}]\n"), HasSubstr("offset_m"));
  EXPECT_THAT(refusal("grasps: [{vertices: [1], keyframes: [{time: 1}]}]\n"), HasSubstr("nearest: time_s"));
}

TEST_F(SceneFile, SavesEveryKeyThatItDeclares) {
  std::vector<std::string> declared;
  for (const ParamInfo& info : describe_scene()) {
    const std::string key = info.name.substr(0, info.name.find('.'));
    if (info.decides != Decides::nothing && (declared.empty() || declared.back() != key)) declared.push_back(key);
  }
  EXPECT_THAT(write_scene(read(kScene), "square.obj").keys(), ::testing::UnorderedElementsAreArray(declared));
}

TEST_F(SceneFile, GraspsFollowTheirKeyframes) {
  const SceneRun run = read(kScene + R"(
grasps:
  - {vertices: [0, 3], keyframes: [{time_s: 0, offset_m: [0, 0, 0]}, {time_s: 0.05, offset_m: [0.3, 0, 0]}]}
  - {vertices: [1], keyframes: [{time_s: 0.0334, offset_m: [0, 0, 0]}, {time_s: 0.1, offset_m: [0, 0, 0.6]}], release_s: 0.0667}
)");
  FakeHost host;
  std::vector<Positions> seen;
  const SceneResult result = run_scene(run, host, [&](const Simulator& s, Index) { seen.push_back(s.positions()); });
  ASSERT_EQ(seen.size(), 7u);
  EXPECT_NEAR(seen[1](0, 0), 0.1, 1e-12);
  EXPECT_NEAR(seen[3](3, 0), 0.3, 1e-12);
  EXPECT_NEAR(seen[6](3, 0), 0.3, 1e-12);  // kept after the last keyframe
  EXPECT_EQ(seen[3](1, 2), 0.0);           // 0.0334 s is behind frame 2: taken at frame 3
  EXPECT_GT(seen[4](1, 2), 0.1);
  EXPECT_EQ(seen[6](1, 2), seen[5](1, 2));  // released at frame 5
  EXPECT_THAT(host.simulator->calls, ElementsAre("reset pins=0", "grasp@0", "grasp@3", "release@5"));
  EXPECT_EQ(result.frames, 6);
  EXPECT_EQ(result.max_strain, 0.5);
  EXPECT_EQ(result.final_strain, 0.125);
  EXPECT_THAT(result.warnings, ElementsAre("stretched"));
}

TEST_F(SceneFile, SummaryHasTheKeysScriptsRelyOn) {
  const SceneRun run = read(kScene);
  FakeHost host;
  const auto json = nlohmann::json::parse(scene_summary_json(run, run_scene(run, host)));
  EXPECT_EQ(json.at("frames"), 6);
  EXPECT_FALSE(json.contains("frame_ms"));
  SceneResult timed;
  timed.frame_seconds = {0.004, 0.001, 0.002};
  const auto times = nlohmann::json::parse(scene_times_json(timed)).at("frame_ms");
  EXPECT_EQ(times.at("median"), 2.0);
  EXPECT_EQ(times.at("p95"), 4.0);
  EXPECT_EQ(json.at("max_speed_m_per_s"), 0.25);
  EXPECT_EQ(json.at("max_strain"), 0.125);
  EXPECT_EQ(json.at("intersections"), 0);
}

TEST_F(SceneFile, RefusesPinsThatTheSimulatorIgnores) {
  const SceneRun run = read(kScene + "pins: [0]\n");
  FakeHost host;
  host.simulator->pins_allowed = false;
  EXPECT_THAT(message_of<ConfigError>([&] { run_scene(run, host); }), HasSubstr("capability pins"));
  EXPECT_TRUE(host.simulator->calls.empty());
}

TEST_F(SceneFile, EveryCommandWarnsOfGroundFrictionThatTheSimulatorLacks) {
  FakeHost host;
  host.simulator->has_friction = false;
  SceneRun run = read(kScene);
  Task task;
  task.garment = run.garment;
  task.material = read_material_space(ConfigNode::quoted(WEFT_SOURCE_DIR "/configs/fabrics/basic.yaml"));
  const auto of_simulate = [&] { return run_scene(run, host).warnings; };
  const auto of_run = [&] {
    return SimulatorEnvironment(host.simulator, task, MaterialProperties::Constant(0.5)).warnings();
  };
  const auto of_other_commands = [&] {
    host.messages.clear();
    check_simulator(ConfigNode::quoted("fake"), task, host);
    return host.messages;
  };
  const auto lacks = HasSubstr("the fabric has ground friction, which this simulator does not declare");
  EXPECT_THAT(of_simulate(), ElementsAre(lacks, "stretched"));
  EXPECT_THAT(of_run(), ElementsAre(lacks, "stretched"));
  EXPECT_THAT(of_other_commands(), ElementsAre(lacks, HasSubstr("stretched")));
  run.scene.ground_height = task.scene.ground_height = std::nullopt;
  EXPECT_THAT(of_simulate(), ElementsAre("stretched"));
  EXPECT_THAT(of_run(), ElementsAre("stretched"));
  EXPECT_THAT(of_other_commands(), ElementsAre(HasSubstr("stretched")));
}

TEST_F(SceneFile, StopsWhenCancelled) {
  const SceneRun run = read(kScene);
  FakeHost host;
  host.stop = true;
  const SceneResult result = run_scene(run, host);
  EXPECT_TRUE(result.cancelled);
  EXPECT_EQ(result.frames, 0);
}

TEST(ShippedScenes, AllRead) {
  int count = 0;
  for (const auto& entry : std::filesystem::directory_iterator(WEFT_SOURCE_DIR "/configs/experiments/scenes")) {
    if (entry.path().extension() != ".yaml") continue;
    ++count;
    EXPECT_NO_THROW(read_scene(ConfigNode::load(entry.path()))) << entry.path();
  }
  EXPECT_GE(count, 4);
}

}  // namespace
}  // namespace weft
