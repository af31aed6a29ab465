#include "sdk/files.hpp"

#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <chrono>
#include <csignal>
#include <fstream>
#include <thread>

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

TEST(WholeFile, TheFirstOneInAFolderRemovesWhatEndedProcessesLeft) {
  const test::Folder folder;
  const auto begin = [&](const std::string& name) {  // a process that writes half of a file
    const std::size_t before = entries(folder.path());
    const pid_t child = fork();
    if (child == 0) {
      WholeFile whole(folder / name);
      std::ofstream(whole.temporary()) << "half";
      std::this_thread::sleep_for(std::chrono::hours(1));
    }
    while (entries(folder.path()) == before) std::this_thread::sleep_for(std::chrono::milliseconds(1));
    return child;
  };
  const pid_t killed = begin("a.txt"), zombie = begin("a.zombie.txt"), alive = begin("b.txt");
  for (const pid_t child : {killed, zombie}) kill(child, SIGKILL);
  int status = 0;
  waitpid(killed, &status, 0);
  siginfo_t ended;  // nobody asks how the other one ended, as in many containers
  waitid(P_PID, static_cast<id_t>(zombie), &ended, WEXITED | WNOWAIT);
  folder.write("notes.tmp", "mine");
  folder.write("c.txt.tmp0123456789abcdef", "of an earlier version");
  EXPECT_EQ(entries(folder.path()), 5u);
  write_text(folder / "d.txt", "whole");
  EXPECT_EQ(entries(folder.path()), 4u);  // those of the killed ones are gone
  for (const auto& entry : fs::directory_iterator(folder.path()))
    EXPECT_THAT(entry.path().filename().string(), ::testing::Not(::testing::StartsWith("a.")));
  kill(alive, SIGKILL);
  for (const pid_t child : {alive, zombie}) waitpid(child, &status, 0);
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

TEST(WriteProblem, NamesTheRemedyWhereThereIsOne) {
  EXPECT_EQ(write_problem(ENOSPC), "No space left on device; make room and run the command again");
  EXPECT_THAT(write_problem(EDQUOT), HasSubstr("make room in your quota"));
  EXPECT_EQ(write_problem(EROFS), "Read-only file system; name another place");
  EXPECT_EQ(write_problem(ENOENT), "No such file or directory");
}

TEST(MakeWritableFolder, MakesItOrSaysWhyNot) {
  const test::Folder folder;
  make_writable_folder(folder / "a/b");
  make_writable_folder(folder / "a/b");
  EXPECT_TRUE(fs::is_directory(folder / "a/b"));
  const auto file = folder.write("file", "x");
  EXPECT_EQ(test::message_of<ConfigError>([&] { make_writable_folder(file); }),
            file.string() + ": the folder cannot be made: Not a directory");
  EXPECT_THAT(test::message_of<ConfigError>([&] { make_writable_folder("/proc/self/weft"); }),
              HasSubstr("/proc/self/weft: the folder cannot be made: "));
  EXPECT_THAT(test::message_of<ConfigError>([&] { make_writable_folder("/proc/self"); }),
              HasSubstr("/proc/self: no file can be written in this folder: "));
  // Once work has begun the same is a failure of the machine.
  make_folder_for_results(folder / "c/d");
  EXPECT_TRUE(fs::is_directory(folder / "c/d"));
  EXPECT_EQ(test::message_of<WriteError>([&] { make_folder_for_results(file); }),
            file.string() + ": the folder cannot be made: Not a directory");
}

TEST(TemporaryFolder, GoesWithAllThatIsInIt) {
  const test::Folder folder;
  {
    const TemporaryFolder place(folder.path());
    write_text(place.path() / "a.yaml", "a: 1");
    EXPECT_EQ(place.path().parent_path(), folder.path());
  }
  EXPECT_EQ(entries(folder.path()), 0u);
}

TEST(WholeText, IsTheFileOrTheReason) {
  const test::Folder folder;
  EXPECT_EQ(whole_text(folder.write("a.json", "{\n}")), "{\n}");
  EXPECT_EQ(whole_text_if_there(folder / "none.json"), std::nullopt);
  EXPECT_EQ(test::message_of<ConfigError>([&] { whole_text(folder / "none.json"); }),
            (folder / "none.json").string() + ": no such file");
  EXPECT_THAT(test::message_of<ReadError>([&] { whole_text(folder.path()); }),
              HasSubstr(": is a folder, must be a file"));
  const auto pointer = folder.write("p.json", "version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 1\n");
  EXPECT_THAT(test::message_of<ReadError>([&] { whole_text(pointer); }), HasSubstr("p.json: is a Git LFS pointer"));
}

TEST(NoFile, SaysWhatStandsInTheFilesPlace) {
  const test::Folder folder;
  EXPECT_EQ(no_file(folder.write("a.txt", "")), "");
  EXPECT_EQ(no_file(folder / "none"), "");
  EXPECT_EQ(no_file(folder.path()), "is a folder");
  EXPECT_EQ(no_file("/dev/null"), "is a device");
  const auto pipe = folder / "pipe";  // nobody writes to it
  ASSERT_EQ(mkfifo(pipe.c_str(), 0600), 0);
  EXPECT_EQ(no_file(pipe), "is a pipe");
  EXPECT_EQ(no_text_file(pipe), "is a pipe");
  EXPECT_EQ(no_text_file("/dev/stdin"), "");  // whatever the shell connects to it
  EXPECT_EQ(test::message_of<ConfigError>([&] { require_file(pipe); }), pipe.string() + ": is a pipe, must be a file");
  EXPECT_EQ(test::message_of<ReadError>([&] { whole_text(pipe); }), pipe.string() + ": is a pipe, must be a file");
  EXPECT_EQ(test::message_of<ConfigError>([&] { require_file(folder / "none"); }),
            (folder / "none").string() + ": no such file");
}

TEST(LfsPointer, IsToldByItsFirstLine) {
  EXPECT_TRUE(is_lfs_pointer("version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 1\n"));
  EXPECT_FALSE(is_lfs_pointer("version: 1\n"));
  EXPECT_FALSE(is_lfs_pointer(""));
}

}  // namespace
}  // namespace weft
