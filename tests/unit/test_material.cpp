#include <cmath>
#include <limits>

#include "test_support.hpp"
#include "weft/material.hpp"

namespace weft {
namespace {

using test::message_of;
using ::testing::AllOf;
using ::testing::HasSubstr;

const std::filesystem::path kFabrics = WEFT_SOURCE_DIR "/configs/fabrics";

Fabric fabric_of(const std::string& text) { return read_fabric(ConfigNode::parse(text, "scene.yaml").at("fabric")); }
std::string refusal(const std::string& text) {
  return message_of<ConfigError>([&] { fabric_of(text); });
}

TEST(ReadFabric, ReadsEveryKey) {
  const Fabric fabric = fabric_of(R"(
fabric:
  name: test
  density_kg_per_m2: 0.2
  stretch_n_per_m: {warp: 300, weft: 200, shear: 100}
  poisson: 0.1
  bend_n_m: {warp: 2.0e-5, weft: 1.0e-5, bias: 1.2e-5}
  friction: 0.5
  self_friction: 0.3
  thickness_m: 0.002
  damping: {stretch_s: 0.001, bend_s: 0.002, air_per_s: 3}
)");
  EXPECT_EQ(fabric.name, "test");
  EXPECT_EQ(fabric.density_kg_per_m2, 0.2);
  EXPECT_EQ(fabric.stretch_warp_n_per_m, 300.0);
  EXPECT_EQ(fabric.stretch_weft_n_per_m, 200.0);
  EXPECT_EQ(fabric.stretch_shear_n_per_m, 100.0);
  EXPECT_EQ(fabric.poisson, 0.1);
  EXPECT_EQ(fabric.bend_warp_n_m, 2.0e-5);
  EXPECT_EQ(fabric.bend_weft_n_m, 1.0e-5);
  EXPECT_EQ(fabric.bend_bias_n_m, 1.2e-5);
  EXPECT_EQ(fabric.self_friction, 0.3);
  EXPECT_EQ(fabric.thickness_m, 0.002);
  EXPECT_EQ(fabric.damping_bend_s, 0.002);
  EXPECT_EQ(fabric.damping_air_per_s, 3.0);
}

TEST(ReadFabric, DerivesShearAndBias) {
  const Fabric fabric = fabric_of(
      "fabric: {stretch_n_per_m: {warp: 300, weft: 100}, poisson: 0.25, bend_n_m: {warp: 3.0e-5, weft: 1.0e-5}}");
  EXPECT_DOUBLE_EQ(fabric.stretch_shear_n_per_m, 200.0 / 2.0 / 1.25);
  EXPECT_DOUBLE_EQ(fabric.bend_bias_n_m, 2.0e-5);
}

TEST(ReadFabric, AppliesMultipliers) {
  const Fabric fabric = fabric_of(
      "fabric: {stretch_n_per_m: {warp: 300, weft: 100, shear: 50}, bend_n_m: {warp: 3.0e-5, weft: 1.0e-5}, "
      "stretch_multiplier: 2, bend_multiplier: 10}");
  EXPECT_DOUBLE_EQ(fabric.stretch_warp_n_per_m, 600.0);
  EXPECT_DOUBLE_EQ(fabric.stretch_shear_n_per_m, 100.0);
  EXPECT_DOUBLE_EQ(fabric.bend_weft_n_m, 1.0e-4);
  EXPECT_DOUBLE_EQ(fabric.bend_bias_n_m, 2.0e-4);
}

TEST(ReadFabric, RefusesWithPlaceAndRange) {
  EXPECT_THAT(
      refusal("fabric: {density_kg_per_m2: 0}"),
      AllOf(HasSubstr("scene.yaml:1"), HasSubstr("fabric.density_kg_per_m2"), HasSubstr("= 0, must be in (0, 1000]")));
  EXPECT_THAT(refusal("fabric: {density_kg_per_m2: -0.1}"), HasSubstr("= -0.1, must be in (0, 1000]"));
  EXPECT_THAT(refusal("fabric: {density_kg_per_m2: .nan}"), HasSubstr("density_kg_per_m2"));
  EXPECT_THAT(refusal("fabric: {friction: .inf}"), HasSubstr("friction"));
  EXPECT_THAT(refusal("fabric: {friction: -0.5}"), HasSubstr("= -0.5, must be in [0, 100]"));
  EXPECT_THAT(refusal("fabric: {thickness_m: two}"), HasSubstr("thickness_m"));
  EXPECT_THAT(refusal("fabric: {stretch_n_per_m: {warp: 0, weft: 1}}"), HasSubstr("fabric.stretch_n_per_m.warp"));
  EXPECT_THAT(refusal("fabric: {stretch_n_per_m: {warp: 10}}"), HasSubstr("weft"));
  EXPECT_THAT(refusal("fabric: {bend_n_m: {warp: -1, weft: 1}}"), HasSubstr("fabric.bend_n_m.warp"));
  EXPECT_THAT(refusal("fabric: {damping: {air_per_s: -1}}"), HasSubstr("fabric.damping.air_per_s"));
  EXPECT_THAT(refusal("fabric: {stretch_multiplier: 0}"), HasSubstr("stretch_multiplier"));
  EXPECT_THAT(refusal("fabric: {densty_kg_per_m2: 0.1}"), HasSubstr("density_kg_per_m2"));  // the nearest key
  EXPECT_THAT(refusal("fabric: {damping: {air_per_second: 1}}"), HasSubstr("air_per_s"));
  EXPECT_THAT(refusal("fabric: [1, 2]"), HasSubstr("must be a mapping"));
  EXPECT_THAT(refusal("fabric: cotton.txt"), HasSubstr("must be a fabric .yaml or an ARCSim/ARGUS material .json"));
}

TEST(ReadFabric, RefusesElasticityWithoutAMinimum) {
  // nu21 = 0.9 * 400 / 100 = 3.6: nu12 nu21 > 1.
  EXPECT_THAT(refusal("fabric: {poisson: 0.9, stretch_n_per_m: {warp: 100, weft: 400, shear: 50}}"),
              AllOf(HasSubstr("poisson = 0.9"), HasSubstr("must be below 0.49")));
  EXPECT_THAT(refusal("fabric: {bend_n_m: {warp: 4.0e-5, weft: 1.0e-6, bias: 1.0e-9}}"),
              HasSubstr("makes the bending stiffness negative between the yarns"));
}

TEST(Fabric, ScaledRefusesNonsense) {
  EXPECT_THROW(Fabric().scaled(0.0, 1.0), Error);
  EXPECT_THROW(Fabric().scaled(1.0, std::numeric_limits<double>::quiet_NaN()), Error);
}

TEST(WriteFabric, ReadsBackToTheSameBits) {
  Fabric fabric = Fabric().scaled(1.0 / 3.0, std::sqrt(2.0));
  fabric.name = "12";  // a name that looks like a number stays a name
  fabric.friction = 0.1 + 0.2;
  const std::string text = write_fabric(fabric).to_yaml();
  const Fabric read = read_fabric(ConfigNode::parse(text, "saved.yaml"));
  EXPECT_EQ(read.name, fabric.name);
  EXPECT_EQ(read.stretch_warp_n_per_m, fabric.stretch_warp_n_per_m);
  EXPECT_EQ(read.stretch_shear_n_per_m, fabric.stretch_shear_n_per_m);
  EXPECT_EQ(read.bend_bias_n_m, fabric.bend_bias_n_m);
  EXPECT_EQ(read.friction, fabric.friction);
  EXPECT_EQ(write_fabric(read).to_yaml(), text);
}

// Made-up numbers in the format of such a file, not measurements of a fabric.
const std::string kJson = R"({
  "density": 0.2,
  "stretching": [[60, 12, 30, 20], [61, 13, 31, 21], [62, 14, 32, 22], [63, -5, 33, 23], [64, 16, 34, 24], [65, 17, 35, 25]],
  "bending": [[8e-6, 7e-6, 6e-6, 5e-6, 4e-6], [1e-5, 9e-6, 8e-6, 7e-6, 6e-6], [2e-5, 1e-5, 1e-5, 1e-5, 1e-5]]
})";

