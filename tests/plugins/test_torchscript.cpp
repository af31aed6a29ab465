// Exported PyTorch modules as predictors. The modules are written here, in TorchScript, without Python.
#include <ATen/ATen.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <torch/csrc/jit/api/module.h>

#include <cmath>
#include <fstream>

#include "conformance/conformance.hpp"
#include "experiments/prediction_evaluation.hpp"
#include "loader/program_host.hpp"
#include "predictor/torchscript/torchscript.hpp"
#include "session/planner.hpp"
#include "session/session.hpp"
#include "simulation/task_config.hpp"
#include "unit/descent.hpp"
#include "unit/test_support.hpp"

namespace weft::torchscript {
namespace {

using test::Folder;
using test::message_of;
using ::testing::HasSubstr;

const std::string kTask =
    "garment: '" WEFT_SOURCE_DIR "/configs/garments/towel_coarse.yaml', material: '" WEFT_SOURCE_DIR
    "/configs/fabrics/basic.yaml', manipulation: {grasp: [left_top, left_bottom], "
    "displacement_m: [0.4, 0.0], drop_height_m: 0.05}";

/// Every vertex follows the sum of the controls so far, dragged by knowledge and state; sigma grows with the width.
const std::string kForward = R"(
def forward(self, shape, states, controls, knowledge):
    moved = torch.tanh(0.1 * torch.cumsum(controls, 1)) * self.gain
    arc = torch.sin(0.01 * states[:, 1:, :3])
    centre = torch.sin(knowledge[:, 0:3] + knowledge[:, 1:4]).unsqueeze(1)
    step = 0.01 * moved[:, :, 0:3] + 0.02 * moved[:, :, 2:5] + 0.01 * arc + 0.03 * centre
    mean = torch.sin(shape).unsqueeze(1) + step.unsqueeze(2)
    wide = 0.001 + 0.002 * (knowledge[:, 4:7] + knowledge[:, 5:8]).unsqueeze(1).unsqueeze(1)
    return mean, wide * (1.0 + torch.square(mean))
)";

/// Two layers over the sum of the controls: products of matrices whose size follows the batch.
const std::string kNetwork = R"(
def forward(self, shape, states, controls, knowledge):
    b, k, v = shape.size(0), controls.size(1), shape.size(1)
    known = knowledge.unsqueeze(1).expand(b, k, 8)
    inputs = torch.cat([0.1 * torch.cumsum(controls, 1), 0.01 * states[:, 1:], known], 2)
    hidden = torch.tanh(torch.matmul(inputs, self.encode))
    mean = shape.unsqueeze(1) + 0.02 * torch.matmul(hidden, self.decode)[:, :, :3 * v].view(b, k, v, 3)
    return mean, 0.001 + torch.square(mean)
)";

/// kForward for a user whose data are in decimetres, with controls and states of mean 0 and deviation 1.
const std::string kNormalised = R"(
def forward(self, shape, states, controls, knowledge):
    controls = controls * self.control_sd + self.control_mean
    states = states * self.state_sd + self.state_mean
    mean, sigma = self.plain(0.1 * shape, states, controls, knowledge)
    return 10.0 * mean, 10.0 * sigma
)";
/// control_mean and control_sd, state_mean and state_sd: other numbers for every variable.
double mean_of(Index variable, bool state) { return 0.1 + (state ? 0.3 : 0.02) * static_cast<double>(variable); }
double sd_of(Index variable, bool state) { return (state ? 3.0 : 0.2) / (1.0 + static_cast<double>(variable)); }

/// Continues its last motion at half the speed, enlarged by the controls.
const std::string kPrevious = R"(
def forward(self, shape, states, controls, knowledge, previous):
    pace = torch.cumsum(torch.tanh(0.1 * controls[:, :, 0:1]), 1).unsqueeze(2)
    mean = shape.unsqueeze(1) + 0.5 * pace * torch.sin(shape - previous).unsqueeze(1)
    wide = 0.001 + 0.01 * (knowledge[:, 4:7] + states[:, 0, :3] * 0.001).unsqueeze(1).unsqueeze(1)
    return mean, wide * (1.0 + torch.square(mean - previous.unsqueeze(1)))
)";

