// Plugins that load and then go wrong in `weft run`: the message names the one that is wrong, and when it was. The toys
// of the conformance kit play all four parts.
#include "unit/test_program.hpp"
#include "unit/test_support.hpp"

namespace weft {
namespace {

using test::Folder;
using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

const std::string kConfigs = WEFT_SOURCE_DIR "/configs";

/// Runs a shipped task with four toys, whose parameters are given by slot. The toy cloth has no threads, so that goals
/// differ less than those of cloth.
test::Outcome run_toys(const Folder& out, const std::string& command, const std::map<std::string, std::string>& params,
                       const std::string& more = "") {
  std::string line = "WEFT_PLUGIN_PATH='" WEFT_TOYS "' '" WEFT_PROGRAM "' " + command + " '" + kConfigs +
                     "/tasks/towel_fold_isotropic.yaml' --jobs 2 --out '" + (out / "r").string() + "' --set garment='" +
                     kConfigs + "/garments/towel_coarse.yaml' --set goal.random.min_distance_mm=1";
  for (const std::string kind : {"simulator", "predictor", "trajectory", "optimiser"}) {
    const auto given = params.find(kind);
    line += " --set " + kind + "='{plugin: toy_" + kind + ", params: {" + (given == params.end() ? "" : given->second) +
            "}}'";
  }
  return test::run_shell(line + " " + more);
}

/// One way in which a plugin goes wrong, and the beginning of what weft says about it.
struct Fault {
  std::string kind, params, message;
};

std::string planning(const std::string& kind) { return kind + " toy_" + kind + ", planning, segment 1: "; }

std::vector<Fault> wrong_results() {
  const std::string predictor = "error: " + planning("predictor"), optimiser = "error: " + planning("optimiser"),
                    trajectory = "error: " + planning("trajectory"),
                    environment = "error: simulator toy_simulator, making the environment: ",
                    goal = "error: simulator toy_simulator, making the goal: ";
  return {
      {"predictor", "mutation: null_prediction", predictor + "predict() returned no prediction"},
      {"predictor", "mutation: one_result", predictor + "the list of cases from predict() has size 1, must have 2"},
      {"predictor", "mutation: missing_shapes", predictor + "the list of shapes of a case from predict() has size 0"},
      {"predictor", "mutation: a_vertex_short", predictor + "a mean from predict(), counted in rows, has size 43"},
      {"predictor", "mutation: nan_mean", predictor + "a mean from predict() is not finite"},
      {"predictor", "mutation: no_d_controls", predictor + "d controls from pullback(), counted in rows, has size 0"},
      {"predictor", "mutation: one_d_control", predictor + "d controls from pullback(), counted in rows, has size 1"},
      {"predictor", "mutation: nan_d_controls", predictor + "a gradient from pullback() is not finite"},
      {"predictor", "mutation: gradient_of_one_case", predictor + "the list of gradients from pullback() has size 1"},
      {"predictor", "spoil: long, result: control_range", "the lower bound from control_range() has size 3"},
      {"optimiser", "spoil: long, result: point", optimiser + "a point x that it evaluates has size "},
      {"optimiser", "spoil: nan, result: point", optimiser + "a point x that it evaluates is not finite"},
      {"optimiser", "spoil: empty, result: x", optimiser + "x of a result from minimise() has size 0"},
      {"optimiser", "spoil: nan, result: x", optimiser + "x of a result from minimise() is not finite"},
      {"optimiser", "spoil: nan, result: cost", optimiser + "the cost of a result from minimise() is NaN"},
      {"optimiser", "spoil: empty, result: results", optimiser + "the list of results from minimise() has size 0"},
      {"optimiser", "fault: x_out_of_bounds", optimiser + "x of a result from minimise() is out of bounds"},
      {"trajectory", "spoil: empty, result: decode_pullback", trajectory + "the gradient from decode_pullback() has"},
      {"trajectory", "spoil: nan, result: decode", trajectory + "a control from decode() is not finite"},
      {"trajectory", "spoil: long, result: encode", trajectory + "x from encode() has size "},
      {"trajectory", "spoil: nan, result: targets", "trajectory toy_trajectory, "},
      {"trajectory", "spoil: empty, result: initial_state", "the state from initial_state() has size 0, must have 2"},
      {"simulator", "spoil: nan, result: positions", environment + "a position after reset() is not finite"},
      {"simulator", "spoil: empty, result: velocities",
       environment + "velocities(), counted in rows, after reset() has"},
      {"simulator", "spoil: empty, result: grasped", environment + "grasped() after grasp() has size 0, must have 2"},
      {"simulator", "spoil: nan, result: max_speed", goal + "max_speed from settle() is not finite"},
      {"simulator", "spoil: nan, result: strain", goal + "a speed or strain from diagnostics() is not finite"},
  };
}

TEST(Misbehaving, FourHonestToysRunAShippedTask) {
  const Folder out;
  const auto run = run_toys(out, "run", {});
  EXPECT_EQ(run.code, 0) << run.output;
  EXPECT_TRUE(std::filesystem::exists(out / "r/session.h5"));
}

TEST(Misbehaving, WhoReturnsNonsenseIsNamed) {
  for (const auto& [kind, params, message] : wrong_results()) {
    const Folder out;
    const auto run = run_toys(out, "run", {{kind, params}});
    EXPECT_EQ(run.code, 1) << kind << ", " << params;
    EXPECT_THAT(run.output, AllOf(HasSubstr(kind + " toy_" + kind), HasSubstr(message))) << params;
    EXPECT_THAT(run.output, HasSubstr("`weft conformance toy_" + kind + "`")) << "the remedy";
  }
}

TEST(Misbehaving, AnythingThrownComesBackWithPluginAndStep) {
  for (const std::string kind : {"predictor", "optimiser"}) {
    const Folder out;
    EXPECT_THAT(run_toys(out, "run", {{kind, "fault: throw_42"}}).output,
                HasSubstr("error: " + planning(kind) + "it threw something that is not a std::exception"));
    EXPECT_THAT(run_toys(out, "run", {{kind, "fault: throw_map_at"}}).output,
                HasSubstr("error: " + planning(kind) + "map::at"));
  }
  const Folder out;
  EXPECT_THAT(run_toys(out, "run", {{"simulator", "fault: throw_map_at"}}).output,
              HasSubstr("error: simulator toy_simulator, making the goal: map::at"));
  EXPECT_THAT(run_toys(out, "run", {{"trajectory", "fault: throw_42"}}).output,
              AllOf(HasSubstr("error: trajectory toy_trajectory, "), HasSubstr("is not a std::exception")));
}

TEST(Misbehaving, ACrashNamesPluginFunctionAndStep) {
  for (const std::string kind : {"predictor", "optimiser"}) {
    const Folder out;
    const auto crash = run_toys(out, "run", {{kind, "fault: null_pointer"}});
    EXPECT_NE(crash.code, 0);
    EXPECT_THAT(crash.output, AllOf(HasSubstr("SIGSEGV (Segmentation fault) in plugin " + kind + " toy_" + kind),
                                    HasSubstr("weft::toy::misbehave("), HasSubstr("planning, segment 1")));
    const auto exit = run_toys(out, "run", {{kind, "fault: exit"}});
    EXPECT_EQ(exit.code, 1) << "exit(0) of a plugin is a failure";
    EXPECT_THAT(exit.output, HasSubstr("a call of exit(0) in plugin " + kind + " toy_" + kind));
  }
}

TEST(Misbehaving, WhatAPluginPrintsDoesNotBreakJson) {
  const Folder out;
  const auto run = run_toys(out, "run", {{"simulator", "fault: print"}}, "--json 2>/dev/null");
  EXPECT_EQ(run.code, 0);
  EXPECT_THAT(run.output, AllOf(::testing::StartsWith("{"), Not(HasSubstr("of a plugin"))));
}

/// run, simulate and the law agree: who has one stiffness for warp and weft refuses a fabric that has two.
TEST(Misbehaving, RunAndSimulateRefuseAFabricThatTheSimulatorCannotHave) {
  const Folder out;
  const std::string material = "--set material='" + kConfigs + "/fabrics/basic.yaml'";
  const auto run = run_toys(out, "run", {}, material);
  EXPECT_EQ(run.code, 2) << run.output;
  EXPECT_THAT(run.output,
              AllOf(HasSubstr("stretch_n_per_m"), HasSubstr("(capability orthotropic); set both to their mean")));
  out.write("scene.yaml", "garment: " + kConfigs +
                              "/garments/towel_coarse.yaml\nduration_s: 0.1\n"
                              "simulator: {plugin: toy_simulator}\n"
                              "fabric: {stretch_n_per_m: {warp: 165, weft: 110, shear: 55}}\n");
  const auto simulate = test::run_shell("WEFT_PLUGIN_PATH='" WEFT_TOYS "' '" WEFT_PROGRAM "' simulate '" +
                                        (out / "scene.yaml").string() + "' --out '" + (out / "s").string() + "'");
  EXPECT_EQ(simulate.code, 2) << simulate.output;
  EXPECT_THAT(simulate.output,
              AllOf(HasSubstr("stretch_n_per_m"), HasSubstr("(capability orthotropic); set both to their mean")));
}

}  // namespace
}  // namespace weft