std::string replaced(std::string text, const std::string& from, const std::string& to) {
  const auto at = text.find(from);
  EXPECT_NE(at, std::string::npos);
  return text.replace(at, from.size(), to);
}

TEST(ArcsimMaterial, GivesTablesAndConstants) {
  test::Folder folder;
  folder.write("m.json", kJson);
  const Fabric fabric = read_fabric(ConfigNode::parse("fabric: m.json", "scene.yaml", folder.path()).at("fabric"));
  EXPECT_EQ(fabric.name, "m");
  EXPECT_EQ(fabric.density_kg_per_m2, 0.2);
  ASSERT_TRUE(fabric.tables);
  EXPECT_EQ(fabric.tables->stretching[3][1], -5.0);  // clamped when used, not when read
  EXPECT_EQ(fabric.tables->bending[2][0], 2e-5);
  // C = 2c: C11 = 120, C12 = 24, C22 = 60, C33 = 40.
  EXPECT_DOUBLE_EQ(fabric.poisson, 24.0 / 60.0);
  EXPECT_DOUBLE_EQ(fabric.stretch_warp_n_per_m, 120.0 * (1.0 - 24.0 * 24.0 / (120.0 * 60.0)));
  EXPECT_DOUBLE_EQ(fabric.stretch_weft_n_per_m, 60.0 * (1.0 - 24.0 * 24.0 / (120.0 * 60.0)));
  EXPECT_DOUBLE_EQ(fabric.stretch_shear_n_per_m, 20.0);
  // B = ke / 4; the row is the bend axis, so warp bends about the axis at 90 deg.
  EXPECT_DOUBLE_EQ(fabric.bend_warp_n_m, 5e-6);
  EXPECT_DOUBLE_EQ(fabric.bend_weft_n_m, 2e-6);
  EXPECT_DOUBLE_EQ(fabric.bend_bias_n_m, 2.5e-6);
}

