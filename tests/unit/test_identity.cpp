#include "identity/identity.hpp"

#include <nlohmann/json.hpp>

#include "identity/sha256.hpp"
#include "simulation/task_config.hpp"
#include "test_support.hpp"

namespace weft::test {
namespace {

namespace fs = std::filesystem;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

/// A task of files in a folder of its own, and a plugin folder with the toy trajectory.
class TaskFiles {
 public:
  TaskFiles() {
    folder.write("garments/square.obj", "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3\nf 1 3 4\n");
    folder.write("garments/square.yaml", "name: square\nmesh: square.obj\nvertices: {a: 0, b: 1}\n");
    write_fabric_file("0.15");
    write_space("../fabrics/knit.yaml");
    fs::create_directories(folder / "plugins");
    fs::copy_file(toy("first"), folder / "plugins/libweft_trajectory_toy.so");
  }
  static fs::path toy(const char* which) { return fs::path(WEFT_TOY_PLUGINS) / which / "libweft_trajectory_toy.so"; }
  void write_fabric_file(const std::string& density) const {
    folder.write("fabrics/knit.yaml",
                 "name: knit\ndensity_kg_per_m2: " + density +
                     "\nstretch_n_per_m: {warp: 110, weft: 165}\nbend_n_m: {warp: 2e-5, weft: 2e-5}\n");
  }
  void write_space(const std::string& nominal) const {
    folder.write("spaces/space.yaml", "nominal: " + nominal +
                                          "\nproperties:\n"
                                          "  friction: {low: 0.1, high: 1.0}\n  bend: {low: 0.1, high: 10}\n"
                                          "  stretch: {low: 0.2, high: 4}\n  thickness: {low: 0.0005, high: 0.004}\n");
  }
  Identity identity(
      const std::string& more = "",
      const std::function<bool(const ParamInfo&)>& keep = [](const ParamInfo&) { return true; }) const {
    const ConfigNode given = ConfigNode::parse(
        "garment: garments/square.yaml\nmaterial: spaces/space.yaml\nsimulator:\n" + more + kTrajectory, "task.yaml",
        folder.path());
    TaskParams params;
    const ConfigNode resolved = read_params(given, params).with("simulator", ConfigNode());
    Task task;
    task.garment = std::make_shared<const Garment>(read_garment(given.at("garment")));
    task.material = read_material_space(given.at("material"));
    const PluginRegistry registry({folder / "plugins"});
    const auto keys = describe_params<TaskParams>();
    return make_identity({given, resolved, keys, task, registry, keep});
  }

