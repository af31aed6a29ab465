#include <dlfcn.h>

#include <cstdlib>

#include "loader/program_host.hpp"
#include "loader/registry.hpp"
#include "unit/test_support.hpp"
#include "weft/trajectory.hpp"

namespace weft {
namespace {

namespace fs = std::filesystem;
using test::Folder;
using test::message_of;
using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::StartsWith;

const fs::path kToys = WEFT_TOY_PLUGINS;
ConfigNode parse(const std::string& text, const fs::path& folder = ".") {
  return ConfigNode::parse(text, "fold.yaml", folder);
}

std::shared_ptr<PluginRegistry> registry(const std::vector<std::string>& folders) {
  std::vector<fs::path> path;
  for (const auto& folder : folders) path.push_back(kToys / folder);
  return std::make_shared<PluginRegistry>(path);
}

struct PathVariable {
  explicit PathVariable(const std::string& value) { setenv("WEFT_PLUGIN_PATH", value.c_str(), 1); }
  ~PathVariable() { unsetenv("WEFT_PLUGIN_PATH"); }
};

/// A config with slots, here and below a group, and files.
struct Config {
  ConfigNode mover = parse("{plugin: toy}"), other;
  std::filesystem::path model;
  struct Inner {
    ConfigNode mover = parse("wrapper");
    std::filesystem::path start;
    template <class Visitor>
    void visit(Visitor& v) {
      v("mover", mover, PluginSlot{"trajectory"}, "What moves.");
      v("start", start, "Where it begins.");
    }
  } inner;
  ConfigNode cloth;
  template <class Visitor>
  void visit(Visitor& v) {
    v("mover", mover, PluginSlot{"trajectory"}, "What moves.");
    v("other", other, PluginSlot{"trajectory"}, "What else.");
    v("model", model, "What was learned.");
    v.group("inner", inner, "Inside.");
    v("cloth", cloth, "The cloth.", FileOrMapping{});
  }
};

TEST(Registry, ResolvesEverySlotThatAConfigDeclares) {
  const auto plugins = registry({"second"});
  const auto infos = describe_params<Config>();
  Config params;
  const ConfigNode saved = plugins->resolve_slots(read_params(parse("model: m.h5\n", "/cfg"), params), infos);
  EXPECT_EQ(saved.to_yaml(),
            "mover:\n  plugin: toy\n  params:\n    speed: 1\nother: null\nmodel: /cfg/m.h5\n"
            "inner:\n  mover:\n    plugin: wrapper\n    params:\n      inner:\n        plugin: toy\n"
            "        params:\n          speed: 1\n      table: \"\"\n  start: \"\"\ncloth: null\n");
  EXPECT_EQ(plugins->resolve_slots(saved, infos).to_yaml(), saved.to_yaml());
  const auto wrong = parse("inner:\n  mover:\n    plugin: wraper\n");
  EXPECT_THAT(message_of<PluginError>([&] { plugins->resolve_slots(wrong, infos); }),
              StartsWith("fold.yaml:3: inner.mover.plugin: no trajectory plugin is called 'wraper'"));
}

/// A default that this build lacks.
struct Lacking {
  ConfigNode other = parse("{plugin: not_built}");
  template <class Visitor>
  void visit(Visitor& v) {
    v("other", other, PluginSlot{"trajectory"}, "What else.");
  }
};

TEST(Registry, ADefaultThatThisBuildLacksIsLeftAsItIs) {
  const auto plugins = registry({"second"});
  const auto infos = describe_params<Lacking>();
  const auto resolved = [&](const std::string& text) {
    Lacking params;
    return plugins->resolve_slots(read_params(parse(text), params), infos).to_yaml();
  };
  EXPECT_EQ(resolved("{}"), "other:\n  plugin: not_built\n");
  EXPECT_EQ(resolved("other: not_built"), "other: not_built\n");
  EXPECT_EQ(resolved("other: toy"), "other:\n  plugin: toy\n  params:\n    speed: 1\n");
  EXPECT_TRUE(plugins->files(parse("other: not_built"), infos).empty());
  EXPECT_THAT(message_of<PluginError>([&] { resolved("other: built_not"); }), HasSubstr("'built_not'"));
  // Whoever creates it hears of it.
  const auto host = make_host(plugins, {});
  EXPECT_THAT(message_of<PluginError>([&] { host->create<Trajectory>(parse("not_built")); }),
              HasSubstr("no trajectory plugin is called 'not_built'"));
}

TEST(Registry, FindsTheFilesThatAConfigNames) {
  const auto plugins = registry({"second"});
  const ConfigNode config = parse(
      "mover: {plugin: wrapper, params: {table: a.csv, inner: {plugin: wrapper, params: {table: b.csv}}}}\n"
      "model: m.h5\n"
      "inner: {start: ''}\n"
      "cloth: towel.yaml\n",
      "/cfg");
  std::string found;
  for (const ConfigNode& file : plugins->files(config, describe_params<Config>()))
    found += file.where() + " " + file.path() + " " + file.as_path().string() + "\n";
  EXPECT_EQ(found,
            "fold.yaml:2 model /cfg/m.h5\n"
            "fold.yaml:4 cloth /cfg/towel.yaml\n"
            "fold.yaml:1 mover.params.table /cfg/a.csv\n"
            "fold.yaml:1 mover.params.inner.params.table /cfg/b.csv\n");
  EXPECT_TRUE(plugins->files(parse("cloth: {name: towel}\nmover: toy\n"), describe_params<Config>()).empty());
  const auto host = make_host(plugins, {});
  ASSERT_EQ(host->files("trajectory", config.at("mover")).size(), 2u);
  EXPECT_EQ(host->files("trajectory", config.at("mover")).front().as_string(), "a.csv");
}

TEST(Registry, TheFirstFolderWins) {
  EXPECT_EQ(registry({"first", "second"})->find("toy").version, "1.0.0");
  EXPECT_EQ(registry({"second", "first"})->find("toy").version, "2.0.0");
  // Whatever the file is called.
  EXPECT_EQ(registry({"odd_name", "first"})->find("toy").version, "3.0.0");
  EXPECT_EQ(registry({"first", "odd_name"})->find("toy").version, "1.0.0");
}

TEST(Registry, SearchesTheConfigThenTheVariableThenItsOwnFolder) {
  const PathVariable variable((kToys / "second").string() + "::" + (kToys / "odd_name").string());
  const auto folders = PluginRegistry::default_search_path();
  ASSERT_EQ(folders.size(), 3u);
  EXPECT_EQ(folders[0], kToys / "second");
  EXPECT_EQ(folders[1], kToys / "odd_name");
  EXPECT_EQ(folders[2].filename(), "plugins");
  EXPECT_EQ(registry({})->find("toy").version, "2.0.0");
  EXPECT_EQ(registry({"first"})->find("toy").version, "1.0.0");
}

TEST(Registry, FindsByNameKindAndFile) {
  const auto plugins = registry({"first", "second"});
  EXPECT_EQ(plugins->find("trajectory/toy").name, "toy");
  EXPECT_EQ(plugins->find("toy", "trajectory").kind, "trajectory");
  const auto file = (kToys / "odd_name" / "my_toy.so").string();
  EXPECT_EQ(plugins->find(file).version, "3.0.0");
  EXPECT_THAT(message_of<PluginError>([&] { plugins->find(file, "simulator"); }),
              HasSubstr("is a trajectory plugin, must be a simulator"));
}

TEST(Registry, AnUnknownNameNamesTheNearestAndWhereItSearched) {
  const auto plugins = registry({"first", "second"});
  EXPECT_THAT(
      message_of<PluginError>([&] { plugins->find("wraper"); }),
      AllOf(StartsWith("no plugin is called 'wraper'; nearest: wrapper"), HasSubstr((kToys / "first").string())));
  EXPECT_THAT(message_of<PluginError>([&] { plugins->find("toy", "optimiser"); }),
              StartsWith("no optimiser plugin is called 'toy'"));
  EXPECT_THAT(message_of<PluginError>([&] { plugins->find("/nowhere/x.so"); }), HasSubstr("/nowhere/x.so: refused"));
}

TEST(Registry, AFileInTheWorkingFolderIsNoPluginName) {
  const Folder folder;
  folder.write("toy", "no library");
  const fs::path before = fs::current_path();
  fs::current_path(folder.path());
  EXPECT_EQ(registry({"first"})->find("toy").version, "1.0.0");
  fs::current_path(before);
}

TEST(Registry, ListIsSortedAndShowsEachNameOnce) {
  std::vector<std::string> toys;
  for (const auto& entry : registry({"second", "first"})->list()) {
    if (entry.file.string().starts_with(kToys.string())) toys.push_back(entry.name + " " + entry.version);
  }
  EXPECT_THAT(toys, ElementsAre("toy 2.0.0", "wrapper 1.0.0"));
}

TEST(Registry, WhatIsListedIsWhatIsTakenAndTheOthersAreItsShadows) {
  const Folder folder;
  fs::create_directories(folder / "a");
  fs::create_directories(folder / "b");
  const auto first = kToys / "first/libweft_trajectory_toy.so", second = kToys / "second/libweft_trajectory_toy.so",
             odd = kToys / "odd_name/my_toy.so";
  // In a folder the library named after its plugin goes first, whatever the others are called.
  fs::copy_file(odd, folder / "a/a_toy.so");
  fs::copy_file(first, folder / "a/libweft_trajectory_toy.so");
  fs::copy_file(second, folder / "b/libweft_trajectory_toy.so");
  const PluginRegistry plugins({folder / "a", folder / "b", folder / "a"});
  const auto taken = plugins.find("toy");
  EXPECT_EQ(taken.version, "1.0.0");
  for (const auto& entry : plugins.list()) {
    if (entry.name != "toy") continue;
    EXPECT_EQ(entry.file, taken.file);
    EXPECT_THAT(entry.shadows, ElementsAre(folder / "a/a_toy.so", folder / "b/libweft_trajectory_toy.so"));
  }
}

TEST(Registry, ALibraryNamedAfterAnotherPluginIsRefused) {
  const Folder folder;
  fs::copy_file(kToys / "first/libweft_trajectory_toy.so", folder / "libweft_trajectory_other.so");
  const PluginRegistry plugins({folder.path()});
  EXPECT_THAT(message_of<PluginError>([&] { plugins.find("trajectory/other"); }),
              HasSubstr("is named after trajectory/other, but WEFT_PLUGIN(...) in it says trajectory/toy"));
  EXPECT_THAT(message_of<PluginError>([&] { plugins.find("trajectory/toy"); }), HasSubstr("is named after"));
}

TEST(Registry, NotFoundSaysWhichFoldersAreMissingAndWhatWasRefused) {
  const Folder folder;
  folder.write("broken.so", "no library");
  const PluginRegistry plugins({folder.path(), "/nowhere"});
  EXPECT_THAT(message_of<PluginError>([&] { plugins.find("brokn"); }),
              AllOf(HasSubstr("/nowhere which is no folder"),
                    HasSubstr((folder / "broken.so").string() + ": refused: is no library")));
}

TEST(Registry, AFolderThatIsNotThereIsEmpty) { EXPECT_NO_THROW(PluginRegistry({"/nowhere"}).list()); }

TEST(Registry, ResolveFillsInDefaultsAndRefusesWhatIsWrong) {
  const auto plugins = registry({"first", "second"});
  EXPECT_EQ(plugins->resolve("trajectory", parse("toy")).to_yaml(), "plugin: toy\nparams:\n  speed: 1\n");
  EXPECT_EQ(
      plugins->resolve("trajectory", parse("{plugin: toy, params: {speed: 2}}")).at("params").at("speed").as_double(),
      2);
  const auto refusal = [&](const std::string& text) {
    return message_of<ConfigError>([&] { plugins->resolve("trajectory", parse(text)); });
  };
  EXPECT_EQ(refusal("plugin: toy\nparams:\n  speed: 11\n"), "fold.yaml:3: params.speed = 11, must be in [0, 10] m/s");
  EXPECT_EQ(refusal("plugin: toy\nparam: {}\n"), "fold.yaml:2: param is not a known key; nearest: params");
  EXPECT_THAT(refusal("params: {}\n"), HasSubstr("plugin is missing"));
  EXPECT_THAT(message_of<PluginError>([&] { plugins->resolve("trajectory", parse("t: {plugin: tyo}").at("t")); }),
              StartsWith("fold.yaml:1: t.plugin: no trajectory plugin is called 'tyo'; nearest: toy"));
}

TEST(Registry, ResolveReachesNestedPlugins) {
  const auto plugins = registry({"first", "second"});
  const ConfigNode resolved =
      plugins->resolve("trajectory", parse("{plugin: wrapper, params: {inner: {plugin: toy, params: {speed: 3}}}}"));
  EXPECT_EQ(resolved.at("params").at("inner").at("params").at("speed").as_double(), 3);
  EXPECT_EQ(
      plugins->resolve("trajectory", parse("wrapper")).at("params").at("inner").at("params").at("speed").as_double(),
      1);
  EXPECT_THAT(message_of<ConfigError>([&] {
                plugins->resolve("trajectory",
                                 parse("plugin: wrapper\nparams:\n  inner:\n    plugin: toy\n    params: {sped: 3}\n"));
              }),
              AllOf(StartsWith("fold.yaml:5:"), HasSubstr("nearest: speed")));
}

TEST(Registry, AVersionInTheConfigIsHeldTo) {
  const auto plugins = registry({"first"});
  EXPECT_NO_THROW(plugins->resolve("trajectory", parse("{plugin: toy, version: 1.0.0}")));
  EXPECT_THAT(message_of<PluginError>([&] { plugins->resolve("trajectory", parse("{plugin: toy, version: 1.1.0}")); }),
              AllOf(StartsWith("fold.yaml:1: version = 1.1.0, but "), HasSubstr("is toy 1.0.0")));
}

TEST(Registry, APluginFileIsRelativeToTheConfigFile) {
  const auto plugins = registry({});
  const ConfigNode resolved = plugins->resolve("trajectory", parse("plugin: ./my_toy.so", kToys / "odd_name"));
  EXPECT_EQ(resolved.at("plugin").as_string(), (kToys / "odd_name" / "my_toy.so").string());
}

TEST(Registry, CreatesWithParametersAndPassesRefusalsOn) {
  const auto plugins = registry({"first", "second"});
  const auto host = make_host(plugins, {.threads = 1});
  EXPECT_EQ(host->create<Trajectory>(parse("{plugin: toy, params: {speed: 4}}"))->progress(Vector::Zero(1)), 4.0);
  EXPECT_EQ(host->create<Trajectory>(parse("{plugin: wrapper, params: {inner: {plugin: toy, params: {speed: 4}}}}"))
                ->progress(Vector::Zero(1)),
            104.0);
  EXPECT_EQ(message_of<ConfigError>([&] { host->create<Trajectory>(parse("{plugin: toy, params: {speed: 9}}")); }),
            "toy: speed = 9, which toy refuses itself");
}

TEST(Registry, UsedNamesWhatWasCreated) {
  const auto plugins = registry({"second"});
  EXPECT_TRUE(plugins->used().empty());
  plugins->resolve("trajectory", parse("wrapper"));
  EXPECT_TRUE(plugins->used().empty());
  const auto host = make_host(plugins, {.threads = 1});
  EXPECT_THAT(message_of<ConfigError>([&] { host->create<Trajectory>(parse("{plugin: toy, params: {speed: 9}}")); }),
              HasSubstr("refuses"));
  EXPECT_TRUE(plugins->used().empty());
  host->create<Trajectory>(parse("wrapper"));
  std::vector<std::string> used;
  for (const auto& entry : plugins->used()) used.push_back(entry.kind + "/" + entry.name + " " + entry.version);
  EXPECT_THAT(used, ElementsAre("trajectory/toy 2.0.0", "trajectory/wrapper 1.0.0"));
}

TEST(Registry, AnObjectOutlivesItsRegistryAndTakesTheLibraryWithIt) {
  const std::string file = (kToys / "odd_name" / "my_toy.so").string();
  const auto is_loaded = [&] {
    void* handle = dlopen(file.c_str(), RTLD_NOW | RTLD_NOLOAD);
    if (handle != nullptr) dlclose(handle);
    return handle != nullptr;
  };
  ASSERT_FALSE(is_loaded());
  auto plugins = registry({"odd_name"});
  auto host = make_host(plugins, {.threads = 1});
  auto object = host->create<Trajectory>(parse("toy"));
  plugins.reset();
  host.reset();
  EXPECT_TRUE(is_loaded());
  EXPECT_EQ(object->progress(Vector::Zero(1)), 1.0);
  object.reset();
  EXPECT_FALSE(is_loaded());
}

TEST(Registry, ParamsDescribeThePlugin) {
  const auto plugins = registry({"first"});
  const auto infos = plugins->params(plugins->find("toy"));
  ASSERT_EQ(infos.size(), 1u);
  EXPECT_EQ(infos[0].name, "speed");
  EXPECT_EQ(infos[0].unit, "m/s");
}

}  // namespace
}  // namespace weft