TEST(ArcsimMaterial, TakesMultipliersAndWhatTheFileDoesNotSay) {
  test::Folder folder;
  folder.write("m.json", kJson);
  const Fabric fabric = read_fabric(
      ConfigNode::parse(
          "fabric: {file: m.json, stretch_multiplier: 3, bend_multiplier: 0.5, friction: 0.7, thickness_m: 0.003}",
          "scene.yaml", folder.path())
          .at("fabric"));
  EXPECT_EQ(fabric.stretch_multiplier, 3.0);
  EXPECT_EQ(fabric.bend_multiplier, 0.5);
  EXPECT_DOUBLE_EQ(fabric.stretch_shear_n_per_m, 60.0);
  EXPECT_DOUBLE_EQ(fabric.bend_warp_n_m, 2.5e-6);
  EXPECT_EQ(fabric.friction, 0.7);
  EXPECT_EQ(fabric.thickness_m, 0.003);

  const std::string text = write_fabric(fabric.scaled(1.1, 1.7)).to_yaml();
  const Fabric read = read_fabric(ConfigNode::parse(text, "saved.yaml"));
  EXPECT_EQ(read.tables->stretching, fabric.tables->stretching);
  EXPECT_EQ(read.stretch_warp_n_per_m, fabric.scaled(1.1, 1.7).stretch_warp_n_per_m);
  EXPECT_EQ(read.bend_bias_n_m, fabric.scaled(1.1, 1.7).bend_bias_n_m);
  EXPECT_EQ(write_fabric(read).to_yaml(), text);
}

