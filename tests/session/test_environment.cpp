// A child process as the environment: a whole session with the example in Python, and the mistakes that a process can
// make.
#include <sys/wait.h>

#include <cerrno>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <iterator>
#include <nlohmann/json.hpp>
#include <optional>

#include "session/process_environment.hpp"
#include "session/session_file.hpp"
#include "session/towel_session.hpp"

namespace weft {
namespace {

using testing::HasSubstr;

class ProcessSession : public Session {
 protected:
  /// What `weft export --to csv --every 12` writes, with every digit: the looks of a session without noise.
  std::string looks_as_csv(const SessionResult& session) const {
    std::string text = "frame,time_s,vertex,x_m,y_m,z_m\n";
    const auto add = [&](std::size_t frame, const Positions& shape) {
      char line[160];
      for (Index v = 0; v < shape.rows(); ++v) {
        std::snprintf(line, sizeof(line), "%zu,%g,%td,%.17g,%.17g,%.17g\n", frame, frame / 60.0, v, shape(v, 0),
                      shape(v, 1), shape(v, 2));
        text += line;
      }
    };
    add(0, session.start);
    for (std::size_t j = 0; j < session.rounds.size(); ++j) {
      const bool settled = j + 1 == session.rounds.size();
      add(settled ? session.frames.size() - 1 : (j + 1) * kFramesPerSegment, session.rounds[j].observed);
    }
    return text;
  }
  /// The same session with the example in place of the simulator.
  /// @param script in place of the example; empty: the example.
  SessionResult replay(const SessionResult& session, const std::vector<std::string>& overrides,
                       const std::string& script = WEFT_SOURCE_DIR "/docs/examples/replay_environment.py") {
    folder_.write("vertices.csv", looks_as_csv(session));
    const auto kept = task().garment;
    const Garment& garment = *kept;
    write_obj(folder_ / "goal.obj", {session.goal, garment.faces, garment.rest, "goal"}, true);
    return run(with(overrides,
                    {"environment.command=[python3, " + script + ", vertices.csv]",
                     "environment.folder=" + folder_.path().string(), "goal.obj=" + (folder_ / "goal.obj").string()}));
  }
  static void expect_same_plans(const SessionResult& one, const SessionResult& two) {
    ASSERT_EQ(one.rounds.size(), two.rounds.size());
    for (std::size_t i = 0; i < one.rounds.size(); ++i) {
      EXPECT_EQ(one.rounds[i].plan.controls, two.rounds[i].plan.controls) << i;
      EXPECT_EQ(one.rounds[i].plan.losses, two.rounds[i].plan.losses) << i;
      EXPECT_EQ(one.rounds[i].observed, two.rounds[i].observed) << i;
    }
  }
};

TEST_F(ProcessSession, AReplayedSessionHasTheSamePlans) {
  const SessionResult simulated = run();
  std::string centre;
  for (Index p = 0; p < 4; ++p)
    centre += (p > 0 ? ", " : "") + ConfigNode::number((*simulated.true_material)(p)).as_string();
  const SessionResult replayed =
      replay(simulated, {"knowledge=given", "given_centre=[" + centre + "]", "given_width=[0, 0, 0, 0]"});
  expect_same_plans(simulated, replayed);
  EXPECT_TRUE(replayed.released);
  EXPECT_EQ(replayed.start, simulated.start);
  EXPECT_EQ(replayed.final_shape, simulated.final_shape);
  EXPECT_NEAR(replayed.error_mm, simulated.error_mm, 1e-9);
  EXPECT_TRUE(simulated.shapes_are_true);
  EXPECT_FALSE(replayed.shapes_are_true);
  EXPECT_FALSE(replayed.true_material.has_value());
  EXPECT_FALSE(replayed.max_grasp_strain.has_value());
}

TEST_F(ProcessSession, AReplayedSessionHasTheSameEstimates) {
  const SessionResult simulated = run(kEstimate), replayed = replay(simulated, kEstimate);
  expect_same_plans(simulated, replayed);
  ASSERT_EQ(simulated.estimates.size(), replayed.estimates.size());
  for (std::size_t i = 0; i < simulated.estimates.size(); ++i) {
    EXPECT_EQ(simulated.estimates[i].losses, replayed.estimates[i].losses) << i;
    EXPECT_EQ(simulated.estimates[i].knowledge.centre, replayed.estimates[i].knowledge.centre) << i;
  }
}

TEST_F(ProcessSession, ErrorsAreThoseOfTheVerticesThatWereSeen) {
  const std::vector<std::string> quick = {"planning.iterations=0", "planning.replan_iterations=0",
                                          "planning.instances=1", "knowledge=none"};
  const SessionResult simulated = run(quick);
  const Index hidden = task().manipulation.grasp_vertices[0];
  std::ifstream example(WEFT_SOURCE_DIR "/docs/examples/replay_environment.py");
  std::string script{std::istreambuf_iterator<char>(example), {}};
  const std::string whole = "frames[frame]}";
  ASSERT_NE(script.find(whole), std::string::npos);
  script.replace(script.find(whole), whole.size(),
                 "[None if v == " + std::to_string(hidden) + " else p for v, p in enumerate(frames[frame])]}");
  const SessionResult result = replay(simulated, quick, folder_.write("hiding.py", script).string());
  std::vector<bool> seen(result.goal.rows(), true);
  seen[hidden] = false;
  const ShapeErrors expected = shape_errors(result.final_shape, result.goal, task(), seen);
  EXPECT_EQ(result.errors.max_mm, expected.max_mm);
  EXPECT_EQ(result.errors.grasped_mm, expected.grasped_mm);
  EXPECT_EQ(result.errors.named_mm, expected.named_mm);
  EXPECT_EQ(result.errors.iou, expected.iou);
  const Index other = task().manipulation.grasp_vertices[1];
  EXPECT_NEAR(result.errors.grasped_mm, 1000.0 * (result.final_shape.row(other) - result.goal.row(other)).norm(), 1e-9);
  EXPECT_NE(simulated.errors.grasped_mm, result.errors.grasped_mm);
}

TEST_F(ProcessSession, TheSessionFileSaysWhatIsNotKnown) {
  const std::vector<std::string> quick = {"planning.iterations=0", "planning.replan_iterations=0",
                                          "planning.instances=1", "knowledge=none"};
  const SessionResult result = replay(run(quick), quick);
  write_session(folder_ / "session.h5", result, task(), resolved_, "{}");
  const SessionRecord record = read_session(folder_ / "session.h5");
  EXPECT_FALSE(record.true_material.has_value());
  EXPECT_TRUE(record.released());
  EXPECT_EQ(record.settle_frames(), 1);
  for (Index j = 0; j < record.segments(); ++j) {
    const Positions look = result.rounds[j].observed.cast<float>().cast<double>();
    EXPECT_EQ(record.shape_after(j), look) << j;
  }
  // Between two looks each frame holds the look before it.
  EXPECT_EQ(record.frames[kFramesPerSegment - 1], record.frames[0]);
  const auto summary = nlohmann::json::parse(record.summary);
  EXPECT_TRUE(summary["true_material"].is_null());
  EXPECT_TRUE(summary["max_grasp_strain"].is_null());
  EXPECT_EQ(summary["shapes"], "observed");
}

TEST_F(ProcessSession, RefusesConfigsThatAProcessCannotServe) {
  const std::pair<std::vector<std::string>, std::string> cases[] = {
      {{"environment.command=[/none/robot]", "knowledge=none"},
       "--set: environment.command = [/none/robot]: cannot be run: No such file or directory"},
      {{"environment.command=[cat]", "environment.folder=/none", "knowledge=none"}, "/none does not exist"},
      {{"environment.command=[cat]"}, "knowledge = true, which needs true_material"},
      {{"environment.command=[cat]", "knowledge=drawn"}, "--set: knowledge = drawn, which needs true_material"},
      {{"environment.command=[cat]", "knowledge=none", "observation.hidden_share=0.5"},
       "--set: observation.hidden_share = 0.5, must be 0 with environment.command"},
  };
  for (const auto& [overrides, expected] : cases)
    EXPECT_THAT(test::message_of<ConfigError>([&] { run(overrides); }), HasSubstr(expected)) << overrides.front();
}

/// A process that greets as it should and answers everything else in its own way.
class Process : public Session {
 protected:
  Process() { task_ = task(); }
  /// @param cases lines of Python that follow the greeting. @param before lines of Python before the greeting.
  std::unique_ptr<ProcessEnvironment> start(const std::string& cases, double timeout_s = 20.0,
                                            const std::string& version = "1", const std::string& before = "pass") {
    const std::string text =
        "import json, os, sys, time\n"
        "def answer(type, **more):\n"
        "    print(json.dumps({'type': type, **more}), flush=True)\n"
        "for line in sys.stdin:\n"
        "    request = json.loads(line)\n"
        "    kind = request['type']\n"
        "    if kind == 'hello':\n"
        "        n = request['garment']['vertices']\n"
        "        " +
        before +
        "\n"
        "        answer('hello', protocol='weft environment', version=" +
        version + ")\n" + cases;
    ProcessOptions options;
    options.command = {"python3", folder_.write("child.py", text).string()};
    options.timeout_s = timeout_s;
    options.sigma = 0.004;
    return std::make_unique<ProcessEnvironment>(options, task_);
  }
  std::string refusal(const std::string& cases, double timeout_s = 20.0) {
    return test::message_of<Error>([&] { start(cases, timeout_s)->observe(); });
  }
  void TearDown() override {
    EXPECT_EQ(waitpid(-1, nullptr, WNOHANG), -1) << "a child is left";
    EXPECT_EQ(errno, ECHILD);
  }
  Task task_;
};

TEST_F(Process, SaysWhatIsSeenAndHowWell) {
  const auto child = start(
      "    elif kind == 'observe':\n"
      "        answer('observation', positions_m=[None, [0.1, -2e-3, 3]] + [[0, 0, 1]] * (n - 2), height_sigma_m=0.5,\n"
      "               warning='the light is bad')\n"
      "    elif kind == 'execute':\n"
      "        assert len(request['targets_m']) == 12 and len(request['targets_m'][0]) == 2\n"
      "        answer('executed')\n"
      "    else:\n"
      "        answer('released', settled=False, settle_s=2.0)\n");
  const Observation seen = child->observe();
  child->observe();
  EXPECT_FALSE(seen.sees(0));
  EXPECT_TRUE(seen.sees(1));
  EXPECT_EQ(seen.positions.row(1), Eigen::RowVector3d(0.1, -2e-3, 3));
  EXPECT_EQ(seen.sigma, 0.004);  // it did not say its own
  EXPECT_EQ(seen.height_sigma, 0.5);
  EXPECT_EQ(child->warnings(), std::vector<std::string>{"the light is bad"});
  SegmentPath path;
  path.targets.assign(kFramesPerSegment, task_.manipulation.grasp_points);
  child->execute(path);
  const SettleResult settle = child->release();
  EXPECT_FALSE(settle.settled);
  EXPECT_EQ(settle.frames, 120);
  // Mean over the observed vertices.
  Positions shape = Positions::Zero(seen.positions.rows(), 3);
  shape.col(2).setOnes();
  const double far = (seen.positions.row(1) - shape.row(1)).norm();
  EXPECT_NEAR(seen_distance_mm(seen, shape), 1000.0 * far / static_cast<double>(shape.rows() - 1), 1e-9);
}

TEST_F(Process, IsToldWhichHandsOpenInAVersionOfItsOwn) {
  task_.manipulation.opens_at = Vector(Eigen::Vector2d(0.5, 1.0));
  const auto child = start(
      "    elif kind == 'execute':\n"
      "        answer('executed', warning=json.dumps(request['opening']))\n",
      20.0, "2");
  SegmentPath path;
  path.targets.assign(kFramesPerSegment, task_.manipulation.grasp_points);
  child->execute(path);
  path.opening = {0};
  child->execute(path);
  EXPECT_EQ(child->warnings(), (std::vector<std::string>{"[]", "[0]"}));
  EXPECT_THAT(test::message_of<Error>([&] { start(""); }),
              HasSubstr("speaks version '1' of the protocol, this weft speaks version 2 where hands open one by one"));
}

TEST_F(Process, EveryFailureHasItsOwnMessage) {
  const std::string n = std::to_string(task_.garment->vertex_count());
  const std::pair<std::string, std::string> cases[] = {
      {"sys.exit(3)", "ended with exit code 3 before it answered observe"},
      {"os.kill(os.getpid(), 9)", "was ended by SIGKILL (Killed) before it answered observe"},
      {"print('ready', flush=True)", "answered observe with 'ready', must be one line of JSON"},
      {"print('[1]', flush=True)", "answered observe with '[1]', must be an object with a type"},
      {"answer('executed')", "answered observe with type 'executed', must be 'observation'"},
      {"answer('error', message='no cloth')", "refuses observe: no cloth"},
      {"answer('observation')", "sent an observation without positions_m"},
      {"answer('observation', positions_m=[[0, 0, 0]] * 2)", "observed 2 vertices, must be " + n},
      {"answer('observation', positions_m=[[0, 0]] * n)", "observed vertex 0 at '[0,0]', must be [x, y, z] in m"},
      {"answer('observation', positions_m=[None] * n)", "observed no vertex"},
      {"answer('observation', positions_m=[[0, 0, float('nan')]] * n)", "with a number that is not finite"},
      {"print('{\"type\": \"observation\", \"positions_m\": [[1e999, 0, 0]]}', flush=True)",
       "with a number that is not finite"},
      {"answer('observation', positions_m=[[0, 0, 0]] * n, sigma_m=-1)",
       "answered `sigma_m` = '-1', must be a number >= 0"},
      {"print('x' * 5000000, flush=True)", "with a line of more than "},
  };
  for (const auto& [line, expected] : cases) {
    const std::string message = refusal("    else:\n        " + line + "\n");
    EXPECT_THAT(message, HasSubstr(expected)) << line;
    EXPECT_THAT(message, HasSubstr("environment `python3 ")) << line;
  }
}

TEST_F(Process, SilenceEndsAfterTheTimeout) {
  EXPECT_THAT(refusal("    else:\n        time.sleep(60)\n", 10.0),  // enough for a greeting on a busy machine
              HasSubstr("did not answer observe within 10 s (environment.timeout_s)"));
}

TEST_F(Process, OneThatNoLongerReadsIsAnErrorAndNoSignal) {
  // Its stdin is closed before it greets, so that the next request cannot be written.
  const auto child = start("        time.sleep(60)\n", 20.0, "1", "os.close(0)");
  EXPECT_THAT(test::message_of<Error>([&] { child->observe(); }),
              HasSubstr("closed its pipe before it answered observe"));
}

TEST_F(Process, MoreThanOneAnswerIsRefused) {
  const auto child = start("    else:\n        print('{\"type\": \"executed\"}\\n' * 2, end='', flush=True)\n");
  SegmentPath path;
  path.targets.assign(kFramesPerSegment, task_.manipulation.grasp_points);
  child->execute(path);
  EXPECT_THAT(test::message_of<Error>([&] { child->observe(); }), HasSubstr("sent more than its answer"));
}

TEST_F(Process, AnotherVersionIsRefusedWithBothNamed) {
  EXPECT_THAT(test::message_of<Error>([&] { start("", 20.0, "2"); }),
              HasSubstr("speaks version '2' of the protocol, this weft speaks version 1"));
}

}  // namespace
}  // namespace weft