void save_module(const std::filesystem::path& file, const std::string& source) {
  torch::jit::Module module("predictor");
  module.register_parameter("gain", at::full({1}, 0.7f), false);
  const auto weights = [](std::int64_t rows, std::int64_t columns) {
    return at::sin(at::arange(rows * columns).to(at::kFloat) * 1.7f).reshape({rows, columns}).contiguous();
  };
  module.register_parameter("encode", weights(18, 96), false);
  module.register_parameter("decode", weights(96, 300), false);
  for (const bool state : {false, true}) {
    std::vector<double> mean, sd;
    for (Index i = 0; i < 5; ++i) {
      mean.push_back(mean_of(i, state));
      sd.push_back(sd_of(i, state));
    }
    const std::string name = state ? "state_" : "control_";
    module.register_parameter(name + "mean", at::tensor(mean, at::kFloat), false);
    module.register_parameter(name + "sd", at::tensor(sd, at::kFloat), false);
  }
  if (source == kNormalised) {
    std::string plain = kForward;
    plain.replace(plain.find("forward"), 7, "plain");
    module.define(plain);
  }
  module.define(source);
  module.save(file.string());
}

std::shared_ptr<const PluginRegistry> registry() {
  return std::make_shared<PluginRegistry>(std::vector<std::filesystem::path>{WEFT_BINARY_DIR "/lib/weft/plugins"});
}

class TorchScript : public ::testing::Test {
 protected:
  TorchScript() : host_(make_host(registry(), {.threads = 1, .checks = PluginChecks::none})) {
    const ConfigNode node = ConfigNode::parse("{" + kTask + "}", "test");
    TaskParams params;
    read_params(node, params);
    task_ = make_task(params, node, *host_);
  }
  void write_metadata(const std::string& more = "", const std::string& hash = "") const {
    std::string text = "garment_hash: '" + (hash.empty() ? std::to_string(task_.garment->hash) : hash) + "'\n";
    for (const bool state : {false, true}) {
      text += state ? "states: [" : "controls: [";
      for (const auto& v : state ? task_.trajectory->state() : task_.trajectory->controls()) text += v.name + ",";
      text += "]\n";
    }
    text += "grasp_vertices: [";
    for (const Index v : task_.manipulation.grasp_vertices) text += std::to_string(v) + ",";
    folder_.write("m.yaml", text + "]\ndisplacement_m: [0.4, 0.0]\n" + more);
  }
  std::unique_ptr<TorchScriptPredictor> bound(bool batch = true, const std::string& other_fabric = "refuse") const {
    Params params;
    params.module = folder_ / "m.pt";
    params.batch = batch;
    params.other_fabric = other_fabric;
    auto predictor = std::make_unique<TorchScriptPredictor>(params, *host_);
    predictor->bind(task_);
    return predictor;
  }
  void expect_laws() const {
    const auto host = make_host(registry(), {.threads = 2, .checks = PluginChecks::none});
    for (const std::string batch : {"true", "false"}) {
      const std::string params = "params: {batch: " + batch + ", module: '" + (folder_ / "m.pt").string() + "'}\n";
      const auto settings = ConfigNode::parse(params + "task: {" + kTask + "}", "test");
      for (const auto& law :
           check_conformance(*host, "predictor", ConfigNode::parse("torchscript", "test"), settings)) {
        EXPECT_TRUE(law.passed) << law.law << ": " << law.measured << " > " << law.bound << " " << law.detail;
      }
    }
  }
  /// In mid-air: the shape one segment earlier lay elsewhere.
  PredictionCase a_case() const {
    PredictionCase one;
    one.shape = std::make_shared<const Positions>(task_.garment->positions);
    one.previous = std::make_shared<const Positions>(0.8 * (task_.garment->positions.array() + 0.05));
    one.state = task_.trajectory->initial_state(task_.manipulation);
    one.controls = 0.5 * task_.trajectory->default_controls(3);
    one.controls(1, 3) = 0.01;
    one.knowledge.centre << 0.1, 0.2, 0.3, 0.4;
    one.knowledge.width << 0.5, 0.6, 0.7, 0.8;
    one.segments = {2, 3};
    return one;
  }
  /// Why the metadata are refused.
  std::string metadata_refusal(const std::string& more) const {
    write_metadata(more);
    return message_of<ConfigError>([&] { bound(); });
  }
  /// Why the module is refused.
  std::string refusal(const std::string& source) const {
    save_module(folder_ / "m.pt", source);
    return message_of<ConfigError>([&] { bound(); });
  }

