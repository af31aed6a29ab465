// weft reproduce as people use it: the smallest part of --quick, killed and gone on with, and its pages.
#include <chrono>
#include <map>
#include <nlohmann/json.hpp>
#include <thread>

#include "report/paper_tables.hpp"
#include "unit/test_program.hpp"
#include "unit/test_support.hpp"

namespace weft {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;
using test::Folder;
using test::Outcome;
using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;
using ::testing::StartsWith;

constexpr const char* kPart = "optimisers-simulator";

Outcome weft_command(const std::string& arguments) {
  return test::run_shell("cd '" WEFT_SOURCE_DIR "' && unset WEFT_PLUGIN_PATH; '" WEFT_PROGRAM "' " + arguments);
}
std::string text_of(const fs::path& file) {
  std::ifstream stream(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), {}};
}
std::string quoted(const fs::path& path) { return "'" + path.string() + "'"; }

/// Begins the part, and sends it a signal when so many cells are there. @return what it printed and how it ended.
Outcome stopped(const fs::path& out, const char* signal, int cells) {
  return test::run_shell("cd '" WEFT_SOURCE_DIR "'; unset WEFT_PLUGIN_PATH; '" WEFT_PROGRAM "' reproduce " +
                         std::string(kPart) + " --quick --jobs 1 --out " + quoted(out) +
                         " & pid=$!; for i in $(seq 30000); do [ $(ls " + quoted(out / kPart / "held_out/cells") +
                         "/*[0-9a-f].json 2>/dev/null | grep -vc times) -ge " + std::to_string(cells) +
                         " ] && break; sleep 0.01; done; kill -" + signal + " $pid; wait $pid");
}
/// Whether a weft runs that has this folder on its command line.
bool is_at_work(const fs::path& out) {
  for (const auto& entry : fs::directory_iterator("/proc")) {
    const std::string words = text_of(entry.path() / "cmdline");
    if (words.substr(0, words.find('\0')).ends_with("/weft") && words.find(out.string()) != std::string::npos)
      return true;
  }
  return false;
}
std::map<std::string, std::string> cells_of(const fs::path& out) {
  std::map<std::string, std::string> cells;
  for (const auto& entry : fs::directory_iterator(out / kPart / "held_out/cells")) {
    const std::string name = entry.path().filename().string();
    if (name.ends_with(".json") && !name.ends_with(".times.json")) cells[name] = text_of(entry.path());
  }
  return cells;
}

