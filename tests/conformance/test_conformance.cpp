// The kit itself: every law holds for a toy that obeys it and fails for a mutant that does not.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <fstream>
#include <map>
#include <sstream>

#include "conformance/conformance.hpp"
#include "loader/program_host.hpp"

namespace weft {
namespace {

const std::vector<std::string> kKinds = {"simulator", "predictor", "trajectory", "optimiser"};

class Conformance : public testing::Test {
 protected:
  std::vector<LawResult> check(const std::string& kind, const std::string& params, const ConfigNode& tolerances = {},
                               const std::vector<std::string>& only = {}) {
    const auto slot = ConfigNode::parse("{plugin: toy_" + kind + ", params: {" + params + "}}", "test");
    return check_conformance(*host_, kind, slot, tolerances, only);
  }
  std::shared_ptr<const PluginRegistry> registry_ =
      std::make_shared<PluginRegistry>(std::vector<std::filesystem::path>{WEFT_TOYS});
  std::unique_ptr<Host> host_ = make_host(registry_, HostOptions{.threads = 1, .checks = PluginChecks::results});
};

struct Kind : Conformance, testing::WithParamInterface<std::string> {};
INSTANTIATE_TEST_SUITE_P(Every, Kind, testing::ValuesIn(kKinds), [](const auto& which) { return which.param; });

TEST_P(Kind, LawsHoldForTheToy) {
  for (const auto& r : check(GetParam(), "mutation: none"))
    EXPECT_TRUE(r.passed) << r.law << ": " << r.measured << " > " << r.bound << "  " << r.detail;
}

TEST_P(Kind, LawsHoldForTheToyThatDeclaresNothing) {
  for (const auto& r : check(GetParam(), "declare: false"))
    EXPECT_TRUE(r.passed) << r.law << ": " << r.measured << " > " << r.bound << "  " << r.detail;
}

TEST_P(Kind, EveryLawHasAMutantThatFailsIt) {
  for (const auto& law : list_laws(GetParam())) {
    const auto results = check(GetParam(), "mutation: " + law.law, {}, {law.law});
    ASSERT_EQ(results.size(), 1u);
    EXPECT_EQ(results[0].law, law.law);
    EXPECT_FALSE(results[0].passed) << law.law << ": measured " << results[0].measured << ", bound "
                                    << results[0].bound;
  }
}

TEST_F(Conformance, ATrajectoryThatReturnsNaNFailsItsLaw) {
  const std::pair<const char*, const char*> cases[] = {{"nan_advance", "advance_pullback_is_exact"},
                                                       {"nan_d_state", "advance_pullback_is_exact"},
                                                       {"nan_d_control", "advance_pullback_is_exact"},
                                                       {"nan_targets", "starts_at_the_grasp_points"},
                                                       {"nan_targets", "path_is_continuous"},
                                                       {"nan_targets", "never_below_contact_height"},
                                                       {"nan_targets", "targets_pullback_is_exact"},
                                                       {"nan_targets_pullback", "targets_pullback_is_exact"},
                                                       {"nan_progress", "default_controls_release"},
                                                       {"nan_decode", "decode_encode_round_trip"},
                                                       {"nan_decode", "decision_box_is_sound"},
                                                       {"nan_decode", "decode_pullback_is_exact"},
                                                       {"nan_encode", "decode_encode_round_trip"},
                                                       {"nan_encode", "decision_box_is_sound"},
                                                       {"nan_decode_pullback", "decode_pullback_is_exact"}};
  for (const auto& [mutation, law] : cases) {
    const auto r = check("trajectory", std::string("mutation: ") + mutation, {}, {law});
    EXPECT_FALSE(r.at(0).passed) << mutation << ", " << law << ": measured " << r.at(0).measured;
  }
}

/// Either side of the capability orthotropic: what is declared is measured, and what is not declared is refused, each kind
/// of difference between warp and weft.
TEST_F(Conformance, WarpAndWeftAreToldApartOrRefused) {
  const std::pair<const char*, const char*> cases[] = {
      {"orthotropic_in_words", "stiffness says 4"},
      {"stretches_by_direction", "a fabric whose stretch_n_per_m differs between warp and weft was accepted"},
      {"two_bends", "a fabric whose bend_n_m differs between warp and weft was accepted"},
      {"tables", "a fabric whose tables differs between warp and weft was accepted"}};
  for (const auto& [mutation, note] : cases) {
    const auto r = check("simulator", std::string("mutation: ") + mutation, {}, {"stretches_by_direction"});
    EXPECT_FALSE(r.at(0).passed) << mutation;
    EXPECT_THAT(r.at(0).detail, ::testing::HasSubstr(note)) << mutation;
  }
}

/// The results of each toy that can be spoilt, and how; see toy.hpp.
const std::map<std::string, std::vector<std::pair<std::string, std::vector<std::string>>>>& spoilable() {
  static const std::vector<std::string> any = {"nan", "empty", "long"}, number = {"nan"}, list = {"empty", "long"};
  static const std::map<std::string, std::vector<std::pair<std::string, std::vector<std::string>>>> map = {
      {"simulator",
       {{"positions", any}, {"velocities", any}, {"grasped", list}, {"max_speed", number}, {"strain", number}}},
      {"predictor",
       {{"mean", any},
        {"sigma", any},
        {"shapes", list},
        {"d_controls", any},
        {"d_state", any},
        {"d_shape", any},
        {"d_centre", number},
        {"d_width", number},
        {"gradients", {"empty"}},
        {"jvp_mean", any},
        {"jvp_sigma", any},
        {"control_range", any}}},
      {"trajectory",
       {{"initial_state", any},
        {"advance", any},
        {"d_state", any},
        {"d_control", any},
        {"targets", any},
        {"targets_pullback", any},
        {"progress", number},
        {"decode", any},
        {"decode_pullback", any},
        {"encode", any},
        {"lower", any},
        {"upper", any},
        {"decision_scale", any}}},
      {"optimiser", {{"point", any}, {"x", any}, {"cost", number}, {"results", list}}}};
  return map;
}

TEST_P(Kind, NoLawHoldsIfEveryResultIsSpoilt) {
  for (const std::string declare : {"true", "false"}) {
    for (const std::string how : {"nan", "empty", "long"}) {
      for (const auto& r : check(GetParam(), "declare: " + declare + ", spoil: " + how))
        EXPECT_FALSE(r.passed) << r.law << ", " << how << ", declare: " << declare << ": measured " << r.measured;
    }
  }
}

TEST_P(Kind, EverySpoiltResultFailsALaw) {
  for (const auto& [result, ways] : spoilable().at(GetParam())) {
    for (const auto& how : ways) {
      const auto laws = check(GetParam(), "spoil: " + how + ", result: " + result);
      const bool fails = std::any_of(laws.begin(), laws.end(), [](const LawResult& r) { return !r.passed; });
      EXPECT_TRUE(fails) << result << ", " << how;
    }
  }
}

TEST_P(Kind, LawsAreNamedAndExplained) {
  std::vector<std::string> names;
  for (const auto& law : list_laws(GetParam())) {
    EXPECT_FALSE(law.text.empty()) << law.law;
    EXPECT_TRUE(law.text.ends_with(".")) << law.law;
    EXPECT_GE(law.bound, 0.0);
    names.push_back(law.law);
  }
  std::sort(names.begin(), names.end());
  EXPECT_EQ(std::adjacent_find(names.begin(), names.end()), names.end());
}

/// docs/conformance.md has one table row per law: | `law` | text | bound |
TEST_P(Kind, TheDocumentListsEveryLaw) {
  std::ifstream file(WEFT_SOURCE_DIR "/docs/conformance.md");
  ASSERT_TRUE(file);
  std::string section, line;
  std::vector<std::string> rows, wanted;
  while (std::getline(file, line)) {
    if (line.starts_with("## ")) section = line.substr(3);
    if (section == GetParam() && line.starts_with("| `")) rows.push_back(line);
  }
  for (const auto& law : list_laws(GetParam())) {
    std::ostringstream row;
    row << "| `" << law.law << "` | " << law.text << " | " << law.bound << " |";
    wanted.push_back(row.str());
  }
  EXPECT_EQ(rows, wanted);
}

TEST_F(Conformance, WhatIsNotDeclaredMustBeRefused) {
  const auto broken = [&](const std::string& kind, const std::string& law) {
    const auto r = check(kind, "declare: false, accept: true", {}, {law});
    return !r.at(0).passed;
  };
  EXPECT_TRUE(broken("simulator", "pinned_stays_pinned"));
  EXPECT_TRUE(broken("simulator", "gravity_any_direction"));
  EXPECT_TRUE(broken("simulator", "restored_run_is_bit_exact"));
  EXPECT_TRUE(broken("predictor", "pullback_of_controls"));
  EXPECT_TRUE(broken("predictor", "pullback_of_centre"));
  EXPECT_TRUE(broken("predictor", "pullback_of_width"));
  EXPECT_TRUE(broken("predictor", "pullback_of_state"));
  EXPECT_TRUE(broken("predictor", "pullback_of_shape"));
  EXPECT_TRUE(broken("predictor", "jvp_matches"));
}

/// Results of wrong sizes and NaNs: laws fail, none of them crashes.
TEST_F(Conformance, PredictorsThatReturnTooLittleFail) {
  const std::pair<std::string, std::string> mutants[] = {
      {"null_prediction", "shapes_are_those_asked_for"},
      {"one_result", "shapes_are_those_asked_for"},
      {"missing_shapes", "shapes_are_those_asked_for"},
      {"a_vertex_short", "shapes_are_those_asked_for"},
      {"nan_mean", "numbers_are_sound"},
      {"nan_mean_of_means", "numbers_are_sound"},
      {"nan_sigma", "numbers_are_sound"},
      {"gradient_of_one_case", "pullback_of_controls"},
      {"no_d_controls", "pullback_of_controls"},
      {"one_d_control", "pullback_of_controls"},
      {"nan_d_controls", "pullback_of_controls"},
      {"nan_d_controls_of_means", "zero_cotangents_may_be_empty"},
      {"nan_d_centre", "pullback_of_centre"},
      {"nan_d_width", "pullback_of_width"},
      {"short_d_state", "pullback_of_state"},
      {"nan_d_state", "pullback_of_state"},
      {"short_d_shape", "pullback_of_shape"},
      {"nan_d_shape", "pullback_of_shape"},
      {"state_nobody_asked_for", "pullback_is_for_those_who_asked"},
      {"shape_nobody_asked_for", "pullback_is_for_those_who_asked"},
      {"jvp_of_one_case", "jvp_matches"},
      {"jvp_of_one_direction", "jvp_matches"},
      {"jvp_without_shapes", "jvp_matches"},
      {"short_jvp", "jvp_matches"},
      {"nan_jvp", "jvp_matches"},
  };
  for (const auto& [mutation, law] : mutants) {
    for (const auto& r : check("predictor", "mutation: " + mutation)) {
      if (r.law != law) continue;
      EXPECT_FALSE(r.passed) << mutation << ": " << law << " measured " << r.measured;
    }
  }
}

TEST_F(Conformance, UndeclaredAbilitiesAreSaidToBe) {
  const auto r = check("simulator", "declare: false", {}, {"pinned_stays_pinned"});
  EXPECT_EQ(r.at(0).detail, "not declared; throws Unsupported");
}

TEST_F(Conformance, AToleranceReplacesTheBound) {
  const auto loose = ConfigNode::parse("rest_stays_at_rest: {bound: 1, reason: it drifts}", "tolerances.yaml");
  const auto r = check("simulator", "mutation: rest_stays_at_rest", loose, {"rest_stays_at_rest"});
  EXPECT_EQ(r.at(0).bound, 1.0);
  EXPECT_TRUE(r.at(0).passed);
  const auto tight = ConfigNode::parse("falls_freely: {bound: 1e-9, reason: none}", "tolerances.yaml");
  EXPECT_FALSE(check("simulator", "", tight, {"falls_freely"}).at(0).passed);
}

TEST_F(Conformance, TolerancesCarryParameters) {
  const auto params = ConfigNode::parse("params: {mutation: falls_freely}", "tolerances.yaml");
  EXPECT_FALSE(check("simulator", "", params, {"falls_freely"}).at(0).passed);
  EXPECT_TRUE(check("simulator", "mutation: none", params, {"falls_freely"}).at(0).passed) << "the slot goes first";
}

TEST_F(Conformance, RefusesBadTolerances) {
  const auto with = [&](const std::string& text) {
    check("trajectory", "", ConfigNode::parse(text, "t.yaml"), {"refuses_bad_shapes"});
  };
  EXPECT_THROW(with("refuses_bad_shapes: {bound: 1}"), ConfigError);
  EXPECT_THROW(with("refuses_bad_shapes: {bound: 1, reason: ''}"), ConfigError);
  EXPECT_THROW(with("refuses_bad_shapes: {reason: why not}"), ConfigError);
  EXPECT_THROW(with("refuses_bad_shape: {bound: 1, reason: x}"), ConfigError);
  EXPECT_THROW(with("task: {trajectory: {plugin: arc}}"), ConfigError);
  EXPECT_THROW(with("params: {mutatoin: none}"), ConfigError);
  EXPECT_NO_THROW(with("{}"));
}

TEST_F(Conformance, RefusesUnknownLawsAndKinds) {
  EXPECT_THROW(check("trajectory", "", {}, {"no_such_law"}), ConfigError);
  EXPECT_THROW(list_laws("robot"), ConfigError);
}

TEST_F(Conformance, PredictorsAreBoundToTheTaskGiven) {
  const auto task =
      ConfigNode::parse("task: {trajectory: {plugin: toy_trajectory}, simulator: {plugin: toy_simulator}}", "t.yaml");
  for (const auto& r : check("predictor", "", task))
    EXPECT_TRUE(r.passed) << r.law << ": " << r.measured << "  " << r.detail;
  EXPECT_THROW(check("predictor", "", ConfigNode::parse("task: {trajctory: {plugin: arc}}", "t.yaml")), ConfigError);
}

TEST_F(Conformance, ATaskWithAGarmentIsReadLikeATaskFile) {
  const std::string configs = WEFT_SOURCE_DIR "/configs";
  const auto task = [&](const std::string& grasp) {
    return ConfigNode::parse("task: {garment: " + configs + "/garments/towel_coarse.yaml, material: " + configs +
                                 "/fabrics/basic.yaml, trajectory: {plugin: toy_trajectory}, simulator: {plugin: "
                                 "toy_simulator}, manipulation: {grasp: [" +
                                 grasp + "], displacement_m: [0.3, 0.0]}}",
                             "t.yaml");
  };
  for (const auto& r : check("predictor", "", task("left_bottom, left_top")))
    EXPECT_TRUE(r.passed) << r.law << ": " << r.measured << "  " << r.detail;
  EXPECT_THROW(check("predictor", "", task("left_bottom, left_tip")), ConfigError);
}

}  // namespace
}  // namespace weft