  static constexpr const char* kTrajectory = "trajectory: toy\n";
  Folder folder;
};

TEST(Sha256, OfTheStandardsExample) {
  EXPECT_EQ(sha256("abc"), "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");  // FIPS 180-2, B.1
  EXPECT_EQ(sha256(""), "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855");
}

TEST(Sha256, OfAFileFollowsItsContents) {
  const Folder folder;
  const auto file = folder.write("a", "abc");
  EXPECT_EQ(sha256_of_file(file), sha256("abc"));
  folder.write("a", "abcd");
  EXPECT_EQ(sha256_of_file(file), sha256("abcd"));
  EXPECT_THROW(sha256_of_file(folder / "none"), ConfigError);
}

TEST(Sha256, OfADatasetSeesShardsAlone) {
  const Folder folder;
  folder.write("shard-00000.h5", "a");
  const auto before = sha256_of_dataset(folder.path());
  folder.write("notes.txt", "mine");
  folder.write("shard-00001.h5.tmp12", "half");
  EXPECT_EQ(sha256_of_dataset(folder.path()), before);
  folder.write("shard-00001.h5", "b");
  EXPECT_NE(sha256_of_dataset(folder.path()), before);
}

TEST(Identity, ContentsCountAndNotTheirFiles) {
  const TaskFiles files;
  const Identity before = files.identity();
  EXPECT_TRUE(before.is_known());
  EXPECT_EQ(before.hash().size(), 32u);
  EXPECT_EQ(files.identity().hash(), before.hash());
  // A comment, and the same garment in another file.
  files.folder.write("garments/copy.obj", "# mine\nv 0 0 0\nv 1 0 0\nv 1.0 1 0\nv 0 1 0\nf 1 2 3\nf 1 3 4\n");
  files.folder.write("garments/square.yaml", "# mine\nname: square\nmesh: copy.obj\nvertices: {a: 0, b: 1}\n");
  EXPECT_EQ(files.identity().hash(), before.hash());
  EXPECT_THAT(files.identity().changes_since(before), IsEmpty());
}

TEST(Identity, AChangeInAFileIsNamedWithTheFileAndTheKey) {
  const TaskFiles files;
  const Identity before = files.identity();
  files.write_fabric_file("0.6");
  EXPECT_THAT(files.identity().changes_since(before), ElementsAre("fabrics/knit.yaml: density_kg_per_m2 0.15 -> 0.6"));
  files.write_space("{file: ../fabrics/knit.yaml, density_kg_per_m2: 0.15, friction: 0.7}");
  EXPECT_THAT(files.identity().changes_since(before), ElementsAre("material.nominal.friction 0.5 -> 0.7"));
}

TEST(Identity, AMovedVertexIsNamedWithItsMesh) {
  const TaskFiles files;
  const Identity before = files.identity();
  files.folder.write("garments/square.obj", "v 0 0 0\nv 1 0 0\nv 1.1 1 0\nv 0 1 0\nf 1 2 3\nf 1 3 4\n");
  EXPECT_THAT(files.identity().changes_since(before),
              ElementsAre("garments/square.obj: other contents (garment.mesh)"));
}

TEST(Identity, AKeyOfTheConfigIsNamed) {
  const TaskFiles files;
  const Identity before = files.identity();
  EXPECT_THAT(files.identity("settle: {hold_frames: 9}\n").changes_since(before),
              ElementsAre("settle.hold_frames 6 -> 9"));
}

TEST(Identity, ARebuiltLibraryIsNamed) {
  const TaskFiles files;
  const Identity before = files.identity();
  const auto library = files.folder / "plugins/libweft_trajectory_toy.so";
  std::ofstream(library, std::ios::binary | std::ios::app) << "other code";  // the version stays
  ASSERT_EQ(files.identity().changes_since(before).size(), 1u);
  EXPECT_THAT(files.identity().changes_since(before).front(),
              testing::StartsWith("plugin trajectory/toy: its library was built again with other code (version 1.0.0"));
  fs::remove(library);
  fs::copy_file(TaskFiles::toy("second"), library);
  EXPECT_THAT(files.identity().changes_since(before), ElementsAre("plugin trajectory/toy: version 1.0.0 -> 2.0.0"));
}

TEST(Identity, OnlyKeptKeysCount) {
  const TaskFiles files;
  const auto keep = [](const ParamInfo& info) { return info.name == "garment"; };
  const Identity before = files.identity("", keep);
  files.write_fabric_file("0.6");
  fs::remove(files.folder / "plugins/libweft_trajectory_toy.so");
  fs::copy_file(TaskFiles::toy("second"), files.folder / "plugins/libweft_trajectory_toy.so");
  EXPECT_EQ(files.identity("settle: {hold_frames: 9}\n", keep).hash(), before.hash());
}

TEST(Identity, ReadsBackFromAProvenance) {
  const TaskFiles files;
  const Identity made = files.identity();
  nlohmann::ordered_json provenance{{"weft", "0.1.0"}};
  const auto file = files.folder.write("provenance.json", provenance.dump());
  EXPECT_FALSE(read_identity(file).is_known());
  EXPECT_FALSE(read_identity(files.folder / "none.json").is_known());
  provenance["identity"] = nlohmann::ordered_json::parse(made.to_json());
  files.folder.write("provenance.json", provenance.dump());
  EXPECT_EQ(read_identity(file).hash(), made.hash());
  EXPECT_THAT(made.changes_since(read_identity(file)), IsEmpty());
  EXPECT_THAT(made.changes_since(Identity()), ElementsAre(HasSubstr("earlier version of weft")));
  files.folder.write("provenance.json", "{");
  EXPECT_THAT(message_of<ConfigError>([&] { read_identity(file); }), HasSubstr("provenance.json"));
  EXPECT_NO_THROW(require_identity("out", Identity(), made, true));
  EXPECT_THAT(message_of<ConfigError>([&] { require_identity("out", Identity(), made, false); }),
              HasSubstr("--accept-changed"));
}

TEST(Identity, AnotherCommandIsSaidAlone) {
  EXPECT_THAT(identity_of_command("ablate").changes_since(identity_of_command("run")),
              ElementsAre("they are of the command run, this one is ablate"));
  EXPECT_THAT(identity_of_command("run").changes_since(identity_of_command("run")), IsEmpty());
}

/// A trajectory slot whose plugin has numeric variants.
struct SlotParams {
  ConfigNode trajectory;
  template <class Visitor>
  void visit(Visitor& v) {
    v("trajectory", trajectory, PluginSlot{"trajectory"}, "A trajectory.");
  }
};

TEST(Identity, AFolderKeepsItsNumericVariant) {
  const PluginRegistry registry({fs::path(WEFT_TOY_PLUGINS) / "variants"});
  const auto keys = describe_params<SlotParams>();
  const auto recorded = [](const std::string& variant) {
    return Identity::from_json(R"({"schema": "weft identity 1", "weft": "0.1.0", "config": {"trajectory": {"plugin":
      "varied", "params": {"code": ")" +
                               variant + R"("}}}, "plugins": {}})");
  };
  const auto code = [&](const std::string& slot, const std::vector<Identity>& identities) {
    const ConfigNode config = with_recorded_variants(ConfigNode::parse("trajectory: " + slot, "task.yaml"), keys,
                                                     registry, identities, "results/x");
    return registry.resolve("trajectory", config.at("trajectory")).at("params").at("code").as_string();
  };
  EXPECT_EQ(code("varied", {}), "wide");  // the best one
  EXPECT_EQ(code("varied", {recorded("narrow")}), "narrow");
  EXPECT_EQ(code("{plugin: varied, params: {code: auto}}", {recorded("narrow")}), "narrow");
  EXPECT_EQ(code("{plugin: varied, params: {code: wide}}", {recorded("narrow")}), "wide");  // the config's own
  const std::string refusal = message_of<ConfigError>([&] { code("varied", {recorded("widest")}); });
  EXPECT_THAT(refusal, testing::AllOf(HasSubstr("results/x"), HasSubstr("code = widest"),
                                      HasSubstr("this machine cannot run; it has narrow, wide")));
}