TEST(ArcsimMaterial, RefusesDamagedFiles) {
  test::Folder folder;
  const auto refused = [&](const std::string& json, const std::string& extra = "") {
    folder.write("m.json", json);
    return message_of<ConfigError>([&] {
      read_fabric(ConfigNode::parse("fabric: {file: m.json" + extra + "}", "scene.yaml", folder.path()).at("fabric"));
    });
  };
  EXPECT_THAT(refused("{"), AllOf(HasSubstr("m.json: not valid JSON"), HasSubstr("line 1")));
  EXPECT_THAT(refused("[1]"), HasSubstr("must be an object"));
  EXPECT_THAT(refused(replaced(kJson, "\"density\": 0.2", "\"density\": -0.2")),
              HasSubstr("density = -0.2, must be in (0, 1000]"));
  EXPECT_THAT(refused(replaced(kJson, "\"density\": 0.2", "\"densty\": 0.2")),
              HasSubstr("densty is not a known key; nearest: density"));
  EXPECT_THAT(refused(replaced(kJson, "\"density\": 0.2,", "")), HasSubstr("density is missing"));
  EXPECT_THAT(refused(replaced(kJson, "[61, 13, 31, 21]", "[61, 13, 31]")),
              HasSubstr("stretching[1] has 3 numbers, must have 4"));
  EXPECT_THAT(refused(replaced(kJson, "[61, 13, 31, 21],", "")), HasSubstr("stretching has 5 rows, must have 6"));
  EXPECT_THAT(refused(replaced(kJson, "63", "null")), HasSubstr("stretching[3][0] = null, must be a number"));
  EXPECT_THAT(refused(replaced(kJson, "7e-6", "-7e-6")), HasSubstr("bending[0][1] = -7e-06, must be at least 0"));
  EXPECT_THAT(refused(replaced(kJson, "[60,", "[0,")), HasSubstr("must have c11, c22 and c33 greater than 0"));
  EXPECT_THAT(refused(replaced(kJson, "\"bending\"", "\"name\"")), HasSubstr("bending is missing"));
  EXPECT_THAT(refused(kJson, ", bend_n_m: {warp: 1, weft: 1}"), HasSubstr("bend_n_m"));  // the tables say it already
  EXPECT_THAT(message_of<ConfigError>([&] { read_fabric(ConfigNode::scalar("/nowhere/x.json")); }),
              HasSubstr("no such file"));
}

TEST(PropertyRange, MapsItsEndsExactlyAndBack) {
  const PropertyRange linear{0.5, 4.0, false};
  const PropertyRange log{0.1, 10.0, true};
  EXPECT_EQ(linear.at(0.0), 0.5);
  EXPECT_EQ(linear.at(1.0), 4.0);
  EXPECT_EQ(log.at(1.0), 10.0);
  EXPECT_NEAR(log.at(0.5), 1.0, 1e-15);
  for (const double q : {0.0, 0.3, 0.77, 1.0}) {
    EXPECT_NEAR(linear.inverse(linear.at(q)), q, 1e-14);
    EXPECT_NEAR(log.inverse(log.at(q)), q, 1e-14);
  }
}

TEST(MaterialSpace, BasicMaterialIsAnisotropicAndSpansItsRanges) {
  const MaterialSpace space = read_material_space(ConfigNode::scalar((kFabrics / "basic.yaml").string()));
  EXPECT_NE(space.nominal.stretch_warp_n_per_m, space.nominal.stretch_weft_n_per_m);
  EXPECT_NE(space.nominal.bend_warp_n_m, space.nominal.bend_weft_n_m);
  const Fabric low = space.at(MaterialProperties::Zero());
  const Fabric high = space.at(MaterialProperties::Ones());
  EXPECT_DOUBLE_EQ(low.friction, 0.1);
  EXPECT_DOUBLE_EQ(high.friction, 1.0);
  EXPECT_NEAR(low.self_friction / low.friction, high.self_friction / high.friction, 1e-12);
  EXPECT_NEAR(high.bend_warp_n_m / low.bend_warp_n_m, 100.0, 1e-9);
  EXPECT_NEAR(high.bend_bias_n_m / high.bend_warp_n_m, low.bend_bias_n_m / low.bend_warp_n_m, 1e-12);
  EXPECT_LE(high.stretch_weft_n_per_m, 690.0);  // the end of the range in the file
  EXPECT_DOUBLE_EQ(low.thickness_m, 0.0005);
  EXPECT_DOUBLE_EQ(high.thickness_m, 0.004);
  // Each property moves its own figures only.
  MaterialProperties q = MaterialProperties::Constant(0.5);
  q[1] = 0.9;
  EXPECT_EQ(space.at(q).stretch_warp_n_per_m, space.at(MaterialProperties::Constant(0.5)).stretch_warp_n_per_m);
}

