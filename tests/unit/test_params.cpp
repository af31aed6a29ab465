#include <cmath>

#include "unit/test_support.hpp"
#include "weft/params.hpp"

namespace weft {
namespace {

using test::message_of;
using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::StartsWith;

struct Solver {
  double tolerance = 1e-6;
  std::int64_t iterations = 20;
  template <class Visitor>
  void visit(Visitor& v) {
    v("tolerance", tolerance, range(1e-12, 1.0), "Stop below this.");
    v("iterations", iterations, range(1, 1000), "At most so many.");
  }
};

struct Params {
  double dt_s = 0.001;
  double free = 2.0;
  std::int64_t substeps = 4;
  bool warm = true;
  std::string integrator = "implicit";
  std::string label = "5";
  std::vector<double> gravity = {0.0, 0.0, -9.81};
  std::vector<std::string> names = {"a", "true"};
  ConfigNode inner = ConfigNode::mapping({{"plugin", ConfigNode::quoted("cloth")}});
  ConfigNode extra;
  std::filesystem::path model;
  Solver solver;
  template <class Visitor>
  void visit(Visitor& v) {
    v("dt_s", dt_s, range(1e-5, 0.1, "s"), "Time step.");
    v("free", free, {}, "Any number.");
    v("substeps", substeps, range(1, 200), "Steps per frame.");
    v("warm", warm, "Warm start.");
    v("integrator", integrator, choice({"implicit", "explicit"}), "Scheme.");
    v("label", label, "Free text.");
    v("gravity", gravity, range(-100, 100, "m/s^2"), "Gravity.");
    v("names", names, "Some names.");
    v("inner", inner, PluginSlot{"simulator"}, "Nested plugin.");
    v("extra", extra, "Read by the component.");
    v("model", model, "Model file.");
    v.group("solver", solver, "Inner solver.");
  }
};

ConfigNode parse(const std::string& text) { return ConfigNode::parse(text, "fold.yaml", "/cfg"); }
std::string refusal(const std::string& text) {
  return message_of<ConfigError>([&] {
    Params params;
    read_params(parse(text), params);
  });
}

TEST(Params, NothingGivenKeepsEveryDefault) {
  Params params;
  const ConfigNode resolved = read_params(ConfigNode(), params);
  EXPECT_EQ(params.dt_s, 0.001);
  EXPECT_EQ(params.solver.iterations, 20);
  EXPECT_THAT(resolved.keys(), ElementsAre("dt_s", "free", "substeps", "warm", "integrator", "label", "gravity",
                                           "names", "inner", "extra", "model", "solver"));
  Params nulls;
  read_params(parse("dt_s:\nsolver:\ninner: ~\n"), nulls);
  EXPECT_EQ(nulls.dt_s, 0.001);
  EXPECT_EQ(nulls.inner.at("plugin").as_string(), "cloth");
}

TEST(Params, ReadsEveryType) {
  Params params;
  read_params(parse("dt_s: 1e-4\nfree: -.inf\nsubsteps: 200\nwarm: false\nintegrator: explicit\nlabel: yes\n"
                    "gravity: [1, 2]\nnames: [x]\ninner: {plugin: bullet, params: {a: 1}}\nextra: [1, {b: 2}]\n"
                    "model: m/net.pt\nsolver: {iterations: 7}\n"),
              params);
  EXPECT_EQ(params.dt_s, 1e-4);
  EXPECT_EQ(params.free, -std::numeric_limits<double>::infinity());
  EXPECT_EQ(params.substeps, 200);
  EXPECT_FALSE(params.warm);
  EXPECT_EQ(params.integrator, "explicit");
  EXPECT_EQ(params.label, "yes");
  EXPECT_THAT(params.gravity, ElementsAre(1.0, 2.0));
  EXPECT_THAT(params.names, ElementsAre("x"));
  EXPECT_EQ(params.inner.at("params").at("a").as_int(), 1);
  EXPECT_EQ(params.extra[1].at("b").as_int(), 2);
  EXPECT_EQ(params.model, "/cfg/m/net.pt");
  EXPECT_EQ(params.solver.iterations, 7);
  EXPECT_EQ(params.solver.tolerance, 1e-6);
}

TEST(Params, RangesIncludeTheirEndsAndAreNamedInTheRefusal) {
  Params params;
  EXPECT_NO_THROW(read_params(parse("substeps: 1\ndt_s: 0.1\n"), params));
  EXPECT_EQ(refusal("\nsubsteps: 0"), "fold.yaml:2: substeps = 0, must be in [1, 200]");
  EXPECT_EQ(refusal("dt_s: -0.01"), "fold.yaml:1: dt_s = -0.01, must be in [1e-05, 0.1] s");
  EXPECT_EQ(refusal("solver:\n  tolerance: 2"), "fold.yaml:2: solver.tolerance = 2, must be in [1e-12, 1]");
  EXPECT_EQ(refusal("gravity: [0, 0, -981]"), "fold.yaml:1: gravity.2 = -981, must be in [-100, 100] m/s^2");
  EXPECT_EQ(refusal("dt_s: .nan"), "fold.yaml:1: dt_s = .nan, must be a number");
}

TEST(Params, WrongTypesAreRefused) {
  EXPECT_EQ(refusal("dt_s: fast"), "fold.yaml:1: dt_s = fast, must be a number");
  EXPECT_EQ(refusal("dt_s: '0.1'"), "fold.yaml:1: dt_s = \"0.1\" (a text), must be a number");
  EXPECT_EQ(refusal("substeps: 2.5"), "fold.yaml:1: substeps = 2.5, must be a whole number");
  EXPECT_EQ(refusal("warm: 1"), "fold.yaml:1: warm = 1, must be true or false");
  EXPECT_EQ(refusal("label: [a]"), "fold.yaml:1: label = [a], must be a text");
  EXPECT_EQ(refusal("gravity: 9.81"), "fold.yaml:1: gravity = 9.81, must be a list of numbers, each in [-100, 100]");
  EXPECT_EQ(refusal("names: a"), "fold.yaml:1: names = a, must be a list of texts");
  EXPECT_EQ(refusal("solver: newton"), "fold.yaml:1: solver = newton, must be a mapping");
  EXPECT_EQ(refusal("[1]"), "fold.yaml:1: holds [1], must be a mapping of parameters");
}

TEST(Params, ChoicesAndKeysNameTheNearest) {
  EXPECT_EQ(refusal("integrator: implict"),
            "fold.yaml:1: integrator = implict, must be one of implicit, explicit; nearest: implicit");
  EXPECT_EQ(refusal("substep: 1"), "fold.yaml:1: substep is not a known key; nearest: substeps");
  EXPECT_EQ(refusal("solver:\n  iteration: 1"),
            "fold.yaml:2: solver.iteration is not a known key; nearest: iterations");
}

TEST(Params, ResolvedMappingReadsBackTheSame) {
  Params params;
  const ConfigNode resolved =
      read_params(parse("dt_s: 0.0123456789012345\nlabel: 'null'\nsolver: {tolerance: 3e-7}\nmodel: net.pt\n"), params);
  Params again;
  // As a saved config: through text, in another folder.
  const ConfigNode twice = read_params(ConfigNode::parse(resolved.to_yaml(), "resolved.yaml", "/elsewhere"), again);
  EXPECT_EQ(twice.to_yaml(), resolved.to_yaml());
  EXPECT_EQ(again.dt_s, 0.0123456789012345);
  EXPECT_EQ(again.label, "null");
  EXPECT_THAT(again.names, ElementsAre("a", "true"));
  EXPECT_EQ(again.solver.tolerance, 3e-7);
  EXPECT_EQ(again.model, "/cfg/net.pt");
}

TEST(Params, DescribeTellsNameTypeUnitRangeDefaultAndText) {
  const auto infos = describe_params<Params>();
  ASSERT_EQ(infos.size(), 13u);
  const auto row = [&](std::size_t i) {
    const auto& p = infos[i];
    return p.name + "|" + p.type + "|" + p.unit + "|" + p.range + "|" + p.default_value + "|" + p.text;
  };
  EXPECT_EQ(row(0), "dt_s|number|s|in [1e-05, 0.1]|0.001|Time step.");
  EXPECT_EQ(row(1), "free|number||a number|2|Any number.");
  EXPECT_EQ(row(2), "substeps|integer||in [1, 200]|4|Steps per frame.");
  EXPECT_EQ(row(3), "warm|bool||true or false|true|Warm start.");
  EXPECT_EQ(row(4), "integrator|text||one of implicit, explicit|implicit|Scheme.");
  EXPECT_EQ(row(5), "label|text|||5|Free text.");
  EXPECT_EQ(row(6), "gravity|list of numbers|m/s^2|in [-100, 100]|[0, 0, -9.81]|Gravity.");
  EXPECT_EQ(row(7), "names|list of texts|||[a, true]|Some names.");
  EXPECT_EQ(row(8), "inner|simulator plugin||{plugin, params}|cloth|Nested plugin.");
  EXPECT_EQ(row(9), "extra|mapping||||Read by the component.");
  EXPECT_EQ(row(10), "model|file||||Model file.");
  EXPECT_EQ(row(11), "solver.tolerance|number||in [1e-12, 1]|1e-06|Stop below this.");
  EXPECT_EQ(row(12), "solver.iterations|integer||in [1, 1000]|20|At most so many.");
}

// A config such as a task. The declarations here decide what the tests below expect of its keys.
struct Cloth {
  ConfigNode mesh;
  std::vector<double> wind = {1.0, 0.0};
  std::string author;
  template <class Visitor>
  void visit(Visitor& v) {
    v("mesh", mesh, "The cloth.", FileOrMapping{});
    v("wind", wind, range(-10, 10, "m/s"), "Of the room.", Length{2, "x, y"});
    v("author", author, "For people.", Decides::nothing);
  }
};
struct Experiment {
  Cloth cloth;
  std::vector<double> weights;
  std::vector<std::string> corners = {"a", "b"};
  std::filesystem::path model;
  std::string method = "fast";
  std::int64_t threads = 0;
  struct Inner {
    ConfigNode mover;
    std::filesystem::path start;
    template <class Visitor>
    void visit(Visitor& v) {
      v("mover", mover, PluginSlot{"trajectory"}, "What moves.");
      v("start", start, "Where it begins.", Decides::results);
    }
  } inner;
  Solver solver;
  template <class Visitor>
  void visit(Visitor& v) {
    v("threads", threads, range(0, 8), "At work.", Decides::nothing);
    v.part(cloth, Decides::examples);
    v("weights", weights, range(0, 1), "One per corner.", Length{3});
    v("corners", corners, "Their names.", Length{2}, Decides::examples);
    v("model", model, "What was learned.");
    v("method", method, choice({"fast", "slow"}), "How.");
    v.group("inner", inner, "Inside.", Decides::examples);
    v.group("solver", solver, "Solver.");
  }
};

TEST(Params, ListsHaveTheLengthThatIsDeclared) {
  const auto refused = [](const std::string& text) {
    return message_of<ConfigError>([&] {
      Experiment params;
      read_params(parse(text), params);
    });
  };
  EXPECT_EQ(refused("\nwind: [1]"), "fold.yaml:2: wind = [1], must be a list of 2 numbers (x, y), each in [-10, 10]");
  EXPECT_EQ(refused("wind: []"), "fold.yaml:1: wind = [], must be a list of 2 numbers (x, y), each in [-10, 10]");
  EXPECT_EQ(refused("wind: 1"), "fold.yaml:1: wind = 1, must be a list of 2 numbers (x, y), each in [-10, 10]");
  EXPECT_EQ(refused("weights: [1, 1, 1, 1]"),
            "fold.yaml:1: weights = [1, 1, 1, 1], must be a list of 3 numbers, each in [0, 1]");
  EXPECT_EQ(refused("corners: [a, b, c]"), "fold.yaml:1: corners = [a, b, c], must be a list of 2 texts");
  // Entries that are empty by default may be given as empty, as saved configs do.
  Experiment params;
  const ConfigNode resolved = read_params(parse("weights: []"), params);
  EXPECT_NO_THROW(read_params(ConfigNode::parse(resolved.to_yaml(), "saved.yaml"), params));
  read_params(parse("weights: [0, 0.5, 1]"), params);
  EXPECT_THAT(params.weights, ElementsAre(0.0, 0.5, 1.0));
}

TEST(Params, RefusesAFileThatIsAGitLfsPointer) {
  const test::Folder folder;
  const auto file = folder.write("m.pt", "version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 1\n");
  EXPECT_EQ(refusal("model: " + file.string()), "fold.yaml:1: model = " + file.string() +
                                                    " is a Git LFS pointer, not the file itself; run `git lfs pull` in "
                                                    "its repository");
}

TEST(Params, DescribeTellsWhatIsBehindAType) {
  const auto infos = describe_params<Experiment>();
  EXPECT_EQ(param_named(infos, "wind").type, "list of 2 numbers (x, y)");
  EXPECT_EQ(param_named(infos, "wind").length.count, 2u);
  EXPECT_EQ(param_named(infos, "corners").type, "list of 2 texts");
  EXPECT_EQ(param_named(infos, "mesh").type, "file or mapping");
  EXPECT_EQ(param_named(infos, "mesh").kind, ParamKind::file_or_mapping);
  EXPECT_EQ(param_named(infos, "model").kind, ParamKind::file);
  EXPECT_EQ(param_named(infos, "inner.mover").kind, ParamKind::slot);
  EXPECT_EQ(param_named(infos, "inner.mover").slot, "trajectory");
  EXPECT_EQ(param_named(infos, "method").kind, ParamKind::choice);
  EXPECT_THAT(param_named(infos, "method").choices, ElementsAre("fast", "slow"));
  EXPECT_EQ(message_of<ConfigError>([&] { param_named(infos, "metod"); }), "metod is not a known key; nearest: method");
}

TEST(Params, AMarkHoldsForAPartAndAGroupUntilAKeySaysOtherwise) {
  std::string marks;
  for (const auto& info : describe_params<Experiment>()) marks += info.name + ": " + to_string(info.decides) + "\n";
  EXPECT_EQ(marks,
            "threads: nothing\nmesh: examples\nwind: examples\nauthor: nothing\nweights: results\n"
            "corners: examples\nmodel: results\nmethod: results\ninner.mover: examples\ninner.start: results\n"
            "solver.tolerance: results\nsolver.iterations: results\n");
}

TEST(Params, KeepsThePartOfAConfigThatIsAskedFor) {
  const auto infos = describe_params<Experiment>();
  const auto examples = [](const ParamInfo& info) { return info.decides == Decides::examples; };
  Experiment params;
  const ConfigNode resolved = read_params(parse("wind: [3, 4]\ninner: {mover: {plugin: toy}}\n"), params);
  EXPECT_EQ(keep_params(resolved, infos, examples).to_yaml(),
            "mesh: null\nwind: [3, 4]\ncorners: [a, b]\ninner:\n  mover:\n    plugin: toy\n");
  // All other keys are kept here, so no key is lost.
  const auto others = [](const ParamInfo& info) { return info.decides != Decides::examples; };
  EXPECT_THAT(keep_params(resolved, infos, others).keys(),
              ElementsAre("threads", "author", "weights", "model", "method", "inner", "solver"));

  // Another command knows more keys of this file than were written: order and places stay.
  const auto all = [](const ParamInfo&) { return true; };
  const ConfigNode file = parse("solver: {iterations: 3}\ndata: {a: 1}\ninner:\nwind: [0, 0]\n");
  const ConfigNode known = keep_params(file, infos, all);
  EXPECT_EQ(known.to_yaml(), "solver:\n  iterations: 3\ninner: null\nwind: [0, 0]\n");
  EXPECT_EQ(known.at("wind").where(), "fold.yaml:4");
  EXPECT_EQ(known.at("solver").where(), "fold.yaml:1");
  EXPECT_EQ(keep_params(parse("inner:\nsolver: {}\nmodel: x\n"), infos, examples).to_yaml(), "inner: null\n");
}

TEST(Params, AFileThatMayBeAMappingIsResolvedLikeAFile) {
  Experiment params;
  const ConfigNode resolved = read_params(parse("mesh: meshes/towel.yaml\n"), params);
  EXPECT_EQ(resolved.at("mesh").as_string(), "/cfg/meshes/towel.yaml");
  EXPECT_EQ(params.cloth.mesh.where(), "fold.yaml:1");  // messages name the file that the user wrote
  EXPECT_EQ(read_params(parse("mesh: {name: towel}\n"), params).at("mesh").at("name").as_string(), "towel");
}

struct VariantParams {
  std::string code = "auto";
  template <class Visitor>
  void visit(Visitor& v) {
    v("code", code, choice({"auto", "narrow", "wide", "widest"}), "Numeric variant.",
      NumericVariant{{"narrow", "wide"}});
  }
};

TEST(Params, AutoBecomesTheBestVariantOfThisMachine) {
  VariantParams params;
  EXPECT_EQ(read_params(ConfigNode(), params).at("code").as_string(), "wide");
  EXPECT_EQ(params.code, "wide");
  VariantParams given;
  EXPECT_EQ(read_params(ConfigNode::parse("code: narrow", "t.yaml"), given).at("code").as_string(), "narrow");
  const auto infos = describe_params<VariantParams>();
  EXPECT_TRUE(infos[0].is_variant);
  EXPECT_EQ(infos[0].default_value, "auto");
}

TEST(Params, AVariantThatThisMachineLacksIsRefusedByName) {
  VariantParams params;
  EXPECT_EQ(message_of<ConfigError>([&] { read_params(ConfigNode::parse("code: widest", "t.yaml"), params); }),
            "t.yaml:1: code = widest, a numeric variant that this machine cannot run; it has narrow, wide");
}

TEST(Params, MarkdownHasOneRowPerParameter) {
  EXPECT_EQ(params_markdown(describe_params<Solver>()),
            "| parameter | type | unit | range | default | meaning |\n|---|---|---|---|---|---|\n"
            "| `tolerance` | number |  | in [1e-12, 1] | 1e-06 | Stop below this. |\n"
            "| `iterations` | integer |  | in [1, 1000] | 20 | At most so many. |\n");
}

}  // namespace
}  // namespace weft