  Folder folder_;
  std::unique_ptr<Host> host_;
  Task task_;
};

TEST_F(TorchScript, PredictsWhatTheModuleSays) {
  save_module(folder_ / "m.pt", kForward);
  write_metadata();
  const auto predictor = bound();
  const PredictionCase one = a_case();
  const auto prediction = predictor->predict({one}, {});
  const Controls states = task_.trajectory->segment_states(task_.manipulation, one.state, one.controls);
  for (std::size_t s = 0; s < 2; ++s) {
    const Index k = one.segments[s];
    const Vector sum = one.controls.topRows(k).colwise().sum();
    for (Index v : {Index{0}, Index{17}, task_.garment->vertex_count() - 1}) {
      for (Index a = 0; a < 3; ++a) {
        const auto moved = [&](Index c) { return 0.7 * std::tanh(0.1 * sum[c]); };
        const double mean = std::sin((*one.shape)(v, a)) + 0.01 * moved(a) + 0.02 * moved(a + 2) +
                            0.01 * std::sin(0.01 * states(k - 1, a)) +
                            0.03 * std::sin(one.knowledge.centre[a] + one.knowledge.centre[a + 1]);
        const double wide = 0.001 + 0.002 * (one.knowledge.width[a] + one.knowledge.width[a + 1]);
        EXPECT_NEAR(prediction->shapes()[0][s].mean(v, a), mean, 1e-6);
        EXPECT_NEAR(prediction->shapes()[0][s].sigma(v, a), wide * (1.0 + mean * mean), 1e-7);
      }
    }
  }
}

TEST_F(TorchScript, ObeysTheLawsOfPredictors) {
  save_module(folder_ / "m.pt", kForward);
  write_metadata("max_segments: 5\ncontrol_low: [0, 0, -1, -1, -1]\ncontrol_high: [9, 1, 1, 1, 1]\n");
  expect_laws();
}

TEST_F(TorchScript, NormalisesAroundTheModule) {
  std::string numbers = "length_unit_m: 0.1\n";
  for (const bool state : {false, true}) {
    for (const bool sd : {false, true}) {
      numbers += std::string(state ? "state_" : "control_") + (sd ? "sd: [" : "mean: [");
      for (Index i = 0; i < 5; ++i) numbers += std::to_string(sd ? sd_of(i, state) : mean_of(i, state)) + ",";
      numbers += "]\n";
    }
  }
  const auto one = a_case();
  std::vector<std::vector<ShapeCotangent>> cotangents(1);
  for (int s = 0; s < 2; ++s)
    cotangents[0].push_back({one.shape->array().cos().matrix(), (2.0 * one.shape->array() - 1.0).matrix()});
  save_module(folder_ / "m.pt", kForward);
  write_metadata();
  const PredictionRequest request{.gradients = true, .state_gradients = true, .shape_gradients = true};
  const auto plain = bound()->predict({one}, request);
  save_module(folder_ / "m.pt", kNormalised);
  write_metadata(numbers);
  const auto normalised = bound()->predict({one}, request);
  for (std::size_t s = 0; s < 2; ++s) {
    const auto &a = plain->shapes()[0][s], &b = normalised->shapes()[0][s];
    EXPECT_LT((a.mean - b.mean).cwiseAbs().maxCoeff(), 1e-6);
    EXPECT_LT((a.sigma - b.sigma).cwiseAbs().maxCoeff(), 1e-7);
  }
  const auto wanted = plain->pullback(cotangents)[0], got = normalised->pullback(cotangents)[0];
  const auto near = [](const auto& a, const auto& b) { return a.norm() > 0.0 && (a - b).norm() < 1e-5 * a.norm(); };
  EXPECT_TRUE(near(wanted.controls, got.controls));
  EXPECT_TRUE(near(wanted.state, got.state));
  EXPECT_TRUE(near(wanted.shape, got.shape));
  EXPECT_TRUE(near(wanted.centre, got.centre));
  EXPECT_TRUE(near(wanted.width, got.width));
  expect_laws();
}