TEST(Reproduce, TheSmallestPartOfQuickGoesOnAfterBeingStoppedAndKilled) {
  const Folder folder;
  const fs::path out = folder / "out";
  const Outcome told = stopped(out, "TERM", 1);
  EXPECT_EQ(told.code, 1);
  EXPECT_THAT(told.output, HasSubstr("interrupted; run the same command again to finish it"));
  EXPECT_FALSE(fs::exists(out / (std::string(kPart) + ".json")));
  stopped(out, "KILL", 3);
  // What a killed weft had begun ends too.
  for (int i = 0; i < 3000 && is_at_work(out); ++i) std::this_thread::sleep_for(std::chrono::milliseconds(20));
  EXPECT_FALSE(is_at_work(out));
  const auto kept = cells_of(out);
  ASSERT_GE(kept.size(), 1u);
  const std::string command = std::string("reproduce ") + kPart + " --quick --jobs 1 --out " + quoted(out);
  const Outcome whole = weft_command(command);
  ASSERT_EQ(whole.code, 0) << whole.output;
  const auto all = cells_of(out);
  for (const auto& [name, text] : kept) EXPECT_EQ(all.at(name), text) << name << " was made again";

  const fs::path file = out / (std::string(kPart) + ".json");
  const json measured = json::parse(text_of(file));
  EXPECT_EQ(measured["schema"], "weft measurement 1");
  EXPECT_EQ(measured["name"], kPart);
  EXPECT_EQ(measured["size"], "quick");
  EXPECT_THAT(measured["commit"].get<std::string>(), Not(IsEmpty()));
  EXPECT_THAT(measured["machine"]["processor"].get<std::string>(), Not(IsEmpty()));
  EXPECT_GE(measured["machine"]["cores"], 1);
  EXPECT_EQ(measured["models"], json::array());  // the simulator plans for itself
  EXPECT_EQ(measured["steps"][0]["seeds"], (json{{"first", 81951}, {"count", 1}}));
  EXPECT_THAT(measured.dump(), Not(HasSubstr(folder.path().string())));
  ASSERT_EQ(measured["tables"].size(), 1u);
  EXPECT_EQ(measured["tables"][0]["rows"].size(), 10u);
  EXPECT_EQ(measured["tables"][0]["columns"][4]["unit"], "mm");
  const std::string page = text_of(out / (std::string(kPart) + ".md"));
  EXPECT_THAT(page,
              AllOf(HasSubstr("Size `quick`, commit "), HasSubstr(", seed 81951, "), HasSubstr("| rprop | 1 | 0 | ")));
  EXPECT_THAT(text_of(out / "index.md"),
              AllOf(HasSubstr("](optimisers-simulator.md) | quick | "), HasSubstr("Not measured yet: fig1")));
  EXPECT_GT(json::parse(text_of(out / "times.json"))["seconds"]["optimisers-simulator/held_out"], 0.0);

  // The same command again measures nothing and changes nothing.
  const Outcome again = weft_command(command + " --json");
  ASSERT_EQ(again.code, 0) << again.output;
  EXPECT_EQ(cells_of(out), all);
  EXPECT_EQ(json::parse(text_of(file)), measured);
  EXPECT_EQ(json::parse(again.output)[0], measured);

  // A picture of these results stays while they do, and goes with them.
  const fs::path results = out / kPart / "held_out",
                 picture = results / "figures/ablation-first_plan_predicted_error_mm.svg";
  fs::create_directories(picture.parent_path());
  std::ofstream(picture) << "<svg/>";
  ASSERT_EQ(weft_command(command).code, 0);
  EXPECT_EQ(json::parse(text_of(file))["figures"].size(), 1u);
  std::ofstream(results / "ablation.json") << "{}";
  ASSERT_EQ(weft_command(command).code, 0);
  EXPECT_FALSE(fs::exists(picture));
  EXPECT_EQ(json::parse(text_of(file))["figures"].size(), 0u);

  // The printed command alone gives the same rows.
  std::string printed = weft_command(std::string("reproduce ") + kPart + " --quick --dry-run").output;
  EXPECT_THAT(printed, StartsWith("# about "));
  printed.erase(0, printed.find('\n') + 1);
  const std::string standard = "results/reproduce-quick/optimisers-simulator/held_out";
  EXPECT_EQ(measured["steps"][0]["commands"][0].get<std::string>() + "\n", printed);
  ASSERT_THAT(printed,
              AllOf(HasSubstr("weft ablate configs/experiments/optimisers_coarse.yaml "), HasSubstr(standard)));
  printed.replace(printed.find(standard), standard.size(), quoted(folder / "alone"));
  const Outcome alone = weft_command(printed.substr(5, printed.size() - 6) + " --quiet --jobs 1");
  ASSERT_EQ(alone.code, 0) << alone.output;
  bool is_found = false;
  for (const auto& table : paper_tables(folder / "alone")) {
    if (table.label != "ablation-first_plan_predicted_error_mm") continue;
    is_found = true;
    EXPECT_EQ(json(table.rows), measured["tables"][0]["rows"]);
  }
  EXPECT_TRUE(is_found);
}

/// A file with one part, which takes a second.
struct Small {
  Folder folder;
  std::string command;
  explicit Small(const std::string& step, const std::string& physics = "tests: [free fall]") {
    folder.write("physics.yaml",
                 "extends: " WEFT_SOURCE_DIR "/configs/experiments/physics.yaml\nphysics: {" + physics + "}\n");
    const auto file = folder.write("reproduce.yaml",
                                   "parts:\n  small:\n    title: Free fall\n    steps:\n      cloth: {" + step + "}\n");
    command = "reproduce --jobs 1 --config " + quoted(file) + " --out " + quoted(folder / "out") + " ";
  }
};

TEST(Reproduce, WrongCallsAreRefusedBeforeAnyWork) {
  const Small small("command: evaluate physics, config: physics.yaml, quick: {}");
  const std::pair<std::string, const char*> wrong[] = {
      {small.command + "smal", "'smal' is no part, must be one of small; nearest: small"},
      {small.command + "--full", "--full has no part"},
      {small.command + "small --full", "part small is left out by --full; it is in --quick"},
      {small.command + "--quick --full", "--quick excludes --full"},
      {small.command + "--figures png", "png not in {svg,pdf}"},
      {small.command + "--pages /nowhere", "--pages /nowhere: there is no such folder"},
      {"reproduce fig3 --check", "name no part"}};
  for (const auto& [arguments, what] : wrong) {
    const Outcome refused = weft_command(arguments);
    EXPECT_EQ(refused.code, 2) << arguments;
    EXPECT_THAT(refused.output, HasSubstr(what));
  }
  EXPECT_FALSE(fs::exists(small.folder / "out/small"));
}

