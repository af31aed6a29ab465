#include "weft/hdf5_file.hpp"

#include <sys/file.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cmath>
#include <csignal>
#include <cstdlib>
#include <limits>

#include "sdk/machine_failure.hpp"
#include "unit/test_support.hpp"

namespace weft {
namespace {

namespace fs = std::filesystem;
using test::Folder;
using test::message_of;
using ::testing::HasSubstr;

// Before libhdf5 reads it: a test is about the lock.
[[maybe_unused]] const int locks = setenv("HDF5_USE_FILE_LOCKING", "TRUE", 1);

fs::path file_with_numbers(const Folder& folder) {
  const auto file = folder / "good.h5";
  Hdf5File out = Hdf5File::create(file);
  const std::vector<double> numbers(10000, 0.25);
  out.write("/numbers", {10000}, numbers.data());
  out.commit();
  return file;
}
std::string refusal(const fs::path& file) {
  return message_of<ConfigError>([&] { Hdf5File::open(file); });
}
std::size_t entries(const Folder& folder) {
  return std::distance(fs::directory_iterator(folder.path()), fs::directory_iterator());
}

TEST(Hdf5File, EveryHalfIsReadAsLibhdf5ReadsIt) {
  // read() leaves it to libhdf5.
  std::vector<float> values;
  for (int exponent = -24; exponent <= 15; ++exponent)
    for (int mantissa = 0; mantissa < 1024; ++mantissa)
      for (const float sign : {1.0f, -1.0f}) {
        const float step = std::ldexp(1.0f, std::max(exponent - 10, -24));
        values.push_back(sign * std::round(std::ldexp(1.0f + static_cast<float>(mantissa) / 1024.0f, exponent) / step) *
                         step);
      }
  for (const float special :
       {0.0f, -0.0f, std::numeric_limits<float>::infinity(), -std::numeric_limits<float>::infinity()})
    values.push_back(special);
  const Folder folder;
  Hdf5File out = Hdf5File::create(folder / "half.h5");
  out.write_half("/half", {std::ssize(values)}, values.data());
  out.commit();
  const auto in = Hdf5File::open(folder / "half.h5");
  const auto fast = in.read_float("/half");
  const auto slow = in.read("/half");
  ASSERT_EQ(fast.size(), values.size());
  for (std::size_t i = 0; i < values.size(); ++i) {
    EXPECT_EQ(static_cast<double>(fast[i]), slow[i]) << values[i];
    EXPECT_EQ(std::signbit(fast[i]), std::signbit(values[i]));
  }
}

TEST(Hdf5File, SaysWhyAFileCannotBeOpened) {
  const Folder folder;
  const auto good = file_with_numbers(folder);
  EXPECT_NO_THROW(Hdf5File::open(good));
  EXPECT_EQ(refusal(folder / "none.h5"), (folder / "none.h5").string() + ": does not exist");
  EXPECT_THAT(refusal(folder.path()), HasSubstr(": is a folder, must be an HDF5 file"));
  const auto pipe = folder / "pipe.h5";  // nobody writes to it
  ASSERT_EQ(mkfifo(pipe.c_str(), 0600), 0);
  EXPECT_EQ(refusal(pipe), pipe.string() + ": is a pipe, must be an HDF5 file");
  EXPECT_THAT(refusal(folder.write("empty.h5", "")), HasSubstr(": is empty; "));
  EXPECT_THAT(refusal(folder.write("text.h5", "not at all an HDF5 file")), HasSubstr("text.h5: is not an HDF5 file"));
  EXPECT_THAT(refusal(folder.write("pointer.h5",
                                   "version https://git-lfs.github.com/spec/v1\n"
                                   "oid sha256:4d7a214614ab2935c943f9e0ff69d22eadbb8f32b1258daaa5e2ca24d17"
                                   "e2393\nsize 12345\n")),
              HasSubstr("pointer.h5: is a Git LFS pointer, not the file itself; run `git lfs pull`"));
  const auto size = fs::file_size(good);
  fs::copy_file(good, folder / "short.h5");
  fs::resize_file(folder / "short.h5", size / 2);
  EXPECT_THAT(refusal(folder / "short.h5"), HasSubstr("short.h5: was cut short: it has " + std::to_string(size / 2) +
                                                      " of " + std::to_string(size) + " bytes; "));
  fs::copy_file(good, folder / "torn.h5");
  fs::resize_file(folder / "torn.h5", 20);
  EXPECT_THAT(refusal(folder / "torn.h5"), HasSubstr("torn.h5: is damaged; "));
}

TEST(Hdf5File, SaysThatAnotherProgramHoldsTheLock) {
  const Folder folder;
  const auto good = file_with_numbers(folder);
  FILE* held = fopen(good.c_str(), "r+");
  ASSERT_NE(held, nullptr);
  ASSERT_EQ(flock(fileno(held), LOCK_EX | LOCK_NB), 0);
  EXPECT_THAT(message_of<ReadError>([&] { Hdf5File::open(good); }),
              HasSubstr("good.h5: is locked: another program writes it"));
  fclose(held);
  EXPECT_NO_THROW(Hdf5File::open(good));
}

TEST(Hdf5File, ANameIsWrittenOnce) {
  const Folder folder;
  Hdf5File out = Hdf5File::create(folder / "a.h5");
  out.write("/text", std::string("a"));
  EXPECT_THAT(message_of<Error>([&] { out.write("/text", std::string("b")); }), HasSubstr("/text was written twice"));
  const double one = 1.0;
  EXPECT_THAT(message_of<Error>([&] { out.write("/text", {1}, &one); }), HasSubstr("/text was written twice"));
}

TEST(Hdf5File, AFailedWriteGivesTheReasonAndLeavesNothing) {
  const Folder folder;
  EXPECT_THAT(message_of<Error>([&] { Hdf5File::create(folder / "none/a.h5").commit(); }),
              HasSubstr("none/a.h5: cannot be written: No such file or directory"));
  // A limit on the size of files fails as a full disk does, and needs no disk.
  rlimit before{};
  getrlimit(RLIMIT_FSIZE, &before);
  const auto handler = std::signal(SIGXFSZ, SIG_IGN);
  const rlimit small{20000, before.rlim_max};
  setrlimit(RLIMIT_FSIZE, &small);
  std::vector<double> numbers(100000);
  for (std::size_t i = 0; i < numbers.size(); ++i) numbers[i] = std::sqrt(static_cast<double>(i));
  const std::string message = message_of<Error>([&] {
    Hdf5File out = Hdf5File::create(folder / "a.h5");
    out.write("/numbers", {100000}, numbers.data());
    out.commit();
  });
  setrlimit(RLIMIT_FSIZE, &before);
  std::signal(SIGXFSZ, handler);
  EXPECT_EQ(message, (folder / "a.h5").string() + ": cannot be written: File too large");
  EXPECT_EQ(entries(folder), 0u);
  EXPECT_NO_THROW(file_with_numbers(folder));  // and the library works on
}

}  // namespace
}  // namespace weft