TEST_F(TorchScript, PassesThePreviousShape) {
  save_module(folder_ / "m.pt", kPrevious);
  write_metadata("previous: true\n");
  const auto moving = a_case();
  auto at_rest = moving;
  at_rest.previous.reset();
  const auto prediction = bound()->predict({moving, at_rest}, {.gradients = true, .shape_gradients = true});
  const auto pace = [&](Index k) { return (0.1 * moving.controls.topRows(k).col(0).array()).tanh().sum(); };
  const Positions &x = *moving.shape, gap = x - *moving.previous;
  for (std::size_t s = 0; s < 2; ++s) {
    const Positions mean = (x.array() + 0.5 * pace(moving.segments[s]) * gap.array().sin()).matrix();
    EXPECT_LT((prediction->shapes()[0][s].mean - mean).cwiseAbs().maxCoeff(), 1e-6);
    EXPECT_LT((prediction->shapes()[1][s].mean - x).cwiseAbs().maxCoeff(), 1e-6);  // the start shape twice
    for (Index a = 0; a < 3; ++a) {
      const double wide = 0.001 + 0.01 * (moving.knowledge.width[a] + 0.001 * moving.state[a]);
      const auto sigma = wide * (1.0 + (mean - *moving.previous).col(a).array().square());
      EXPECT_LT((prediction->shapes()[0][s].sigma.col(a).array() - sigma).cwiseAbs().maxCoeff(), 1e-7);
    }
  }
  // Gradients of the means: d mean / d shape = 1 + 0.5 pace cos(shape - previous). Without a previous shape,
  // shape - shape adds nothing.
  const Positions w = x.array().cos().matrix();
  const std::vector<ShapeCotangent> none(2);
  std::vector<ShapeCotangent> last = none;
  last[1].mean = w;
  const auto gradients = prediction->pullback({last, last});
  const Positions slope = (1.0 + 0.5 * pace(3) * gap.array().cos()).matrix();
  EXPECT_LT((gradients[0].shape - w.cwiseProduct(slope)).cwiseAbs().maxCoeff(), 1e-6);
  EXPECT_LT((gradients[1].shape - w).cwiseAbs().maxCoeff(), 1e-6);
  expect_laws();
}

TEST_F(TorchScript, PlansStayInsideTheTrainingRange) {
  save_module(folder_ / "m.pt", kForward);
  write_metadata();
  EXPECT_FALSE(bound()->control_range());
  write_metadata("control_low: [1.5, -0.001, -0.1, -0.0001, 0]\ncontrol_high: [2.5, 0.001, 0.1, 0.0002, 0]\n");
  const std::shared_ptr<const Predictor> predictor = bound();
  const auto range = predictor->control_range();
  ASSERT_TRUE(range);
  EXPECT_EQ(range->lower, (Vector(5) << 1.5, -0.001, -0.1, -0.0001, 0).finished());
  EXPECT_EQ(range->upper, (Vector(5) << 2.5, 0.001, 0.1, 0.0002, 0).finished());
  PlanRequest request;
  request.shape = request.goal = std::make_shared<const Positions>(task_.garment->positions);
  request.state = task_.trajectory->initial_state(task_.manipulation);
  PlannerParams params;
  params.instances = 4;
  params.horizon = 4;
  params.iterations = 3;
  const Plan plan = Planner(task_, predictor, std::make_shared<const test::Descent>(), params, *host_).plan(request);
  for (Index j = 0; j < plan.controls.rows(); ++j) {
    const Vector row = plan.controls.row(j).transpose();
    EXPECT_EQ(row, range->clamp(row));
  }
  EXPECT_THROW(TorchScriptPredictor(Params{}, *host_).control_range(), Error);
  EXPECT_THROW(TorchScriptPredictor(Params{}, *host_).max_segments(), Error);
}