TEST(Identity, ADeviceIsNoFile) {
  EXPECT_THAT(message_of<ConfigError>([] { sha256_of_file("/dev/null"); }), HasSubstr("is not a file"));
}

TEST(Identity, DocumentsOfOtherTypesAreRefused) {
  const std::string head = R"({"schema": "weft identity 1", "weft": "1", "config": )";
  EXPECT_NO_THROW(
      Identity::from_json(head + R"({"command": "run"}, "plugins": {"a/b": {"version": "1", "sha256": "0"}}})"));
  for (const char* rest :
       {R"([], "plugins": {}})", R"({"command": 1}, "plugins": {}})", R"({}, "plugins": []})",
        R"({}, "plugins": {"a/b": {"version": 1, "sha256": "0"}}})", R"({}, "plugins": {"a/b": 1}})"})
    EXPECT_THAT(message_of<ConfigError>([&] { Identity::from_json(head + rest); }), HasSubstr("is not an identity"));
  const std::string deep = std::string(100'000, '[') + std::string(100'000, ']');
  EXPECT_THAT(message_of<ConfigError>([&] { Identity::from_json(head + deep + R"(, "plugins": {}})"); }),
              HasSubstr("nested deeper than 100 levels"));
}

}  // namespace
}  // namespace weft::test