TEST(Reproduce, ACommandThatRefusesItsFolderIsNamedAndNothingIsMeasured) {
  const Small small("command: evaluate physics, config: physics.yaml, quick: {}");
  ASSERT_EQ(weft_command(small.command).code, 0);
  const std::string earlier = text_of(small.folder / "out/small.json");
  EXPECT_THAT(earlier, HasSubstr("cloth/physics"));
  small.folder.write("physics.yaml",
                     "extends: " WEFT_SOURCE_DIR
                     "/configs/experiments/physics.yaml\nphysics: {tests: [free fall], fine_edge_m: 0.006}\n");
  const Outcome refused = weft_command(small.command);
  EXPECT_EQ(refused.code, 2);
  EXPECT_THAT(refused.output,
              AllOf(HasSubstr("physics.fine_edge_m 0.005 -> 0.006"), HasSubstr("error: not done: small/cloth")));
  EXPECT_EQ(text_of(small.folder / "out/small.json"), earlier);
  EXPECT_EQ(weft_command(small.command + "--accept-changed").code, 0);
}

TEST(Reproduce, ComparisonsOutsideOfTheirBoundsAreMeasuredToo) {
  const Small small(
      "command: evaluate physics, config: physics.yaml, quick: {set: {simulator: {plugin: bullet}, finer: {plugin: bullet}}}",
      "tests: [hanging], fine_edge_m: 0.02, garment_edge_m: 0.05");
  const Outcome outcome = weft_command(small.command);
  EXPECT_EQ(outcome.code, 0) << outcome.output;
  EXPECT_TRUE(fs::exists(small.folder / "out/small.json"));
}

TEST(Reproduce, PagesAreMadeAndChecked) {
  const Small small("command: evaluate physics, config: physics.yaml, quick: {}");
  ASSERT_EQ(weft_command(small.command).code, 0);
  const fs::path docs = small.folder / "repository/docs";
  fs::create_directories(docs / "measurements");
  fs::copy(small.folder / "out/small.json", docs / "measurements/small.json");
  std::ofstream(docs / "results.md") << "<!-- measured small cloth/physics -->\n<!-- end -->\n";
  const std::string pages = "reproduce --pages " + quoted(docs / "measurements");
  Outcome checked = weft_command(pages + " --check");
  EXPECT_EQ(checked.code, 1);
  EXPECT_THAT(checked.output, AllOf(HasSubstr("small.md: differs"), HasSubstr("results.md: differs")));
  EXPECT_FALSE(fs::exists(docs / "measurements/small.md"));
  ASSERT_EQ(weft_command(pages).code, 0);
  EXPECT_EQ(text_of(docs / "measurements/small.md"), text_of(small.folder / "out/small.md"));
  EXPECT_THAT(text_of(docs / "results.md"), HasSubstr("| free fall |"));
  checked = weft_command(pages + " --check");
  EXPECT_EQ(checked.code, 0) << checked.output;

  // A measurement of a model that does not ship.
  json measured = json::parse(text_of(docs / "measurements/small.json"));
  measured["models"] = {{{"file", "old.h5"}, {"sha256", std::string(64, 'a')}}};
  std::ofstream(docs / "measurements/small.json") << measured.dump();
  ASSERT_EQ(weft_command(pages).code, 0);
  checked = weft_command(pages + " --check");
  EXPECT_EQ(checked.code, 1);
  EXPECT_THAT(checked.output, AllOf(HasSubstr("small.json: was measured with old.h5 (sha256 aaaaaaaaaaaa)"),
                                    Not(HasSubstr("everything is as"))));

  // A damaged measurement is named, also without a page.
  const std::string whole = measured.dump();
  std::ofstream(docs / "measurements/other.json") << whole.substr(0, whole.size() / 2);
  checked = weft_command(pages + " --check");
  EXPECT_EQ(checked.code, 2);
  EXPECT_THAT(checked.output, HasSubstr("other.json: is damaged"));
  fs::remove(docs / "measurements/other.json");
  measured["schema"] = "weft measurement 9";
  std::ofstream(docs / "measurements/small.json") << measured.dump();
  checked = weft_command(pages + " --check");
  EXPECT_EQ(checked.code, 2);
  EXPECT_THAT(checked.output, HasSubstr("must be \"weft measurement 1\""));
}

}  // namespace
}  // namespace weft
