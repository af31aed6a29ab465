#pragma once
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>

#include "sdk/machine_failure.hpp"
#include "weft/export.hpp"

namespace weft {

/// The reason of a failed write for people, from errno: what is wrong and, where there is one, the remedy.
WEFT_API std::string write_problem(int error_number);

/// Makes the folder if needed and checks that files can be written in it, so that work begins only if its results can be
/// kept. @throws ConfigError naming the folder, the reason and the remedy.
WEFT_API void make_writable_folder(const std::filesystem::path& folder);
/// The same after work has begun. @throws WriteError: the folder could be written before.
WEFT_API void make_folder_for_results(const std::filesystem::path& folder);

/// What stands in the place of a file: "is a folder", "is a pipe", "is a socket", "is a device". Empty: a file, or nothing.
/// A pipe that nobody writes to keeps its reader waiting for ever, so ask before a file is opened.
WEFT_API std::string no_file(const std::filesystem::path& file);
/// The same for a text that is read once, from its beginning: /dev/stdin and /dev/fd/63, which is what a shell makes of
/// `<(...)`, may be pipes.
WEFT_API std::string no_text_file(const std::filesystem::path& file);
/// @throws ConfigError with the file's name: "no such file", "is a pipe, must be a file".
WEFT_API void require_file(const std::filesystem::path& file);

/// Whether a file that begins like this is a pointer of Git LFS in the place of the file itself.
WEFT_API bool is_lfs_pointer(std::string_view beginning);
/// The same of a file, which need not exist.
WEFT_API bool is_lfs_pointer_file(const std::filesystem::path& file);
/// What to tell about such a file, after its name.
inline constexpr const char* kLfsPointer =
    "is a Git LFS pointer, not the file itself; run `git lfs pull` in its repository";

/// The whole of a file that weft or a user wrote, such as JSON. @throws ConfigError if there is none, ReadError if it cannot
/// be read, is a pointer of Git LFS or is no file; with the file's name.
WEFT_API std::string whole_text(const std::filesystem::path& file);
/// The same; nothing if there is no such file.
WEFT_API std::optional<std::string> whole_text_if_there(const std::filesystem::path& file);

/// A file that appears whole or not at all. It is written under a temporary name in the same folder, and commit()
/// renames it. Without commit() nothing is left. Temporary names are unique: several programs may write one file, and
/// the last one to commit wins. What a killed process left in a folder is removed when another process of the same
/// machine writes its first file there.
class WEFT_API WholeFile {
 public:
  explicit WholeFile(std::filesystem::path file);
  ~WholeFile();
  WholeFile(const WholeFile&) = delete;
  WholeFile& operator=(const WholeFile&) = delete;
  /// Where to write: FILE.tmp<24 hexadecimal digits>: machine, process, chance.
  const std::filesystem::path& temporary() const { return temporary_; }
  /// Call it after the temporary file is closed. What it holds is on the disk before the name is. @throws WriteError naming the file and the reason.
  void commit();
  /// @throws WriteError "<file>: cannot be written: <reason>". The temporary file goes with this object.
  [[noreturn]] void fail(const std::string& reason) const;

 private:
  std::filesystem::path file_, temporary_;
};

/// A folder for files that are needed for a while. It goes with this object, with all that is in it, or as WholeFile's
/// temporary names do.
class WEFT_API TemporaryFolder {
 public:
  /// @param in the folder to make it in. @throws WriteError.
  explicit TemporaryFolder(const std::filesystem::path& in);
  ~TemporaryFolder();
  TemporaryFolder(const TemporaryFolder&) = delete;
  TemporaryFolder& operator=(const TemporaryFolder&) = delete;
  const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
};

/// The folder that libweft.so was loaded from: <prefix>/lib or <prefix>/lib/<multiarch>, in the build tree and after
/// installation alike. Plugins, the page and the configs are found from there.
WEFT_API std::filesystem::path library_folder();

/// Writes a file with this text, whole or not at all. @throws WriteError naming the file and the reason.
WEFT_API void write_text(const std::filesystem::path& file, std::string_view text);

}  // namespace weft
