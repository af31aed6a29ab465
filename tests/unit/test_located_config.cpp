#include "sdk/located_config.hpp"

#include "learning/example_bytes.hpp"
#include "test_support.hpp"
#include "weft/random.hpp"

namespace weft {
namespace {

using test::Folder;
using test::message_of;
using ::testing::HasSubstr;

TEST(LocatedConfig, KeepsValuesLinesAndFolders) {
  const Folder folder;
  folder.write("base/base.yaml", "mesh: towel.obj\nnumbers: [1, 2.5, .inf]\n");
  const auto file =
      folder.write("task.yaml", "extends: base/base.yaml\nname: \"7\"\nnothing:\ngroup: {a: true, b: x}\n");
  const ConfigNode before = ConfigNode::load(file).with("group.c", ConfigNode::number(0.1));
  const ConfigNode after = read_located_json(located_json(before));
  EXPECT_EQ(after.to_yaml(), before.to_yaml());
  EXPECT_EQ(after.at("mesh").as_path(), folder / "base/towel.obj");
  EXPECT_EQ(after.at("name").where(), before.at("name").where());
  EXPECT_EQ(after.at("group").at("b").path(), "group.b");
  EXPECT_EQ(after.at("group").at("c").as_double(), 0.1);
  EXPECT_TRUE(after.at("nothing").is_null());
  EXPECT_EQ(message_of<ConfigError>([&] { after.at("name").as_int(); }),
            message_of<ConfigError>([&] { before.at("name").as_int(); }));
}

TEST(LocatedConfig, RefusesOtherText) {
  for (const char* text : {"", "[]", "{}", "{\"kind\": 9}", "null"})
    EXPECT_NE(message_of<ConfigError>([&] { read_located_json(text); }), "") << text;
}

TEST(ExampleBytes, KeepEveryBit) {
  Example e;
  e.index = 123456789012345;
  e.q << 0.1, 1.0 / 3.0, -0.0, 5e-324;
  RandomStream random(1, 2);
  const auto fill = [&](Controls& matrix, Index rows, Index columns) {
    matrix = Controls::NullaryExpr(rows, columns, [&] { return random.normal(); });
  };
  fill(e.controls, 3, 2);
  fill(e.states, 4, 5);
  fill(e.targets, 4, 6);
  e.shapes = {1.5f, -0.0f, 3.1415927f};
  e.released = true;
  e.settle = {17, 0.25, true};
  e.max_grasp_strain = std::numeric_limits<double>::infinity();
  e.failure = "line one\nline two";
  const Example back = example_from_hex(example_to_hex(e));
  EXPECT_EQ(example_to_hex(back), example_to_hex(e));
  EXPECT_EQ(back.index, e.index);
  EXPECT_EQ(back.q, e.q);
  EXPECT_EQ(back.controls, e.controls);
  EXPECT_EQ(back.targets, e.targets);
  EXPECT_EQ(back.shapes, e.shapes);
  EXPECT_EQ(back.settle.frames, 17);
  EXPECT_EQ(back.failure, e.failure);
}

TEST(ExampleBytes, WhyThereIsNoneKeepsItsStatus) {
  const std::string line = no_example_line({WorkStatus::lost, "model.h5: is locked:\nwait"});
  EXPECT_TRUE(line.starts_with(kNoExample));
  EXPECT_EQ(read_no_example(line).status, WorkStatus::lost);
  EXPECT_EQ(read_no_example(line).message, "model.h5: is locked: wait");
  EXPECT_THROW(read_no_example(std::string(kNoExample) + "nonsense"), ConfigError);
}

TEST(ExampleBytes, RefuseWhatIsCutOrChanged) {
  const std::string hex = example_to_hex(Example());
  for (const std::string& text : {std::string(), hex.substr(0, hex.size() - 2), hex + "00", "x" + hex.substr(1)})
    EXPECT_THAT(message_of<ConfigError>([&] { example_from_hex(text); }), HasSubstr("is no example"));
}

}  // namespace
}  // namespace weft