TEST(MaterialSpace, BasicIsotropicIsBasicWithEqualWarpAndWeft) {
  const MaterialSpace basic = read_material_space(ConfigNode::scalar((kFabrics / "basic.yaml").string()));
  const MaterialSpace space = read_material_space(ConfigNode::scalar((kFabrics / "basic_isotropic.yaml").string()));
  const Fabric &from = basic.nominal, &to = space.nominal;
  EXPECT_EQ(to.stretch_warp_n_per_m, 0.5 * (from.stretch_warp_n_per_m + from.stretch_weft_n_per_m));
  EXPECT_EQ(to.stretch_weft_n_per_m, to.stretch_warp_n_per_m);
  EXPECT_DOUBLE_EQ(to.bend_warp_n_m, 0.5 * (from.bend_warp_n_m + from.bend_weft_n_m));
  EXPECT_EQ(to.bend_weft_n_m, to.bend_warp_n_m);
  EXPECT_EQ(to.damping_bend_s, from.damping_bend_s);
  for (std::size_t k = 0; k < space.ranges.size(); ++k) {
    EXPECT_EQ(space.ranges[k].low, basic.ranges[k].low);
    EXPECT_EQ(space.ranges[k].high, basic.ranges[k].high);
  }
  // The equality survives the multipliers, so a simulator that asks for it accepts the whole range.
  const Fabric high = space.at(MaterialProperties::Constant(0.83));
  EXPECT_EQ(high.stretch_warp_n_per_m, high.stretch_weft_n_per_m);
  EXPECT_EQ(high.bend_warp_n_m, high.bend_weft_n_m);
}

TEST(MaterialSpace, RefusesPropertiesOutsideZeroToOne) {
  const MaterialSpace space = read_material_space(ConfigNode::scalar((kFabrics / "basic.yaml").string()));
  MaterialProperties q = MaterialProperties::Constant(0.5);
  q[2] = 1.1;
  EXPECT_THAT(message_of<ConfigError>([&] { space.at(q); }),
              HasSubstr("material property stretch = 1.1, must be in [0, 1]"));
  q[2] = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THROW(space.at(q), ConfigError);
  q[2] = 1.0 + 1e-10;
  EXPECT_EQ(space.at(q).stretch_warp_n_per_m, space.at(q.cwiseMin(1.0)).stretch_warp_n_per_m);
}

TEST(MaterialSpace, ReadsBackAndRefusesBadRanges) {
  const MaterialSpace space = read_material_space(ConfigNode::scalar((kFabrics / "basic.yaml").string()));
  const std::string text = write_material_space(space).to_yaml();
  EXPECT_EQ(write_material_space(read_material_space(ConfigNode::parse(text, "saved.yaml"))).to_yaml(), text);
  const auto refused = [&](const std::string& key, const std::string& yaml) {
    return message_of<ConfigError>([&] {
      read_material_space(
          ConfigNode::parse(text, "saved.yaml").with("properties." + key, ConfigNode::parse(yaml, "set")));
    });
  };
  EXPECT_THAT(refused("bend", "{low: 2, high: 1}"), HasSubstr("low = 2, must be less than high = 1"));
  EXPECT_THAT(refused("bend", "{low: 0, high: 1}"), HasSubstr("must be in (0, 1e+06]"));
  EXPECT_THAT(refused("friction", "{low: 0, high: 1, scale: log}"), HasSubstr("must be in (0, 1e+06]"));
  EXPECT_THAT(refused("friction", "{low: 0.1, high: 1, scale: logarithmic}"), HasSubstr("must be log or linear"));
  EXPECT_THAT(refused("frction", "{low: 0.1, high: 1}"), HasSubstr("friction"));
}

TEST(ShippedFabrics, AllLoadAndNameTheirSource) {
  int count = 0;
  for (const auto& entry : std::filesystem::directory_iterator(kFabrics)) {
    const ConfigNode file = ConfigNode::load(entry.path());
    if (file.has("properties")) continue;
    ++count;
    EXPECT_TRUE(file.has("source")) << entry.path();
    const Fabric fabric = read_fabric(ConfigNode::scalar(entry.path().string()));
    EXPECT_EQ(fabric.name, entry.path().stem().string());
    EXPECT_GT(fabric.density_kg_per_m2, 0.01);
    EXPECT_LT(fabric.density_kg_per_m2, 1.0);
  }
  EXPECT_GE(count, 8);
}

TEST(Fabric, JsonThatIsNestedTooDeepIsRefused) {
  const test::Folder folder;
  const std::string deep = std::string(100'000, '[') + std::string(100'000, ']');
  folder.write("m.json", "{\"density\": 1, // \" in a comment\n \"stretching\": [[" + deep + "]]}");
  EXPECT_THAT(message_of<ConfigError>([&] { read_fabric(ConfigNode::quoted((folder / "m.json").string())); }),
              HasSubstr("nested deeper than 100 levels"));
}

}  // namespace
}  // namespace weft
