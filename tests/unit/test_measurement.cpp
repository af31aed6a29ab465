// Measurements, what documents show of them, and the file that says what is measured.
#include "report/measurement.hpp"

#include "experiments/ablation.hpp"
#include "experiments/reproduction.hpp"
#include "identity/sha256.hpp"
#include "test_support.hpp"
#include "weft/config.hpp"

namespace weft::test {
namespace {

namespace fs = std::filesystem;
using nlohmann::ordered_json;
using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;
using ::testing::SizeIs;

ordered_json measurement(const std::string& model_hash) {
  PaperTable table{
      "held_out/planning",
      "Error in mm",
      {{"arm", "arm", "", 0}, {"n", "n", "", 0}, {"median", "median", "mm", 2}, {"median_95", "95 %", "mm", 1}},
      {{"w = 0.1", 50, 2.345678901234, {1.04, 3.26}}, {"a, b", 49, nullptr, nullptr}},
      1};
  return {{"schema", kMeasurementSchema},
          {"name", "fig3"},
          {"title", "Fig. 3: errors"},
          {"about", "What is measured."},
          {"size", "standard"},
          {"command", "weft reproduce fig3 --standard"},
          {"weft", "0.1.0"},
          {"commit", "0123456789ab"},
          {"date", "2026-11-30"},
          {"models", {{{"file", "tshirt.h5"}, {"sha256", model_hash}}}},
          {"machine", {{"processor", "A processor"}, {"cores", 2}}},
          {"steps",
           {{{"name", "held_out"},
             {"title", "Held-out goals"},
             {"commands", {"weft evaluate planning tshirt.yaml"}},
             {"seeds", {{"first", 71001}, {"count", 50}}},
             {"failed", 1},
             {"identities", {"00"}}}}},
          {"figures", ordered_json::array()},
          {"tables", {json_of_table(table)}}};
}

constexpr const char* kTable =
    "| arm | n | median, mm | 95 %, mm |\n|---|---:|---:|---:|\n| w = 0.1 | 50 | 2.35 | [1.0, 3.3] |\n| a, b | 49 |  |  |\n";

TEST(Measurement, ThePageIsMadeOfTheJsonAlone) {
  const auto json = measurement("abcdef0123456789");
  EXPECT_EQ(
      measurement_page(ordered_json::parse(json.dump())),
      "# Fig. 3: errors\n\nWhat is measured.\n\n"
      "Size `standard`, commit 0123456789ab, model `tshirt.h5` (sha256 abcdef012345), A processor, 2 cores, seeds 71001 "
      "to 71050, 2026-11-30. 1 case failed.\n\n```sh\nweft reproduce fig3 --standard\n```\n\n"
      "## Held-out goals\n\n```sh\nweft evaluate planning tshirt.yaml\n```\n\nError in mm.\n\n" +
          std::string(kTable) +
          "\n<!-- Made of fig3.json by `weft reproduce --pages`: change that, not this page. -->\n");
}

TEST(Measurement, StillsOfASessionStandBesideEachOther) {
  ordered_json json = measurement("");
  const auto still = [](const char* session, const char* title) -> ordered_json {
    return {
        {"step", "held_out"}, {"title", title}, {"file", std::string(session) + title + ".png"}, {"session", session}};
  };
  json["figures"] = {{{"step", "held_out"}, {"title", "planning"}, {"file", "planning.svg"}},
                     {{"step", "paper"}, {"title", "other"}, {"file", "other.svg"}},
                     still("s1", "f0"),
                     still("s1", "f9"),
                     still("s2", "f0")};
  EXPECT_THAT(measurement_page(json), HasSubstr("\n\n![planning](planning.svg)\n\n"
                                                "| session |  |  |\n|---|---|---|\n"
                                                "| s1 | ![f0](s1f0.png) | ![f9](s1f9.png) |\n"
                                                "| s2 | ![f0](s2f0.png) |\n\n<!-- Made of "));
}

TEST(Measurement, AQuickPageSaysWhatItIsFor) {
  ordered_json json = measurement("");
  EXPECT_THAT(measurement_page(json), Not(HasSubstr("too few cases")));
  json["size"] = "quick";
  EXPECT_THAT(measurement_page(json), HasSubstr("too few cases"));
}

TEST(Measurement, MarksInDocumentsBecomeTablesAndNumbers) {
  const Measurements all{{"fig3", measurement("ab")}};
  const auto with = [&](const std::string& text) { return with_measured(text, all, "page.md"); };
  EXPECT_EQ(
      with("Before.\n\n<!-- measured fig3 held_out/planning -->old<!-- end -->\nAfter.\n"),
      "Before.\n\n<!-- measured fig3 held_out/planning -->\n\n" + std::string(kTable) + "\n<!-- end -->\nAfter.\n");
  const std::string numbers =
      "It is <!-- measured fig3 held_out/planning; w = 0.1; median -->9<!-- end --> mm of "
      "<!-- measured fig3 held_out/planning; a, b; n --><!-- end -->.\n";
  const std::string made =
      "It is <!-- measured fig3 held_out/planning; w = 0.1; median -->2.35<!-- end --> mm of "
      "<!-- measured fig3 held_out/planning; a, b; n -->49<!-- end -->.\n";
  EXPECT_EQ(with(numbers), made);
  EXPECT_EQ(with(made), made);
  // Code shows how a mark is written.
  const std::string code = "`<!-- measured NAME TABLE -->`\n```\n<!-- measured NAME TABLE -->\n```\n";
  EXPECT_EQ(with(code), code);
}

TEST(Measurement, AMarkThatNamesNothingIsRefused) {
  const Measurements all{{"fig3", measurement("ab")}};
  const std::pair<const char*, const char*> wrong[] = {
      {"<!-- measured fig4 held_out/planning --><!-- end -->",
       "page.md:2: <!-- measured fig4 held_out/planning -->: there is no measurement 'fig4'"},
      {"<!-- measured fig3 held_out/plan --><!-- end -->",
       "there is no table 'held_out/plan', must be one of held_out/planning"},
      {"<!-- measured fig3 held_out/planning; w = 0.2; n --><!-- end -->", "there is no row 'w = 0.2'"},
      {"<!-- measured fig3 held_out/planning; w = 0.1; mean --><!-- end -->", "there is no column 'mean'"},
      {"<!-- measured fig3 held_out/planning; w = 0.1 --><!-- end -->",
       "must be NAME TABLE, or NAME TABLE; ROW; COLUMN"},
      {"<!-- measured fig3 held_out/planning -->", "has no <!-- end -->"},
      {"<!-- measured fig3 held_out/planning\n", "does not end"}};
  for (const auto& [text, what] : wrong)
    EXPECT_THAT(
        message_of<ConfigError>([&, mark = std::string(text)] { with_measured("One.\n" + mark, all, "page.md"); }),
        HasSubstr(what));
}

/// A repository with one measurement, of which README.md and docs/results.md show numbers.
struct Documents {
  Folder folder;
  fs::path measurements;
  Documents() : measurements(folder / "docs/measurements") {
    const auto model = folder.write("configs/models/tshirt.h5", "a model");
    folder.write("docs/measurements/fig3.json", measurement(sha256_of_file(model)).dump());
    folder.write("docs/measurements/notes.json", "[1]");
    folder.write("docs/measurements/by_hand.md", "# By hand\n");
    folder.write("docs/results.md", "<!-- measured fig3 held_out/planning --><!-- end -->\n");
    folder.write("README.md", "<!-- measured fig3 held_out/planning; w = 0.1; n -->3<!-- end -->\n");
    for (const auto& page : stale_pages(measurements)) std::ofstream(page.file) << page.text;
  }
  std::vector<std::string> stale() const {
    std::vector<std::string> names;
    for (const auto& page : stale_pages(measurements)) names.push_back(page.file.filename().string());
    return names;
  }
  void replace(const fs::path& name, const std::string& what, const std::string& by) const {
    std::ifstream stream(folder / name);
    std::string text{std::istreambuf_iterator<char>(stream), {}};
    ASSERT_NE(text.find(what), std::string::npos);
    folder.write(name, text.replace(text.find(what), what.size(), by));
  }
};

TEST(Measurement, WhatDiffersFromTheJsonIsNamed) {
  const Documents documents;
  EXPECT_THAT(documents.stale(), IsEmpty());
  documents.replace("docs/measurements/fig3.md", "2.35", "2.25");
  EXPECT_THAT(documents.stale(), ElementsAre("fig3.md"));
  documents.replace("docs/results.md", "[1.0, 3.3]", "[1.0, 3.2]");
  EXPECT_THAT(documents.stale(), ElementsAre("fig3.md", "results.md"));
  documents.replace("README.md", "50", "500");
  EXPECT_THAT(documents.stale(), ElementsAre("fig3.md", "results.md", "README.md"));
  fs::remove(documents.measurements / "fig3.md");
  EXPECT_THAT(documents.stale(), SizeIs(3));
}

TEST(Measurement, AnotherNumberInTheJsonMakesEveryPlaceStale) {
  const Documents documents;
  documents.replace("docs/measurements/fig3.json", "2.345678901234", "7.5");
  EXPECT_THAT(documents.stale(), ElementsAre("fig3.md", "results.md"));
}

TEST(Measurement, PagesAndMeasurementsBelongTogether) {
  const Documents documents;
  documents.folder.write("docs/measurements/other.json", measurement("ab").dump());
  EXPECT_THAT(message_of<ConfigError>([&] { documents.stale(); }),
              HasSubstr("other.json: is the measurement \"fig3\", and must have its name"));
  fs::remove(documents.measurements / "other.json");
  fs::remove(documents.measurements / "fig3.json");
  EXPECT_THAT(message_of<ConfigError>([&] { documents.stale(); }),
              HasSubstr("fig3.md: was made of fig3.json, which is not there"));
  documents.folder.write("docs/measurements/fig3.json", measurement("ab").dump());
  documents.folder.write("docs/measurements/fig3.md", "# By hand\n");
  EXPECT_THAT(message_of<ConfigError>([&] { documents.stale(); }), HasSubstr("fig3.md: was written by hand"));
}

TEST(Measurement, AModelThatDoesNotShipIsNamed) {
  const Documents documents;
  const fs::path models = documents.folder / "configs/models";
  EXPECT_THAT(other_models(documents.measurements, models), IsEmpty());
  documents.folder.write("configs/models/tshirt.h5", "another model");
  EXPECT_THAT(other_models(documents.measurements, models),
              ElementsAre(AllOf(HasSubstr("fig3.json: was measured with tshirt.h5 (sha256 "),
                                HasSubstr("which is no model of "))));
}

Reproduction read(const std::string& parts, const std::string& size = "quick") {
  return read_reproduction(ConfigNode::parse("parts:\n" + parts, "test.yaml"), size);
}

TEST(Reproduction, WrongFilesAreRefused) {
  const std::pair<const char*, const char*> wrong[] = {
      {"  a: {steps: {s: {config: x.yaml, quick: {}, sed: 3}}}", "test.yaml:2: parts.a.steps.s.sed is not a known key"},
      {"  a: {steps: {s: {config: x.yaml, quick: {case: 3}}}}", "parts.a.steps.s.quick.case is not a known key"},
      {"  a: {steps: {s: {config: x.yaml, command: evaluate, quick: {}}}}",
       "parts.a.steps.s.command = evaluate, must be one of"},
      {"  a: {steps: {s: {config: x.yaml}}}", "must have one of the sizes"},
      {"  a: {steps: {s: {quick: {}}}}", "must have either config or results"},
      {"  a: {steps: {s: {results: b/s, quick: {}}}}", "parts.a.steps.s.results = b/s, which is no step of size quick"},
      {"  ../a: {steps: {s: {config: x.yaml, quick: {}}}}", "must be of letters, digits, - and _"},
      {"  a: {steps: {s: {config: x.yaml, quick: {}}, t: {results: a/s, quick: {}}, u: {results: a/t, quick: {}}}}",
       "parts.a.steps.u.results = a/t, which has no results of its own"},
      {"  a: {steps: {s: {config: x.yaml, quick: {}}, t: {config: x.yaml, examples: a/s, quick: {}}}}",
       "parts.a.steps.t.examples = a/s, which is no step that makes examples"},
      {"  a: {}", "must have steps"}};
  for (const auto& [parts, what] : wrong)
    EXPECT_THAT(message_of<ConfigError>([&, given = std::string(parts)] { read(given); }), HasSubstr(what)) << parts;
}

constexpr const char* kParts = R"(
  data: {steps: {train: {command: generate, config: e.yaml, seed: 1, quick: {cases: 8}}}}
  planning:
    steps:
      held_out: {command: evaluate planning, config: e.yaml, seed: 5, quick: {cases: 3, options: [--widths, "1"]}}
      paper: {command: evaluate planning, config: e.yaml, seed: 5, examples: data/train, options: [--goals, train], quick: {cases: 2}}
  sweep: {steps: {one: {config: a.yaml, seed: 7, set: {planning.noise: 0.5, goal: {obj: a b}}, full: {cases: 9}, quick: {cases: 2}}}}
  again: {steps: {other: {results: sweep/one, quick: {}}}}
  physics: {steps: {cloth: {command: evaluate physics, config: p.yaml, seed: 3, quick: {cases: 4}}}}
  runs: {steps: {some: {command: run, config: t.yaml, seed: 3, stills: ["0", last], still_size: 80x50, quick: {cases: 2}}}}
  late: {steps: {one: {config: a.yaml, full: {}}}}
)";

TEST(Reproduction, StepsBecomeCommandsAfterThoseThatTheyNeed) {
  const Reproduction all = read(kParts);
  std::vector<std::string> lines;
  for (const auto* step : steps_of(all, chosen_parts(all, {"planning", "again", "physics", "runs"})))
    for (const auto& command : commands_of(*step, "out")) lines.push_back(typed(command.words));
  EXPECT_THAT(
      lines,
      ElementsAre(
          "weft evaluate planning e.yaml --widths 1 --seed 5 --cases 3 --out out/planning/held_out",
          "weft generate e.yaml --seed 1 --examples 8 --out out/data/train",
          "weft evaluate planning e.yaml --goals train --seed 5 --cases 2 --data out/data/train --out out/planning/paper",
          "weft ablate a.yaml --seed 7 --set seeds.count=2 --set planning.noise=0.5 --set 'goal={\"obj\":\"a b\"}' --out out/sweep/one",
          "weft evaluate physics p.yaml --set physics.folds.first_seed=3 --set physics.folds.count=4 --out out/physics/cloth",
          "weft run t.yaml --seed 3 --out out/runs/some/seed-3",
          "weft export out/runs/some/seed-3 --png 0,last --size 80x50 --out out/runs/some/seed-3/stills",
          "weft run t.yaml --seed 4 --out out/runs/some/seed-4",
          "weft export out/runs/some/seed-4 --png 0,last --size 80x50 --out out/runs/some/seed-4/stills"));
}

TEST(Reproduction, PartsAreChosenByNameAndSize) {
  const Reproduction all = read(kParts);
  EXPECT_THAT(chosen_parts(all, {}), SizeIs(6));
  EXPECT_THAT(
      message_of<ConfigError>([&] { chosen_parts(all, {"planing"}); }),
      AllOf(HasSubstr("'planing' is no part, must be one of data, planning, "), HasSubstr("; nearest: planning")));
  EXPECT_EQ(message_of<ConfigError>([&] { chosen_parts(all, {"late"}); }),
            "part late is left out by --quick; it is in --full");
}

TEST(Reproduction, TheExpectedTimeIsThatOfTheStepsOnSomeProcessors) {
  const Reproduction all = read(
      "  a: {steps: {s: {config: x.yaml, quick: {cpu_minutes: 100}}, t: {results: a/s, quick: {}}}}\n"
      "  b: {steps: {s: {config: x.yaml, quick: {cpu_minutes: 20.5}}}}\n"
      "  c: {steps: {s: {config: x.yaml, quick: {}}}}");
  const auto time = [&](const std::vector<std::string>& parts, int processors) {
    return expected_time(steps_of(all, chosen_parts(all, parts)), processors);
  };
  EXPECT_EQ(time({}, 1), "about 2.0 hours of CPU time, 2.0 hours on 1 processor, without c/s, whose time is unknown");
  EXPECT_EQ(time({"b"}, 2), "about 21 minutes of CPU time, 11 minutes on 2 processors");
  EXPECT_EQ(time({"b"}, 30), "about 21 minutes of CPU time, 1 minute on 30 processors");
  EXPECT_EQ(time({"c"}, 2), "");
}

/// The ablation of a step as its command reads it, with every --set.
void read_ablation_of(const ReproductionStep& step) {
  ConfigNode config = ConfigNode::load(step.params.config);
  const auto words = commands_of(step, "out").front().words;
  for (std::size_t i = 0; i + 1 < words.size(); ++i)
    if (words[i] == "--set") config = apply_override(config, words[i + 1]);
  read_ablation(config);
}

TEST(Reproduction, EverySizeOfTheShippedFileCanBeRead) {
  const ConfigNode config = ConfigNode::load(WEFT_SOURCE_DIR "/configs/reproduce.yaml");
  std::size_t quick = 0;
  for (const char* size : kReproductionSizes) {
    const Reproduction all = read_reproduction(config, size);
    const auto parts = chosen_parts(all, {});
    if (std::string(size) == "quick") quick = parts.size();
    EXPECT_GE(parts.size(), 8u);
    if (std::string(size) == "full") {
      EXPECT_GE(parts.size(), quick);
    }
    for (const auto* step : steps_of(all, parts)) {
      if (!step->params.results.empty()) continue;
      EXPECT_TRUE(fs::exists(step->params.config)) << step->label();
      if (step->params.command == "ablate") {
        EXPECT_NO_THROW(read_ablation_of(*step)) << step->label();
      }
    }
  }
}

}  // namespace
}  // namespace weft::test
