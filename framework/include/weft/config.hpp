#pragma once
#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "weft/error.hpp"
#include "weft/export.hpp"

namespace weft {

/// A node of a YAML configuration (null, scalar, sequence or mapping) and its location in the file. A cheap handle on
/// an immutable tree; `with` returns a changed copy. No YAML library's type crosses this header.
class WEFT_API ConfigNode {
 public:
  enum class Kind { null, scalar, sequence, mapping };

  ConfigNode();  ///< null

  /// Reads a file. A mapping with `extends: other.yaml` (path relative to the file) is merged over that file.
  /// @throws ConfigError "file:line: ..." for a missing file, a syntax error, a repeated key or a circular extends.
  static ConfigNode load(const std::filesystem::path& file);
  /// Reads YAML text. Messages show `name` as the file; relative paths start at `folder`.
  static ConfigNode parse(std::string_view text, const std::string& name, const std::filesystem::path& folder = ".");
  static ConfigNode scalar(std::string value);
  static ConfigNode number(double value);  ///< shortest text that reads back to the same bits
  static ConfigNode integer(std::int64_t value);
  static ConfigNode boolean(bool value);
  static ConfigNode quoted(std::string value);  ///< a string, also when it looks like a number
  static ConfigNode sequence(std::vector<ConfigNode> items);
  static ConfigNode mapping(std::vector<std::pair<std::string, ConfigNode>> entries);

  Kind kind() const;
  bool is_null() const { return kind() == Kind::null; }
  bool is_scalar() const { return kind() == Kind::scalar; }
  bool is_sequence() const { return kind() == Kind::sequence; }
  bool is_mapping() const { return kind() == Kind::mapping; }

  /// The value of a key, or nullopt. A null node counts as an empty mapping. @throws ConfigError if this is no mapping.
  std::optional<ConfigNode> find(std::string_view key) const;
  /// The value of a key. @throws ConfigError naming the nearest key if there is none.
  ConfigNode at(std::string_view key) const;
  bool has(std::string_view key) const { return find(key).has_value(); }
  std::vector<std::string> keys() const;       ///< in file order
  std::size_t size() const;                    ///< items of a sequence, entries of a mapping, else 0
  ConfigNode operator[](std::size_t i) const;  ///< sequence item

  /// @throws ConfigError "<where>: <path> = <got>, must be <wanted>".
  double as_double() const;
  std::int64_t as_int() const;
  bool as_bool() const;
  std::string as_string() const;
  /// The scalar as a path, relative to the folder of its file (a value of --set: to the working directory).
  std::filesystem::path as_path() const;

  /// A copy in which the value at a dotted key path ("simulator.params.substeps", "pins.0") is replaced or added.
  /// @throws ConfigError if the path runs through a scalar.
  ConfigNode with(std::string_view dotted_path, const ConfigNode& value) const;
  ConfigNode without(std::string_view key) const;  ///< a copy of this mapping without one top-level key
  /// A copy with `over` merged over it, key by key. Sequences and scalars are replaced.
  ConfigNode merged(const ConfigNode& over) const;

  std::string where() const;  ///< "fold.yaml:12", or "--set"
  std::string path() const;   ///< "simulator.params.substeps"
  std::filesystem::path folder() const;
  /// @throws ConfigError "<where>: <path>[.key] <message>" with where and path of this node.
  [[noreturn]] void fail(const std::string& message) const;
  /// @throws ConfigError for the first key that is not in `known`, naming the nearest one.
  void refuse_unknown_keys(const std::vector<std::string>& known) const;

  std::string to_yaml() const;  ///< block style, ends with a newline
  std::string to_json() const;

 private:
  struct Data;
  explicit ConfigNode(std::shared_ptr<const Data> data);
  std::shared_ptr<const Data> data_;
  friend struct ConfigNodeAccess;
};

/// The entry of `known` with the smallest edit distance to `word`; empty if `known` is empty.
WEFT_API std::string nearest(std::string_view word, const std::vector<std::string>& known);

/// Applies `--set key.path=value` (the value is YAML). @throws ConfigError naming the text.
WEFT_API ConfigNode apply_override(const ConfigNode& config, const std::string& assignment);

// Beside ConfigNode::fail(): the parts of a message that names location, key, value and what is allowed.

/// The node at a dotted key path ("goal.material", "pins.0"), for messages about it. If it does not exist, a null node
/// with the location of its nearest existing parent.
WEFT_API ConfigNode place(const ConfigNode& config, std::string_view dotted_path);

/// A value as messages show it: 5, "5" if quoted, [1, 2], a mapping.
WEFT_API std::string shown(const ConfigNode& node);
/// "one of A, B, C".
WEFT_API std::string one_of(const std::vector<std::string>& allowed);
/// "; nearest: ENTRY" for the end of a message. Empty when more than two letters, and more than half of them, differ.
WEFT_API std::string nearest_hint(std::string_view word, const std::vector<std::string>& known);

/// @throws ConfigError "<where>: <path> = <got>, must be <wanted>".
[[noreturn]] WEFT_API void must_be(const ConfigNode& node, const std::string& wanted);
/// For a value that names something wrong, such as a damaged file.
/// @throws ConfigError "<where>: <path> = <got>: <reason>".
[[noreturn]] WEFT_API void fail_because(const ConfigNode& node, const std::string& reason);

/// Returns read(). If it throws a ConfigError, fail_because() reports that at the node.
template <class Read>
auto blaming(const ConfigNode& node, Read&& read) {
  try {
    return read();
  } catch (const ConfigError& error) {
    fail_because(node, error.what());
  }
}

}  // namespace weft