TEST_F(TorchScript, RefusesRangesAndNormalisationsThatDoNotFit) {
  save_module(folder_ / "m.pt", kForward);
  EXPECT_THAT(metadata_refusal("control_low: [0, 0, 0, 0, 0]\n"),
              HasSubstr("control_high = [], the task has 5 variables: " + task_.trajectory->controls()[0].name + " "));
  EXPECT_THAT(metadata_refusal("control_low: [0, 0]\ncontrol_high: [1, 1]\n"), HasSubstr("control_low = [0, 0], "));
  EXPECT_THAT(metadata_refusal("control_low: [0, 0, 0, 2, 0]\ncontrol_high: [1, 1, 1, 1, 1]\n"),
              HasSubstr("control_low of " + task_.trajectory->controls()[3].name + " = 2, above control_high = 1"));
  const Variable first = task_.trajectory->controls()[0];
  EXPECT_THAT(metadata_refusal("control_low: [100, 0, 0, 0, 0]\ncontrol_high: [200, 1, 1, 1, 1]\n"),
              HasSubstr("range of " + first.name + " = [100, 200], the task has [" +
                        ConfigNode::number(first.lower).as_string() + ", " +
                        ConfigNode::number(first.upper).as_string() + "]"));
  EXPECT_THAT(metadata_refusal("control_low: [.nan, 0, 0, 0, 0]\n"), HasSubstr("control_low"));
  EXPECT_THAT(metadata_refusal("control_mean: [0, 0, 0, 0, 0]\n"), HasSubstr("control_sd = []"));
  EXPECT_THAT(metadata_refusal("state_mean: [0]\nstate_sd: [1]\n"), HasSubstr("state_mean = [0], "));
  EXPECT_THAT(metadata_refusal("state_mean: [0, 0, 0, 0, 0]\nstate_sd: [1, 1, 1, 1, 0]\n"), HasSubstr("state_sd"));
  EXPECT_THAT(metadata_refusal("length_unit_m: 0\n"), HasSubstr("length_unit_m"));
}

TEST_F(TorchScript, ComparesTheMaterialSpace) {
  save_module(folder_ / "m.pt", kForward);
  std::vector<std::string> log;
  host_ = make_host(registry(), {.threads = 1,
                                 .log = [&](LogLevel, const std::string& text) { log.push_back(text); },
                                 .checks = PluginChecks::none});
  const std::string basic = ConfigNode::load(WEFT_SOURCE_DIR "/configs/fabrics/basic.yaml").to_json();
  write_metadata("material: " + basic + "\n");
  bound();
  EXPECT_THAT(log, ::testing::IsEmpty());
  auto other = ConfigNode::parse(basic, "test").with("properties.bend.high", ConfigNode::number(11.0));
  EXPECT_THAT(metadata_refusal("material: " + other.to_json() + "\n"), HasSubstr("another space than the task's"));
  bound(true, "warn");
  EXPECT_THAT(log, ::testing::ElementsAre(HasSubstr("another space than the task's")));
  log.clear();
  write_metadata();
  bound();
  EXPECT_THAT(log, ::testing::ElementsAre(HasSubstr("has no material")));
}

/// Planning asks for 25 segments at first and for length + 5 later, and estimation for all that were executed.
TEST_F(TorchScript, ASessionKeepsToWhatTheModuleTakes) {
  save_module(folder_ / "m.pt", kForward);
  write_metadata("max_segments: 3\n");
  const auto config = ConfigNode::parse("{" + kTask + ", predictor: {plugin: torchscript, params: {module: '" +
                                            (folder_ / "m.pt").string() +
                                            "'}}, planning: {instances: 2, iterations: 2, replan_iterations: 1}, "
                                            "estimation: {instances: 2, iterations: 2, later_iterations: 1}, "
                                            "knowledge: estimate, true_material: [0.5, 0.5, 0.5, 0.5], "
                                            "goal: {controls: [1.8, 0, 0, 0, 0]}, max_segments: 5}",
                                        "test");
  SessionParams params;
  read_params(config, params);
  const SessionResult result = run_configured_session(params, config, *host_);
  ASSERT_EQ(result.rounds.size(), 5u);
  for (const auto& round : result.rounds) EXPECT_EQ(round.plan.horizon, 3);
  ASSERT_EQ(result.estimates.size(), 5u);
  EXPECT_NE(result.estimates[1].knowledge.centre, result.estimates[2].knowledge.centre);
  for (const std::size_t late : {3u, 4u})
    EXPECT_EQ(result.estimates[late].knowledge.centre, result.estimates[2].knowledge.centre);
  EXPECT_THAT(result.warnings, ::testing::Contains(HasSubstr("the predictor takes at most 3 segments")));
}

