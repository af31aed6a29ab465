#include "sdk/files.hpp"

#include <fstream>

#include "unit/test_support.hpp"
#include "weft/error.hpp"

namespace weft {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

std::string text_of(const fs::path& file) {
  std::ifstream stream(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), {}};
}
std::size_t entries(const fs::path& folder) {
  return static_cast<std::size_t>(std::distance(fs::directory_iterator(folder), fs::directory_iterator()));
}

TEST(WholeFile, ReplacesWhatWasThereAndLeavesNothingBeside) {
  const test::Folder folder;
  const auto file = folder.write("a.txt", "old");
  write_text(file, std::string("new\0and binary", 14));
  EXPECT_EQ(text_of(file), std::string("new\0and binary", 14));
  EXPECT_EQ(entries(folder.path()), 1u);
}

TEST(WholeFile, WithoutCommitNothingIsLeft) {
  const test::Folder folder;
  const auto file = folder.write("a.txt", "old");
  {
    const WholeFile whole(file);
    std::ofstream(whole.temporary()) << "half";
    EXPECT_EQ(entries(folder.path()), 2u);
  }
  EXPECT_EQ(text_of(file), "old");
  EXPECT_EQ(entries(folder.path()), 1u);
}

TEST(WholeFile, TwoWritersOfOneFileDoNotMeet) {
  const test::Folder folder;
  WholeFile one(folder / "a.txt"), other(folder / "a.txt");
  ASSERT_NE(one.temporary(), other.temporary());
  EXPECT_EQ(one.temporary().parent_path(), folder.path());
  std::ofstream(one.temporary()) << "one";
  std::ofstream(other.temporary()) << "other";
  one.commit();
  EXPECT_EQ(text_of(folder / "a.txt"), "one");
  other.commit();
  EXPECT_EQ(text_of(folder / "a.txt"), "other");
  EXPECT_EQ(entries(folder.path()), 1u);
}

TEST(WholeFile, SaysWhichFileCannotBeWrittenAndWhy) {
  const test::Folder folder;
  const auto none = folder / "none/a.txt";
  EXPECT_EQ(test::message_of<Error>([&] { write_text(none, "x"); }),
            none.string() + ": cannot be written: No such file or directory");
  fs::create_directories(folder / "taken/inside");
  EXPECT_THAT(test::message_of<Error>([&] { write_text(folder / "taken", "x"); }),
              HasSubstr("taken: cannot be written: Is a directory"));
  EXPECT_EQ(entries(folder.path()), 1u);  // not the temporary file either
}

}  // namespace
}  // namespace weft
