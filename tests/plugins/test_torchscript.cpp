// Exported PyTorch modules as predictors. The modules are written here, in TorchScript, without Python.
#include <ATen/ATen.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <torch/csrc/jit/api/module.h>

#include <cmath>
#include <fstream>

#include "predictor/torchscript/torchscript.hpp"
#include "unit/descent.hpp"
#include "unit/test_support.hpp"
#include "weft/conformance.hpp"
#include "weft/planner.hpp"
#include "weft/task.hpp"

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

/// Two layers over what the controls add up to: products of matrices whose size follows the batch.
const std::string kNetwork = R"(
def forward(self, shape, states, controls, knowledge):
    b, k, v = shape.size(0), controls.size(1), shape.size(1)
    known = knowledge.unsqueeze(1).expand(b, k, 8)
    inputs = torch.cat([0.1 * torch.cumsum(controls, 1), 0.01 * states[:, 1:], known], 2)
    hidden = torch.tanh(torch.matmul(inputs, self.encode))
    mean = shape.unsqueeze(1) + 0.02 * torch.matmul(hidden, self.decode)[:, :, :3 * v].view(b, k, v, 3)
    return mean, 0.001 + torch.square(mean)
)";

void save_module(const std::filesystem::path& file, const std::string& source) {
  torch::jit::Module module("predictor");
  module.register_parameter("gain", at::full({1}, 0.7f), false);
  const auto weights = [](std::int64_t rows, std::int64_t columns) {
    return at::sin(at::arange(rows * columns).to(at::kFloat) * 1.7f).reshape({rows, columns}).contiguous();
  };
  module.register_parameter("encode", weights(18, 96), false);
  module.register_parameter("decode", weights(96, 300), false);
  module.define(source);
  module.save(file.string());
}

std::shared_ptr<const PluginRegistry> registry() {
  return std::make_shared<PluginRegistry>(std::vector<std::filesystem::path>{WEFT_BINARY_DIR "/lib/weft/plugins"});
}

class TorchScript : public ::testing::Test {
 protected:
  TorchScript() : host_(make_host(registry(), {.threads = 1})) {
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
  std::unique_ptr<TorchScriptPredictor> bound(bool batch = true) const {
    Params params;
    params.module = folder_ / "m.pt";
    params.batch = batch;
    auto predictor = std::make_unique<TorchScriptPredictor>(params, *host_);
    predictor->bind(task_);
    return predictor;
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
  PredictionCase one;
  one.shape = std::make_shared<const Positions>(task_.garment->positions);
  one.state = task_.trajectory->initial_state(task_.manipulation);
  one.controls = 0.5 * task_.trajectory->default_controls(3);
  one.controls(1, 3) = 0.01;
  one.knowledge.centre << 0.1, 0.2, 0.3, 0.4;
  one.knowledge.width << 0.5, 0.6, 0.7, 0.8;
  one.segments = {2, 3};
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
  write_metadata();
  const auto host = make_host(registry(), {.threads = 2});
  for (const std::string batch : {"true", "false"}) {
    const std::string params = "params: {batch: " + batch + ", module: '" + (folder_ / "m.pt").string() + "'}\n";
    const auto settings = ConfigNode::parse(params + "task: {" + kTask + "}", "test");
    for (const auto& law : check_conformance(*host, "predictor", ConfigNode::parse("torchscript", "test"), settings)) {
      EXPECT_TRUE(law.passed) << law.law << ": " << law.measured << " > " << law.bound << " " << law.detail;
    }
  }
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
  write_metadata("previous: true\n");
  EXPECT_THAT(message_of<ConfigError>([&] { bound(); }), HasSubstr("takes 4 arguments, must take 5"));
  write_metadata();
  std::ofstream(folder_ / "m.pt", std::ios::binary) << "PK\x03\x04 no module";
  EXPECT_THAT(message_of<ConfigError>([&] { bound(); }), HasSubstr("is no TorchScript file"));
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