TEST_F(TorchScript, ExamplesThatAreLongerThanTheModuleTakesArePredictedToItsEnd) {
  save_module(folder_ / "m.pt", kForward);
  write_metadata("max_segments: 3\n");
  Dataset data;
  data.header.vertices = task_.garment->vertex_count();
  data.header.test_fraction = 1.0;
  for (const Index segments : {2, 3, 5}) {
    Example e;
    e.index = segments;
    e.controls = task_.trajectory->default_controls(segments);
    e.states.resize(segments + 1, static_cast<Index>(task_.trajectory->state().size()));
    e.states.row(0) = task_.trajectory->initial_state(task_.manipulation).transpose();
    for (Index j = 0; j < segments; ++j)
      e.states.row(j + 1) =
          task_.trajectory->segment(task_.manipulation, e.states.row(j).transpose(), e.controls.row(j).transpose())
              .end_state.transpose();
    for (Index j = 0; j <= segments; ++j) {
      for (Index k = 0; k < task_.garment->positions.size(); ++k)
        e.shapes.push_back(static_cast<float>(task_.garment->positions.data()[k]));
    }
    e.released = true;
    data.examples.push_back(e);
  }
  PredictionEvaluationParams params;
  params.baselines = false;
  const PredictionEvaluation result = evaluate_prediction(*bound(), task_, data, params, 1, *host_);
  EXPECT_EQ(result.by_step.size(), 3u);
  EXPECT_EQ(result.by_step.back().n, 2);
  EXPECT_EQ(result.from_start.n, 2);  // the settled shapes after 2 and 3 segments
  EXPECT_GE(result.shortened, 2);     // from the start with knowledge and without
}

TEST_F(TorchScript, ANetworksCaseDoesNotSeeTheOtherRows) {
  save_module(folder_ / "m.pt", kNetwork);
  write_metadata();
  const auto settings =
      ConfigNode::parse("params: {module: '" + (folder_ / "m.pt").string() + "'}\ntask: {" + kTask + "}", "test");
  for (const auto& law : check_conformance(*host_, "predictor", ConfigNode::parse("torchscript", "test"), settings,
                                           {"a_case_does_not_see_the_other_rows"}))
    EXPECT_TRUE(law.passed) << law.law << ": " << law.measured << " numbers differ";
}

TEST_F(TorchScript, APlanIsTheSameBitsWhicheverInstancesStillRun) {
  save_module(folder_ / "m.pt", kNetwork);
  write_metadata();
  PlannerParams params;
  params.instances = 5;
  params.horizon = 4;
  params.iterations = 8;
  params.halvings = 0;  // alone there is no worse half
  PlanRequest request;
  request.shape = std::make_shared<const Positions>(task_.garment->positions);
  Positions goal = task_.garment->positions;
  goal.col(2).array() += 0.01;
  request.goal = std::make_shared<const Positions>(goal);
  request.state = task_.trajectory->initial_state(task_.manipulation);
  const std::shared_ptr<const Predictor> predictor = bound();
  const auto plan = [&](std::shared_ptr<const Optimiser> by) {
    return Planner(task_, predictor, std::move(by), params, *host_).plan(request);
  };
  const auto descent = std::make_shared<const test::Descent>();
  const Plan together = plan(descent), alone = plan(std::make_shared<test::OneByOne>(descent, true));
  EXPECT_EQ(together.losses, alone.losses);
  EXPECT_EQ(together.controls, alone.controls);
}

