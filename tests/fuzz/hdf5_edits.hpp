#pragma once
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

namespace weft::fuzz {

/// A valid HDF5 file in memory, and copies of it that HDF5's own writer has changed: the bytes of a copy are those of a
/// sound file, and what it says may be anything.
class EditedFile {
 public:
  explicit EditedFile(const std::filesystem::path& valid);
  /// Names of its groups and datasets, sorted.
  const std::vector<std::string>& names() const { return names_; }
  /// Writes a copy with the changes that the bytes describe: other names, types, shapes, values, links, storage.
  void write(std::string_view edits, const std::filesystem::path& file) const;
  /// Replaces a text in such a copy.
  static void replace_text(const std::filesystem::path& file, const std::string& name, const std::string& text);

 private:
  std::string bytes_;
  std::vector<std::string> names_;
};

}  // namespace weft::fuzz
