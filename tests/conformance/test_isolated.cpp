// `weft conformance` and a plugin that crashes, hangs, prints or ends the program: one law fails, the others go on.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>

#include "unit/test_program.hpp"

namespace weft {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;
using ::testing::StartsWith;

test::Outcome conformance(const std::string& kind, const std::string& arguments) {
  return test::run_shell("'" WEFT_PROGRAM "' conformance '" WEFT_TOYS "/libweft_" + kind + "_toy_" + kind + ".so' " +
                         arguments);
}

/// A law whose check makes the toy's main call.
std::string law_of(const std::string& kind) {
  if (kind == "simulator") return "falls_freely";
  if (kind == "predictor") return "same_input_same_bits";
  return kind == "trajectory" ? "path_is_continuous" : "solves_rosenbrock";
}

class Isolated : public testing::TestWithParam<std::string> {
 protected:
  test::Outcome with_fault(const std::string& fault, const std::string& more = "") {
    return conformance(GetParam(), "--law " + law_of(GetParam()) + " --set params.fault=" + fault + " " + more);
  }
};
INSTANTIATE_TEST_SUITE_P(Every, Isolated, testing::Values("simulator", "predictor", "trajectory", "optimiser"),
                         [](const auto& which) { return which.param; });

TEST_P(Isolated, ACrashNamesTheLawThePluginAndTheFunction) {
  const auto crash = with_fault("null_pointer");
  EXPECT_EQ(crash.code, 1);
  EXPECT_THAT(crash.output, AllOf(HasSubstr("FAIL " + law_of(GetParam())),
                                  HasSubstr("SIGSEGV (Segmentation fault) in plugin " + GetParam() + " toy_" +
                                            GetParam() + ", weft::toy::misbehave("),
                                  HasSubstr("0 of 1 laws hold")));
  EXPECT_THAT(with_fault("abort").output, HasSubstr("SIGABRT"));
}

TEST_P(Isolated, ExitIsAFailure) {
  for (const std::string call : {"exit", "_exit", "_Exit", "quick_exit"}) {
    const auto left = with_fault(call);
    EXPECT_EQ(left.code, 1) << call;
    EXPECT_THAT(left.output, HasSubstr("a call of " + call + "(0) in plugin " + GetParam() + " toy_" + GetParam() +
                                       ", weft::toy::misbehave("));
  }
}

TEST_P(Isolated, AnythingThrownIsNamed) {
  const std::string plugin = "threw: " + GetParam() + " toy_" + GetParam() + ", ";
  EXPECT_THAT(with_fault("throw_42").output,
              AllOf(HasSubstr(plugin), HasSubstr("it threw something that is not a std::exception")));
  EXPECT_THAT(with_fault("throw_map_at").output, AllOf(HasSubstr(plugin), HasSubstr("map::at")));
  EXPECT_THAT(with_fault("throw_in_thread").output, HasSubstr("SIGABRT"));
}

TEST_P(Isolated, AHangIsNamedAndEnded) {
  const auto loop = with_fault("spin", "--limit 1");
  EXPECT_EQ(loop.code, 1);
  EXPECT_THAT(loop.output, AllOf(HasSubstr("s of CPU time"), HasSubstr("weft::toy::misbehave(")));
  const auto wait = with_fault("sleep", "--limit 1");
  EXPECT_EQ(wait.code, 1);
  EXPECT_THAT(wait.output, HasSubstr("used no CPU time for"));
}

TEST_P(Isolated, WhatAPluginPrintsDoesNotBreakJson) {
  const auto plain = with_fault("print", "--json 2>/dev/null");
  EXPECT_EQ(plain.code, 0) << plain.output;
  EXPECT_THAT(plain.output, AllOf(StartsWith("{"), HasSubstr("\"passed\": true"), Not(HasSubstr("of a plugin"))));
  EXPECT_THAT(with_fault("print", "2>&1 >/dev/null").output,
              AllOf(HasSubstr("printf of a plugin"), HasSubstr("cout of a plugin")));
}

TEST(IsolatedLaws, ALineIsPrintedForEveryLawAlsoAfterACrash) {
  const auto all = conformance("trajectory", "--set params.fault=null_pointer");
  EXPECT_EQ(all.code, 1);
  EXPECT_THAT(all.output, AllOf(HasSubstr("FAIL variables_are_well_formed"), HasSubstr("FAIL refuses_bad_shapes"),
                                HasSubstr("0 of 12 laws hold")));
}

TEST(IsolatedLaws, WrongInputIsTheUsersAndFailsNoLaw) {
  const auto wrong = conformance("trajectory", "--set params.fualt=exit");
  EXPECT_EQ(wrong.code, 2);
  EXPECT_THAT(wrong.output, AllOf(HasSubstr("error: "), HasSubstr("nearest: fault"), Not(HasSubstr("FAIL"))));
}

}  // namespace
}  // namespace weft
