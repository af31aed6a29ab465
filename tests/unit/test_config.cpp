#include <sys/stat.h>
#include <unistd.h>

#include <cmath>
#include <limits>

#include "unit/test_support.hpp"
#include "weft/config.hpp"

namespace weft {
namespace {

using test::Folder;
using test::message_of;
using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::StartsWith;

constexpr const char* kFold =
    "garment: shirt.yaml\n"  // line 1
    "simulator:\n"
    "  plugin: cloth\n"
    "  params:\n"
    "    substeps: 4\n"  // 5
    "    solver: {kind: newton, tolerance: 1e-6}\n"
    "pins: [0, 20, 7]\n";

ConfigNode parse(const std::string& text) { return ConfigNode::parse(text, "fold.yaml"); }
template <class Body>
std::string refusal(Body&& body) {
  return message_of<ConfigError>(std::forward<Body>(body));
}
std::string parse_refusal(const std::string& text) {
  return refusal([&] { parse(text); });
}

TEST(Config, ReadsScalarsListsAndMappings) {
  const ConfigNode fold = parse(kFold);
  EXPECT_THAT(fold.keys(), ElementsAre("garment", "simulator", "pins"));
  EXPECT_EQ(fold.at("garment").as_string(), "shirt.yaml");
  EXPECT_EQ(fold.at("simulator").at("params").at("substeps").as_int(), 4);
  EXPECT_EQ(fold.at("simulator").at("params").at("solver").at("tolerance").as_double(), 1e-6);
  EXPECT_EQ(fold.at("pins").size(), 3u);
  EXPECT_EQ(fold.at("pins")[2].as_int(), 7);
  EXPECT_FALSE(fold.has("pin"));
  EXPECT_FALSE(fold.find("pin"));
  EXPECT_TRUE(parse("").is_null());
  EXPECT_TRUE(parse("# only a comment\n").is_null());
  EXPECT_TRUE(parse("a:\nb: ~\n").at("a").is_null());
  EXPECT_TRUE(parse("a:\nb: ~\n").at("b").is_null());
}

TEST(Config, KnowsFileLineAndPath) {
  const ConfigNode node = parse(kFold).at("simulator").at("params").at("substeps");
  EXPECT_EQ(node.where(), "fold.yaml:5");
  EXPECT_EQ(node.path(), "simulator.params.substeps");
  EXPECT_EQ(parse(kFold).at("pins")[1].path(), "pins.1");
  // A mapping is where its key is, not where its first entry is.
  EXPECT_EQ(parse(kFold).at("simulator").where(), "fold.yaml:2");
  EXPECT_EQ(ConfigNode::integer(1).where(), "built-in");
}

TEST(Config, WrongTypeSaysWhereWhatGotWanted) {
  const ConfigNode fold = parse(kFold);
  const auto substeps = parse(kFold).at("simulator").at("params").at("substeps");
  EXPECT_EQ(refusal([&] { fold.at("garment").as_double(); }), "fold.yaml:1: garment = shirt.yaml, must be a number");
  EXPECT_EQ(refusal([&] { fold.at("garment").as_int(); }), "fold.yaml:1: garment = shirt.yaml, must be a whole number");
  EXPECT_EQ(refusal([&] { substeps.as_bool(); }), "fold.yaml:5: simulator.params.substeps = 4, must be true or false");
  EXPECT_EQ(refusal([&] { fold.at("pins").as_string(); }), "fold.yaml:7: pins = [0, 20, 7], must be a text");
  EXPECT_EQ(refusal([&] { fold.at("simulator").as_double(); }), "fold.yaml:2: simulator = a mapping, must be a number");
  EXPECT_EQ(refusal([&] { substeps.find("a"); }), "fold.yaml:5: simulator.params.substeps = 4, must be a mapping");
  EXPECT_EQ(refusal([&] { substeps[0]; }), "fold.yaml:5: simulator.params.substeps = 4, must be a list");
  EXPECT_EQ(refusal([&] { parse("a:\n").at("a").as_double(); }), "fold.yaml:1: a = nothing, must be a number");
  EXPECT_THAT(refusal([&] { fold.at("pins")[3]; }), StartsWith("fold.yaml:7: pins has 3 items"));
  EXPECT_EQ(refusal([&] { parse("a: '5'").at("a").as_int(); }),
            "fold.yaml:1: a = \"5\" (a text), must be a whole number");
  EXPECT_EQ(refusal([&] { parse("42").at("a"); }), "fold.yaml:1: holds 42, must be a mapping");
}

TEST(Config, PlaceIsTheNodeOrWhereItWouldStand) {
  const ConfigNode fold = apply_override(parse(kFold), "pins=[4]");
  EXPECT_EQ(place(fold, "pins.0").where(), "--set");
  EXPECT_EQ(place(fold, "pins.0").path(), "pins.0");
  EXPECT_EQ(place(fold, "simulator.params.substeps").as_int(), 4);
  // For an absent key the innermost node on its path gives the line. The first line of a whole file would mislead.
  const ConfigNode absent = place(fold, "simulator.params.solver.name.x");
  EXPECT_TRUE(absent.is_null());
  EXPECT_EQ(absent.path(), "simulator.params.solver.name.x");
  EXPECT_EQ(absent.where(), fold.at("simulator").at("params").at("solver").where());
  EXPECT_EQ(place(fold, "goal.obj").where(), "fold.yaml");
  EXPECT_EQ(refusal([&] { place(fold, "goal.obj").fail("is missing"); }), "fold.yaml: goal.obj is missing");
}

TEST(Config, BlamingSaysWhichKeyLedToAnError) {
  const ConfigNode fold = parse(kFold);
  EXPECT_EQ(blaming(fold, [] { return 3; }), 3);
  EXPECT_EQ(
      refusal([&] { blaming(fold.at("garment"), []() -> int { throw ConfigError("shirt.yaml: no such file"); }); }),
      "fold.yaml:1: garment = shirt.yaml: shirt.yaml: no such file");
  EXPECT_EQ(refusal([&] { blaming(fold.at("simulator"), []() -> int { throw ConfigError("no"); }); }),
            "fold.yaml:2: simulator: no");
}

TEST(Config, AFileOfAnotherKindIsRecognised) {
  const std::vector<std::string> task = {"description", "seed", "garment", "manipulation"};
  const auto message = [](const std::string& text, const std::vector<std::string>& known) {
    return refusal([&] { parse(text).refuse_unknown_keys(known); });
  };
  EXPECT_EQ(message("task: t.yaml\nfactors: {}\n", task),
            "fold.yaml:1: task is not a known key; the file is an ablation, which `weft ablate` reads");
  // An experiment extends a task, and its own commands know its keys.
  EXPECT_THAT(message("manipulation: {}\ndata: {}\n", {"task"}), HasSubstr("the file is an experiment"));
  EXPECT_EQ(message("data: {}\nsed: 1\n", {"seed", "data"}), "fold.yaml:2: sed is not a known key; nearest: seed");
  EXPECT_THAT(message("name: a\ndensity_kg_per_m2: 1\n", {"nominal", "properties"}), HasSubstr("the file is a fabric"));
  // Overrides of the command line carry no file.
  EXPECT_EQ(refusal([&] {
              apply_override(parse("sets: {}"), "physics.step=1").refuse_unknown_keys({"sets", "physical"});
            }),
            "--set: physics is not a known key; nearest: physical");
  // Only the top of a file tells.
  EXPECT_EQ(refusal([&] { parse("a: {factors: 1}").at("a").refuse_unknown_keys({"factor"}); }),
            "fold.yaml:1: a.factors is not a known key; nearest: factor");
}

TEST(Config, NumbersAreDecimal) {
  const auto number = [](const std::string& text) { return parse("a: " + text).at("a").as_double(); };
  EXPECT_EQ(number("-1.5e-3"), -1.5e-3);
  EXPECT_EQ(number("+2"), 2.0);
  EXPECT_EQ(number(".5"), 0.5);
  EXPECT_EQ(number("3."), 3.0);
  EXPECT_EQ(number(".inf"), std::numeric_limits<double>::infinity());
  EXPECT_EQ(number("-.inf"), -std::numeric_limits<double>::infinity());
  for (const char* text : {"inf", "nan", ".nan", "infinity", "0x10", "1,5", "1_000", "1e999", "+-5", "--5", "1 m",
                           "'5'", "\"5\"", "!!str 5"}) {
    EXPECT_THROW(number(text), ConfigError) << text;
  }
  EXPECT_EQ(parse("a: +7").at("a").as_int(), 7);
  EXPECT_EQ(parse("a: 010").at("a").as_int(), 10);
  EXPECT_EQ(parse("a: -9223372036854775808").at("a").as_int(), std::numeric_limits<std::int64_t>::min());
  for (const char* text : {"1.0", "1e3", "9223372036854775808", "0x10", "'5'", "+-5"}) {
    EXPECT_THROW(parse(std::string("a: ") + text).at("a").as_int(), ConfigError) << text;
  }
}

TEST(Config, OnlyTrueAndFalseAreBooleans) {
  EXPECT_TRUE(parse("a: true").at("a").as_bool());
  EXPECT_FALSE(parse("a: false").at("a").as_bool());
  for (const char* text : {"yes", "no", "on", "1", "True", "'true'"}) {
    EXPECT_THROW(parse(std::string("a: ") + text).at("a").as_bool(), ConfigError) << text;
  }
}

TEST(Config, UnknownKeyNamesTheNearestAndItsLine) {
  const ConfigNode fold = parse(kFold);
  EXPECT_EQ(refusal([&] {
              fold.refuse_unknown_keys({"garment", "simulators", "pins"});
            }),
            "fold.yaml:2: simulator is not a known key; nearest: simulators");
  EXPECT_EQ(refusal([&] {
              fold.at("simulator").at("params").refuse_unknown_keys({"substep", "solver"});
            }),
            "fold.yaml:5: simulator.params.substeps is not a known key; nearest: substep");
  EXPECT_NO_THROW(fold.refuse_unknown_keys({"garment", "simulator", "pins", "more"}));
  EXPECT_NO_THROW(ConfigNode().refuse_unknown_keys({}));
}

TEST(Config, MissingKeyNamesTheNearestThatIsThere) {
  EXPECT_EQ(refusal([&] { parse(kFold).at("simulator").at("plugins"); }),
            "fold.yaml:2: simulator.plugins is missing; nearest: plugin");
  EXPECT_EQ(refusal([&] { parse("").at("garment"); }), "fold.yaml: garment is missing");
}

TEST(Config, NearestIsByEditDistance) {
  EXPECT_EQ(nearest("substep", {"solver", "substeps", "seed"}), "substeps");
  EXPECT_EQ(nearest("frition", {"bend", "friction"}), "friction");
  EXPECT_EQ(nearest("x", {}), "");
  EXPECT_EQ(nearest_hint("frition", {"bend", "friction"}), "; nearest: friction");
  EXPECT_EQ(nearest_hint("tyo", {"toy"}), "; nearest: toy");  // two letters changed places
  EXPECT_EQ(nearest_hint("data", {"seed", "goal"}), "");      // nothing comes near
  EXPECT_EQ(nearest_hint("x", {}), "");
}

TEST(Config, RefusesARepeatedKey) {
  EXPECT_EQ(parse_refusal("a: 1\nb: {c: 1,\n    c: 2}\n"), "fold.yaml:3: b.c is given twice");
}

TEST(Config, RefusesBrokenYamlWithItsLine) {
  EXPECT_THAT(parse_refusal("a: 1\nb: [1, 2\nc: 3\n"), StartsWith("fold.yaml:"));
  EXPECT_EQ(parse_refusal("a: 1\n\tb: 2\n"),
            "fold.yaml:2: not valid YAML: the line is indented with a tab; indent with blanks");
  EXPECT_THAT(parse_refusal("a: *b\n"), AllOf(StartsWith("fold.yaml:1"), HasSubstr("not valid YAML")));
  EXPECT_THAT(parse_refusal("a: 1\n---\nb: 2\n"), HasSubstr("several YAML documents"));
  EXPECT_THAT(parse_refusal("? [a, b]\n: 1\n"), HasSubstr("a key must be a plain text"));
  EXPECT_EQ(parse_refusal("a: 1\nb: \"\xff\"\n"), "fold.yaml:2: is not UTF-8 text");
  EXPECT_EQ(parse_refusal("a: 1\nb: !include x.yaml\n"), "fold.yaml:2: b has the tag !include, must have none");
}

TEST(Config, RefusesAQuoteThatStaysOpenOnItsLine) {
  constexpr const char* kOpen =
      "a quote begins on this line and does not end on it; close it, or write a long text as "
      "a block (`key: |`)";
  // Without the check the first two are read: the quoted text swallows the keys after it.
  EXPECT_EQ(parse_refusal("a: 1\ndescription: \"my towel\nseed: 77\n"), std::string("fold.yaml:2: ") + kOpen);
  EXPECT_EQ(parse_refusal("a: 1\ndescription: 'my towel\nseed: 77\n"), std::string("fold.yaml:2: ") + kOpen);
  EXPECT_EQ(parse_refusal("a: 'two\n  lines'\n"), std::string("fold.yaml:1: ") + kOpen);
  EXPECT_EQ(parse_refusal("a: [1,\n  \"two \\\n  lines\"]\n"), std::string("fold.yaml:2: ") + kOpen);
  EXPECT_EQ(parse_refusal("a: 1\n'b\n  c': 2\n"), std::string("fold.yaml:2: not valid YAML: ") + kOpen);
  EXPECT_EQ(parse_refusal("a: &x 'two\n  lines'\n"), std::string("fold.yaml:1: ") + kOpen);
  EXPECT_EQ(parse_refusal("\xef\xbb\xbf\"a\n b\": 1\n"), std::string("fold.yaml:1: not valid YAML: ") + kOpen);
  // Here YAML itself fails, far behind the quote.
  for (const std::string text : {"# it's\na: don't\nb: |\n  'tis\n\n  so\nc: \"x\nd: \"y\"\n",
                                 "# it's\na: don't\nb: |\n  'tis\n\n  so\nc: [1, {k: \"x}]\nd: \"y\"\n",
                                 "# it's\na: don't\nb: >\n  'tis\n\n  so\n- \"x\nd: \"y\"\n"}) {
    EXPECT_EQ(parse_refusal(text), std::string("fold.yaml:7: not valid YAML: ") + kOpen) << text;
  }
  EXPECT_THAT(parse_refusal("a: 'it''s'\nb: \"\\\"\"  # it's\nc: [1\n"), HasSubstr("fold.yaml:"));
  EXPECT_THAT(parse_refusal("a: 'it''s'\nb: \"\\\"\"  # it's\nc: [1\n"), testing::Not(HasSubstr("quote")));
}

TEST(Config, ReadsQuotesThatAreClosed) {
  const ConfigNode config = parse(
      "a: 'it''s'\nb: \"x \\\" y\\\\\"\nc: don't\nd: |\n  'tis\n  \"so\n'e': [\"1\", 'f: g']\nh: &k \"m\"\ni: *k\n"
      "j: \"line\\nline\"\r\n");
  EXPECT_EQ(config.at("a").as_string(), "it's");
  EXPECT_EQ(config.at("b").as_string(), "x \" y\\");
  EXPECT_EQ(config.at("c").as_string(), "don't");
  EXPECT_EQ(config.at("d").as_string(), "'tis\n\"so\n");
  EXPECT_EQ(config.at("e")[1].as_string(), "f: g");
  EXPECT_EQ(config.at("i").as_string(), "m");
  EXPECT_EQ(config.at("j").as_string(), "line\nline");
  EXPECT_EQ(parse(config.to_yaml()).to_yaml(), config.to_yaml());
}

TEST(Config, RefusesTabsAndMergeKeysWithARemedy) {
  EXPECT_EQ(parse_refusal("a:\n\tb: 1\n"),
            "fold.yaml:2: not valid YAML: the line is indented with a tab; indent with blanks");
  EXPECT_EQ(parse("a:\t1\n").at("a").as_int(), 1);
  EXPECT_EQ(parse_refusal("a: &a {x: 1}\nb:\n  <<: *a\n"),
            "fold.yaml:3: b.<<: merge keys are not supported; write the keys out, or take them from a file with "
            "`extends: FILE`");
  EXPECT_EQ(parse("'<<': 1\n").at("<<").as_int(), 1);
}

TEST(Config, AWholeNumberIsWrittenInDigits) {
  const ConfigNode config = parse("a: 1e3\nb: 40.0\nc: 1.5\nd: -2e2\ne: 1e300\n");
  const auto refused = [&](const char* key) { return refusal([&] { config.at(key).as_int(); }); };
  EXPECT_EQ(refused("a"), "fold.yaml:1: a = 1e3, must be a whole number in digits: 1000");
  EXPECT_EQ(refused("b"), "fold.yaml:2: b = 40.0, must be a whole number in digits: 40");
  EXPECT_EQ(refused("c"), "fold.yaml:3: c = 1.5, must be a whole number");
  EXPECT_EQ(refused("d"), "fold.yaml:4: d = -2e2, must be a whole number in digits: -200");
  EXPECT_EQ(refused("e"), "fold.yaml:5: e = 1e300, must be a whole number");
}

TEST(Config, RefusesAPointerOfGitLfs) {
  const Folder folder;
  const auto file = folder.write("a.yaml", "version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 1\n");
  EXPECT_THAT(refusal([&] { ConfigNode::load(file); }), HasSubstr("a.yaml: is a Git LFS pointer, not the file itself"));
}

TEST(Config, RefusesAliasesThatMultiply) {
  std::string text = "a: &a [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]\n";
  for (char c = 'b'; c < 'k'; ++c) {
    const std::string before(1, static_cast<char>(c - 1));
    text += std::string(1, c) + ": &" + c + " [";
    for (int i = 0; i < 10; ++i) text += (i ? ", *" : "*") + before;
    text += "]\n";
  }
  EXPECT_THAT(parse_refusal(text), AllOf(StartsWith("fold.yaml:"), HasSubstr("holds more than")));
  EXPECT_THAT(parse_refusal("a: &a [*a]\n"), HasSubstr("nested deeper"));
  // A modest alias is fine.
  const ConfigNode node = parse("a: &a {b: 1}\nc: *a\n");
  EXPECT_EQ(node.at("c").at("b").as_int(), 1);
  EXPECT_EQ(node.at("c").where(), "fold.yaml:2");
}

TEST(Config, RefusesDeepNesting) {
  const auto nested = [](std::size_t depth) {
    return "a: " + std::string(depth, '[') + "1" + std::string(depth, ']') + "\n";
  };
  EXPECT_NO_THROW(parse(nested(40)));
  EXPECT_THAT(parse_refusal(nested(100)), AllOf(StartsWith("fold.yaml:1"), HasSubstr("nested deeper")));
  EXPECT_THROW(parse(nested(200000)), ConfigError);
}

TEST(Config, LoadRefusesWhatIsNoFile) {
  const Folder folder;
  EXPECT_THAT(refusal([&] { ConfigNode::load(folder / "none.yaml"); }),
              AllOf(HasSubstr("none.yaml"), HasSubstr("no such file")));
  EXPECT_THAT(refusal([&] { ConfigNode::load(folder.path()); }), HasSubstr("is a folder"));
  EXPECT_EQ(refusal([] { ConfigNode::load("/dev/zero"); }), "/dev/zero: is a device, must be a YAML file");
  const auto pipe = folder / "pipe.yaml";  // nobody writes to it
  ASSERT_EQ(mkfifo(pipe.c_str(), 0600), 0);
  EXPECT_EQ(refusal([&] { ConfigNode::load(pipe); }), pipe.string() + ": is a pipe, must be a YAML file");
  EXPECT_THAT(refusal([&] { ConfigNode::load(folder.write("large.yaml", std::string(16'000'001, ' '))); }),
              HasSubstr("larger than 16 MB"));
}

/// `weft run <(...)`.
TEST(Config, LoadReadsAPipeOfTheShell) {
  int ends[2];
  ASSERT_EQ(pipe(ends), 0);
  ASSERT_EQ(write(ends[1], "a: 1\n", 5), 5);
  close(ends[1]);
  EXPECT_EQ(ConfigNode::load("/dev/fd/" + std::to_string(ends[0])).at("a").as_int(), 1);
  close(ends[0]);
}

TEST(Config, PathsAreRelativeToTheFileTheyStandIn) {
  const Folder folder;
  folder.write("base/base.yaml", "mesh: shirt.obj\nmodel: ../m.pt\n");
  const auto file = folder.write("tasks/fold.yaml", "extends: ../base/base.yaml\ngoal: goal.obj\nout: /tmp/x\n");
  const ConfigNode node = ConfigNode::load(file);
  EXPECT_EQ(node.at("mesh").as_path(), folder / "base/shirt.obj");
  EXPECT_EQ(node.at("model").as_path(), folder / "m.pt");
  EXPECT_EQ(node.at("goal").as_path(), folder / "tasks/goal.obj");
  EXPECT_EQ(node.at("out").as_path(), "/tmp/x");
  EXPECT_EQ(apply_override(node, "goal=other.obj").at("goal").as_path(), "other.obj");
}

TEST(ConfigExtends, MergesKeyByKeyAndKeepsOrigins) {
  const Folder folder;
  folder.write("base.yaml", "seed: 1\nplanning: {horizon: 25, instances: 8}\npins: [1, 2]\n");
  const auto file = folder.write("fold.yaml", "extends: base.yaml\nplanning:\n  instances: 4\npins: [3]\n");
  const ConfigNode node = ConfigNode::load(file);
  EXPECT_THAT(node.keys(), ElementsAre("seed", "planning", "pins"));
  EXPECT_EQ(node.at("planning").at("horizon").as_int(), 25);
  EXPECT_EQ(node.at("planning").at("instances").as_int(), 4);
  EXPECT_EQ(node.at("pins").size(), 1u);  // lists are replaced, not merged
  EXPECT_EQ(node.at("planning").at("horizon").where(), (folder / "base.yaml").string() + ":2");
  EXPECT_EQ(node.at("planning").at("instances").where(), (folder / "fold.yaml").string() + ":3");
  EXPECT_FALSE(node.has("extends"));
}

TEST(ConfigExtends, AChangedPluginDropsTheOldParameters) {
  const Folder folder;
  folder.write("base.yaml", "optimiser: {plugin: rprop, params: {step: 1}}\n");
  const auto same = folder.write("same.yaml", "extends: base.yaml\noptimiser: {plugin: rprop, params: {grow: 2}}\n");
  const auto other = folder.write("other.yaml", "extends: base.yaml\noptimiser: {plugin: ceres}\n");
  EXPECT_THAT(ConfigNode::load(same).at("optimiser").at("params").keys(), ElementsAre("step", "grow"));
  EXPECT_FALSE(ConfigNode::load(other).at("optimiser").has("params"));
}

TEST(ConfigExtends, ChainsAndRefusesCycles) {
  const Folder folder;
  folder.write("a.yaml", "x: 1\ny: 1\nz: 1\n");
  folder.write("b.yaml", "extends: a.yaml\ny: 2\nz: 2\n");
  const ConfigNode c = ConfigNode::load(folder.write("c.yaml", "extends: b.yaml\nz: 3\n"));
  EXPECT_EQ(c.at("x").as_int() * 100 + c.at("y").as_int() * 10 + c.at("z").as_int(), 123);

  folder.write("p.yaml", "extends: q.yaml\n");
  folder.write("q.yaml", "\nextends: ./p.yaml\n");
  EXPECT_THAT(refusal([&] { ConfigNode::load(folder / "p.yaml"); }),
              AllOf(StartsWith((folder / "q.yaml").string() + ":2: extends:"), HasSubstr("extends itself through")));
  const auto self = folder.write("self.yaml", "extends: self.yaml\n");
  EXPECT_THAT(refusal([&] { ConfigNode::load(self); }), AllOf(StartsWith(self.string() + ":1"), HasSubstr("itself")));
}

TEST(ConfigExtends, RefusalsNameTheLineThatExtends) {
  const Folder folder;
  const auto missing = folder.write("fold.yaml", "x: 1\nextends: none.yaml\n");
  EXPECT_THAT(refusal([&] { ConfigNode::load(missing); }),
              AllOf(StartsWith(missing.string() + ":2: extends:"), HasSubstr("no such file")));
  folder.write("list.yaml", "[1, 2]\n");
  const auto list = folder.write("fold2.yaml", "extends: list.yaml\n");
  EXPECT_THAT(refusal([&] { ConfigNode::load(list); }),
              AllOf(StartsWith(list.string() + ":1: extends"), HasSubstr("must be a file that holds a mapping")));
  const auto wrong = folder.write("fold3.yaml", "extends: [a.yaml]\n");
  EXPECT_THAT(refusal([&] { ConfigNode::load(wrong); }),
              StartsWith(wrong.string() + ":1: extends = [a.yaml], must be a text"));
  folder.write("broken.yaml", "a: 1\na: 2\n");
  const auto child = folder.write("fold4.yaml", "extends: broken.yaml\n");
  EXPECT_THAT(refusal([&] { ConfigNode::load(child); }),
              StartsWith((folder / "broken.yaml").string() + ":2: a is given twice"));
}

TEST(ConfigOverride, SetsValuesAnywhere) {
  ConfigNode fold = parse(kFold);
  fold = apply_override(fold, "simulator.params.substeps=9");
  fold = apply_override(fold, "pins=[1, 2]");
  fold = apply_override(fold, "pins.1=5");
  fold = apply_override(fold, "planning.instances=16");  // new mapping
  fold = apply_override(fold, "name=a: b");              // YAML
  fold = apply_override(fold, "text='5'");
  fold = apply_override(fold, "garment=");  // nothing: back to the default
  EXPECT_EQ(fold.at("simulator").at("params").at("substeps").as_int(), 9);
  EXPECT_EQ(fold.at("simulator").at("params").at("solver").at("kind").as_string(), "newton");
  EXPECT_EQ(fold.at("pins")[1].as_int(), 5);
  EXPECT_EQ(fold.at("planning").at("instances").path(), "planning.instances");
  EXPECT_TRUE(fold.at("name").is_mapping());
  EXPECT_THROW(fold.at("text").as_int(), ConfigError);
  EXPECT_TRUE(fold.at("garment").is_null());
  EXPECT_EQ(apply_override(ConfigNode(), "a.b=1").at("a").at("b").as_int(), 1);
}

TEST(ConfigOverride, ErrorsNameTheOption) {
  const ConfigNode fold = apply_override(parse(kFold), "simulator.params.substeps=many");
  EXPECT_EQ(refusal([&] { fold.at("simulator").at("params").at("substeps").as_int(); }),
            "--set: simulator.params.substeps = many, must be a whole number");
  EXPECT_EQ(refusal([&] { apply_override(parse(kFold), "substeps"); }), "--set substeps: must be key.path=value");
  EXPECT_EQ(refusal([&] { apply_override(parse(kFold), "=3"); }), "--set =3: must be key.path=value");
  EXPECT_THAT(refusal([&] { apply_override(parse(kFold), "a..b=3"); }), HasSubstr("empty key"));
  EXPECT_THAT(refusal([&] { apply_override(parse(kFold), "a=[1"); }), StartsWith("--set a: not valid YAML"));
  EXPECT_EQ(refusal([&] { apply_override(parse(kFold), "garment.mesh=x"); }),
            "fold.yaml:1: garment = shirt.yaml, must be a mapping with a key mesh");
  EXPECT_THAT(refusal([&] { apply_override(parse(kFold), "pins.3=1"); }), StartsWith("fold.yaml:7: pins has 3 items"));
  EXPECT_THAT(refusal([&] { apply_override(parse("pins: []"), "pins.0=1"); }),
              StartsWith("fold.yaml:1: pins has 0 items"));
}

TEST(ConfigOverride, AChangedPluginDropsTheOldParameters) {
  const ConfigNode fold = parse(kFold);
  EXPECT_FALSE(apply_override(fold, "simulator.plugin=bullet").at("simulator").has("params"));
  EXPECT_TRUE(apply_override(fold, "simulator.plugin=cloth").at("simulator").has("params"));
  // Also inside lists, and where a bare name stands for a slot.
  const ConfigNode list = parse("members: [{plugin: a, params: {x: 1}}, b]\npredictor: rollout\n");
  const ConfigNode first = apply_override(list, "members.0.plugin=c").at("members")[0];
  EXPECT_EQ(first.at("plugin").as_string(), "c");
  EXPECT_FALSE(first.has("params"));
  EXPECT_EQ(apply_override(list, "members.1.plugin=c").at("members")[1].at("plugin").as_string(), "c");
  EXPECT_EQ(apply_override(list, "predictor.plugin=emd").at("predictor").at("plugin").as_string(), "emd");
  EXPECT_EQ(apply_override(list, "optimiser.plugin=nlopt").at("optimiser").at("plugin").as_string(), "nlopt");
}

// Equal in kind, value and quotedness, all the way down.
void expect_same(const ConfigNode& a, const ConfigNode& b) {
  ASSERT_EQ(a.kind(), b.kind()) << a.path();
  ASSERT_EQ(a.keys(), b.keys()) << a.path();
  ASSERT_EQ(a.size(), b.size()) << a.path();
  if (a.is_scalar()) {
    EXPECT_EQ(a.as_string(), b.as_string()) << a.path();
  }
  for (const auto& key : a.keys()) expect_same(a.at(key), b.at(key));
  for (std::size_t i = 0; a.is_sequence() && i < a.size(); ++i) expect_same(a[i], b[i]);
  EXPECT_EQ(a.to_json(), b.to_json()) << a.path();  // tells 5 from "5"
}

TEST(ConfigRoundTrip, YamlReadsBackTheSame) {
  std::vector<std::pair<std::string, ConfigNode>> entries;
  const char* const texts[] = {"5",           "-1e3",         "+5",       ".inf", "-.inf", ".nan", "inf",   "nan",
                               "true",        "false",        "null",     "Null", "NULL",  "~",    "",      " a",
                               "a ",          "a: b",         "a #b",     "- a",  "? a",   "[a",   "{a}",   "&a",
                               "*a",          "!a",           "|",        ">",    "'",     "\"",   "%a",    "@a",
                               "`a",          "a\nb",         "\t",       "\x01", "\x7f",  "\r\n", "\\n",   "yes",
                               "No",          "0x10",         "1_0",      "1:30", "...",   "---",  "--- a", "a,b",
                               "caf\xc3\xa9", "\xe2\x80\xa8", "\xc2\x85", "<<",   "=",     "a  b", "010"};
  int n = 0;
  for (const char* text : texts) {
    entries.emplace_back("quoted" + std::to_string(n++), ConfigNode::quoted(text));
    entries.emplace_back(text, ConfigNode::integer(n));
  }
  for (const double value :
       {0.0, -0.0, 1.0, 0.1, 1.0 / 3.0, 1e300, 5e-324, -2.5e-7, 123456789.0, 1e21, std::numeric_limits<double>::max(),
        std::numeric_limits<double>::infinity(), -std::numeric_limits<double>::infinity()}) {
    entries.emplace_back("number" + std::to_string(n++), ConfigNode::number(value));
  }
  entries.emplace_back("flag", ConfigNode::boolean(true));
  entries.emplace_back("nothing", ConfigNode());
  entries.emplace_back("empty_list", ConfigNode::sequence({}));
  entries.emplace_back("empty_mapping", ConfigNode::mapping({}));
  entries.emplace_back("list", ConfigNode::sequence({ConfigNode::quoted("5"), ConfigNode::integer(5)}));
  entries.emplace_back(
      "nested",
      ConfigNode::sequence(
          {ConfigNode(), ConfigNode::sequence({ConfigNode::sequence({}), ConfigNode::mapping({})}),
           ConfigNode::mapping({{"a", ConfigNode::mapping({{"b", ConfigNode::sequence({ConfigNode::mapping(
                                                                     {{"c", ConfigNode::integer(1)}})})}})}})}));
  const ConfigNode node = ConfigNode::mapping(entries);
  const ConfigNode back = parse(node.to_yaml());
  expect_same(node, back);
  EXPECT_EQ(back.to_yaml(), node.to_yaml());
}

TEST(ConfigRoundTrip, NumbersKeepTheirBits) {
  for (const double value : {0.1, -0.0, 1.0 / 3.0, 5e-324, 1e300, -123456.789e-12}) {
    const ConfigNode back = parse("a: " + ConfigNode::number(value).to_yaml()).at("a");
    EXPECT_EQ(back.as_double(), value);
    EXPECT_EQ(std::signbit(back.as_double()), std::signbit(value));
  }
}

TEST(ConfigRoundTrip, TopLevelListsAndScalars) {
  for (const char* text : {"[1, 2]", "[{a: 1}, 2]", "5", "'5'", "[]", "{}", "~"}) {
    const ConfigNode node = parse(text);
    expect_same(node, parse(node.to_yaml()));
  }
}

TEST(Config, JsonKeepsTypes) {
  EXPECT_EQ(
      ConfigNode::parse("{a: 1, b: 1.5, c: '1', d: true, e: ~, f: [x], g: 1e2, h: .inf}", "x").to_json(),
      "{\n  \"a\": 1,\n  \"b\": 1.5,\n  \"c\": \"1\",\n  \"d\": true,\n  \"e\": null,\n  \"f\": [\n    \"x\"\n  ],\n"
      "  \"g\": 100.0,\n  \"h\": \".inf\"\n}");
}

TEST(Config, CopiesDoNotChangeTheOriginal) {
  const ConfigNode fold = parse(kFold);
  const std::string before = fold.to_yaml();
  fold.with("simulator.params.substeps", ConfigNode::integer(1));
  fold.without("pins");
  fold.merged(parse("garment: x"));
  EXPECT_EQ(fold.to_yaml(), before);
  EXPECT_FALSE(fold.without("pins").has("pins"));
}

TEST(Config, RefusesTextThatYamlReadsWithoutEnd) {
  EXPECT_THAT(parse_refusal(", a: {b: 0}}\nc: {d: [e]}\n"), testing::Not(testing::IsEmpty()));
}

TEST(Config, RefusesTextThatTakesFarMoreMemoryThanItself) {
  std::string repeated = "a: &a " + std::string(1'000'000, 'x') + "\nb: [";
  for (int i = 0; i < 100; ++i) repeated += "*a, ";
  EXPECT_THAT(parse_refusal(repeated + "*a]\n"), HasSubstr("holds more than 64 MB of text"));
  std::string below = "? " + std::string(100'000, 'k') + "\n: [";
  for (int i = 0; i < 1000; ++i) below += "1, ";
  EXPECT_THAT(parse_refusal(below + "1]\n"), HasSubstr("holds more than 64 MB of text"));
  std::string many = "[1";
  for (int i = 0; i < 500'000; ++i) many += ",1";
  EXPECT_THAT(parse_refusal(many + "]"), HasSubstr("holds more than 200000 values"));
  EXPECT_THAT(parse_refusal(std::string(500'000, '[')), HasSubstr("holds more than 200000 brackets"));
}

TEST(Config, RefusesPathsThatAreTooDeep) {
  std::string path = "a";
  for (int i = 0; i < 100'000; ++i) path += ".a";
  EXPECT_THAT(refusal([&] { parse("a: 1").with(path, ConfigNode::integer(1)); }), HasSubstr("more than 64 levels"));
}

}  // namespace
}  // namespace weft