TEST_F(TorchScript, RefusesAWrongSignatureNamingBothSides) {
  write_metadata();
  EXPECT_THAT(refusal("def forward(self, shape, controls):\n    return shape, controls\n"),
              HasSubstr("takes 2 arguments, must take 4: shape, states, controls, knowledge"));
  EXPECT_THAT(refusal("def predict(self, shape):\n    return shape\n"), HasSubstr("has no forward()"));
  const std::string four = "def forward(self, shape, states, controls, knowledge):\n";
  EXPECT_THAT(refusal(four + "    return shape\n"), HasSubstr("returned Tensor, must return (mean, sigma)"));
  EXPECT_THAT(refusal(four + "    return shape, shape\n"),
              HasSubstr("[2, 44, 3], must return (mean, sigma), float32 [2, 2, 44, 3]"));
  EXPECT_THAT(refusal(four + "    m = shape.unsqueeze(1).expand(-1, 2, -1, -1).double()\n    return m, m\n"),
              HasSubstr("returned Double [2, 2, 44, 3]"));
  EXPECT_THAT(refusal(four + "    m = shape @ controls\n    return m, m\n"), HasSubstr("forward() failed"));
}

TEST_F(TorchScript, RefusesOtherTasksAndDamage) {
  save_module(folder_ / "m.pt", kForward);
  EXPECT_THAT(message_of<ConfigError>([&] { bound(); }), HasSubstr("m.yaml"));
  write_metadata("", "12345");
  EXPECT_THAT(message_of<ConfigError>([&] { bound(); }),
              HasSubstr("garment_hash = 12345, the task has " + std::to_string(task_.garment->hash)));
  write_metadata("drop_height_m: 0.07\n");
  EXPECT_THAT(message_of<ConfigError>([&] { bound(); }), HasSubstr("drop_height_m = 0.07"));
  write_metadata("opens_at: [0.5, 1]\n");
  EXPECT_THAT(message_of<ConfigError>([&] { bound(); }), HasSubstr("opens_at = [0.5, 1], the task has []"));
  write_metadata("previous: true\n");
  EXPECT_THAT(message_of<ConfigError>([&] { bound(); }), HasSubstr("takes 4 arguments, must take 5"));
  write_metadata();
  std::ofstream(folder_ / "m.pt", std::ios::binary) << "PK\x03\x04 no module";
  EXPECT_THAT(message_of<ConfigError>([&] { bound(); }), HasSubstr("is not a TorchScript file"));
  TorchScriptPredictor none(Params{}, *host_);
  EXPECT_THAT(message_of<ConfigError>([&] { none.bind(task_); }), HasSubstr("params.module"));
  EXPECT_THROW(none.predict({}, {}), Error);
}

TEST_F(TorchScript, AModuleThatGivesNoNumberFailsThatCaseAlone) {
  save_module(folder_ / "m.pt", R"(
def forward(self, shape, states, controls, knowledge):
    mean = shape.unsqueeze(1) + torch.log(0.8 - knowledge[:, 0:1]).unsqueeze(1).unsqueeze(1) * torch.ones_like(controls[:, :, 0:1]).unsqueeze(2)
    return mean, torch.ones_like(mean)
)");
  write_metadata();
  const auto predictor = bound();
  PredictionCase one;
  one.shape = std::make_shared<const Positions>(task_.garment->positions);
  one.state = task_.trajectory->initial_state(task_.manipulation);
  one.controls = task_.trajectory->default_controls(2);
  one.segments = {1, 2};
  auto bad = one;
  bad.knowledge.centre[0] = 0.9;
  const auto prediction = predictor->predict({one, bad}, {});
  EXPECT_EQ(prediction->failure(0), "");
  EXPECT_EQ(prediction->shapes()[0].size(), 2u);
  EXPECT_THAT(prediction->failure(1), HasSubstr("is not finite"));
  EXPECT_TRUE(prediction->shapes()[1].empty());
}

}  // namespace
}  // namespace weft::torchscript
