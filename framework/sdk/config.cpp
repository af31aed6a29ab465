#include "weft/config.hpp"

#include <yaml-cpp/yaml.h>

#include <algorithm>
#include <cerrno>
#include <charconv>
#include <cmath>
#include <cstring>
#include <fstream>
#include <limits>
#include <nlohmann/json.hpp>
#include <set>
#include <sstream>
#include <utility>

#include "sdk/files.hpp"
#include "sdk/yaml_limits.hpp"
#include "sdk/yaml_lines.hpp"

#include "sdk/config_data.hpp"

namespace weft {
namespace {

using Access = ConfigNodeAccess;
namespace fs = std::filesystem;

constexpr int kMaxDepth = 64;                      // deeper YAML is an attack, not a configuration
constexpr std::size_t kMaxNodes = 200'000;         // YAML aliases can multiply without bound
constexpr std::streamsize kMaxBytes = 16'000'000;  // of a file
constexpr std::size_t kMaxText = 64'000'000;       // of all values and their paths; an alias repeats its text

std::string join(const std::string& path, std::string_view key) {
  return path.empty() ? std::string(key) : path + "." + std::string(key);
}

struct Source {
  std::string name;
  fs::path folder;
  bool has_lines = true;  // false: from the command line, so messages give no line number
  std::size_t nodes = 0;
  std::size_t text = 0;  // bytes of the values and paths so far
  std::vector<std::string_view> lines;

  int line(const YAML::Mark& mark) const { return has_lines && mark.line >= 0 ? mark.line + 1 : 0; }
};

[[noreturn]] void fail_at(const std::string& file, int line, const std::string& message) {
  throw ConfigError(file + (line > 0 ? ":" + std::to_string(line) : "") + ": " + message);
}

/// YAML lets a quoted text run over lines, and yaml-cpp ends an open one with the file. So a quote that was forgotten
/// would swallow the keys after it without a word.
void require_closed_quote(const Source& source, const YAML::Mark& mark) {
  if (mark.line < 0 || std::cmp_greater_equal(mark.line, source.lines.size())) return;
  if (has_open_quote_at(source.lines[mark.line], mark.column)) fail_at(source.name, source.line(mark), kOpenQuote);
}

/// @param line of the node's key, for messages. The node of an alias would have the line of its anchor.
ConfigNode convert(const YAML::Node& node, Source& source, const std::string& path, int line, int depth) {
  const auto fail = [&](const std::string& message) {
    fail_at(source.name, line, path.empty() ? message : path + " " + message);
  };
  if (depth > kMaxDepth) fail_at(source.name, line, "nested deeper than " + std::to_string(kMaxDepth) + " levels");
  if (++source.nodes > kMaxNodes) {
    fail_at(source.name, line,
            "holds more than " + std::to_string(kMaxNodes) + " values (an alias counts each time it is used)");
  }
  source.text += path.size() + (node.IsScalar() ? node.Scalar().size() : 0);
  if (source.text > kMaxText) {
    fail_at(source.name, line,
            "holds more than " + std::to_string(kMaxText / 1'000'000) +
                " MB of text (an alias counts each time it is used, and a key for every value below it)");
  }
  ConfigNode::Kind kind = ConfigNode::Kind::null;
  std::string text;
  bool is_quoted = false;
  std::vector<std::pair<std::string, ConfigNode>> entries;
  std::vector<ConfigNode> items;
  const std::string& tag = node.Tag();
  if (!tag.empty() && tag != "?" && tag != "!" && tag != "tag:yaml.org,2002:str") {
    fail("has the tag " + tag + ", must have none");
  }
  if (node.IsScalar()) {
    kind = ConfigNode::Kind::scalar;
    text = node.Scalar();
    is_quoted = tag == "!" || tag == "tag:yaml.org,2002:str";
    if (is_quoted) require_closed_quote(source, node.Mark());
  } else if (node.IsSequence()) {
    kind = ConfigNode::Kind::sequence;
    for (std::size_t i = 0; i < node.size(); ++i) {
      items.push_back(convert(node[i], source, join(path, std::to_string(i)), source.line(node[i].Mark()), depth + 1));
    }
  } else if (node.IsMap()) {
    kind = ConfigNode::Kind::mapping;
    std::set<std::string> seen;
    for (const auto& entry : node) {
      const int key_line = source.line(entry.first.Mark());
      if (!entry.first.IsScalar()) fail_at(source.name, key_line, "a key must be a plain text");
      const std::string& key = entry.first.Scalar();
      if (entry.first.Tag() == "!") require_closed_quote(source, entry.first.Mark());
      if (key == "<<" && entry.first.Tag() != "!") {
        fail_at(source.name, key_line,
                join(path, key) +
                    ": merge keys are not supported; write the keys out, or take them from a file with "
                    "`extends: FILE`");
      }
      if (!seen.insert(key).second) fail_at(source.name, key_line, join(path, key) + " is given twice");
      entries.emplace_back(key, convert(entry.second, source, join(path, key), key_line, depth + 1));
    }
  }
  return Access::make(
      {kind, std::move(text), is_quoted, std::move(entries), std::move(items), source.name, line, source.folder, path});
}

ConfigNode parse_text(std::string_view text, Source& source) {
  if (std::cmp_greater(text.size(), kMaxBytes))
    fail_at(source.name, 0, "is larger than " + std::to_string(kMaxBytes / 1'000'000) + " MB");
  if (const int line = line_that_is_not_utf8(text)) fail_at(source.name, line, "is not UTF-8 text");
  source.lines = yaml_lines(text);
  try {
    limit_yaml(text, kMaxNodes, [&](const YAML::Mark* mark, const std::string& message) {
      fail_at(source.name, mark == nullptr ? 0 : source.line(*mark), message);
    });
    const int documents = yaml_documents(text);
    if (documents > 1) fail_at(source.name, 0, "holds several YAML documents, must be one");
    if (documents == 0) return Access::make({.file = source.name, .folder = source.folder});
    const YAML::Node document = YAML::Load(std::string(text));
    return convert(document, source, "", source.line(document.Mark()), 0);
  } catch (const YAML::Exception& error) {
    const int line = source.line(error.mark);
    if (const int open = line_with_open_quote(source.lines))
      fail_at(source.name, source.has_lines ? open : 0, std::string("not valid YAML: ") + kOpenQuote);
    if (error.mark.line >= 0 && std::cmp_less(error.mark.line, source.lines.size()) &&
        is_indented_with_tab(source.lines[error.mark.line]))
      fail_at(source.name, line, "not valid YAML: the line is indented with a tab; indent with blanks");
    fail_at(source.name, line, "not valid YAML: " + error.msg);
  }
}

// Reports a problem with a file, at the `extends` that names the file if there is one.
using Asker = std::optional<ConfigNode>;
template <class Failure = ConfigError>
[[noreturn]] void fail_file(const fs::path& file, const Asker& asker, const std::string& message) {
  const std::string text = file.string() + ": " + message;
  throw Failure(asker ? asker->where() + ": extends: " + text : text);
}

std::string read_text(const fs::path& file, const Asker& asker) {
  std::error_code ignored;
  if (const std::string other = no_text_file(file); !other.empty()) {
    const fs::path own = file / "config.yaml";  // of results
    fail_file(file, asker,
              other + ", must be a YAML file" + (fs::exists(own, ignored) ? "; it holds " + own.string() : ""));
  }
  std::ifstream stream(file, std::ios::binary);
  if (!stream) {
    const std::string reason = std::strerror(errno);
    if (!fs::exists(file, ignored)) fail_file(file, asker, "no such file, must be a YAML file");
    fail_file<ReadError>(file, asker, "cannot be read: " + reason);
  }
  std::string text;
  char block[1 << 16];
  while (stream.read(block, sizeof(block)) || stream.gcount() > 0) {
    text.append(block, stream.gcount());
    if (static_cast<std::streamsize>(text.size()) > kMaxBytes) {
      fail_file(file, asker, "is larger than " + std::to_string(kMaxBytes / 1'000'000) + " MB, must be a YAML file");
    }
  }
  if (stream.bad()) fail_file<ReadError>(file, asker, "cannot be read completely");
  if (is_lfs_pointer(text)) fail_file(file, asker, kLfsPointer);
  return text;
}

ConfigNode load_file(const fs::path& file, std::vector<fs::path>& chain, const Asker& asker) {
  std::error_code ignored;
  const fs::path canonical = fs::weakly_canonical(file, ignored);
  if (std::find(chain.begin(), chain.end(), canonical) != chain.end()) {
    fail_file(file, asker, "extends itself" + (chain.back() == canonical ? "" : " through " + chain.back().string()));
  }
  const std::string text = read_text(file, asker);
  Source source{file.string(), file.parent_path().empty() ? fs::path(".") : file.parent_path()};
  ConfigNode node = parse_text(text, source);
  if (!node.is_mapping()) return node;
  const auto base = node.find("extends");
  if (!base) return node;
  chain.push_back(canonical);
  const ConfigNode parent = load_file(base->as_path(), chain, base);
  chain.pop_back();
  if (!parent.is_mapping()) base->fail("= " + base->as_string() + ", must be a file that holds a mapping");
  return parent.merged(node.without("extends"));
}

// The same subtree with new paths, after it moved in the tree.
ConfigNode repath(const ConfigNode& node, const std::string& path) {
  const auto& data = Access::data(node);
  auto copy = data;
  copy.path = path;
  for (auto& [key, value] : copy.entries) value = repath(value, join(path, key));
  for (std::size_t i = 0; i < copy.items.size(); ++i)
    copy.items[i] = repath(copy.items[i], join(path, std::to_string(i)));
  return Access::make(std::move(copy));
}

const char* kind_name(ConfigNode::Kind kind) {
  switch (kind) {
    case ConfigNode::Kind::null:
      return "nothing";
    case ConfigNode::Kind::scalar:
      return "a value";
    case ConfigNode::Kind::sequence:
      return "a list";
    case ConfigNode::Kind::mapping:
      return "a mapping";
  }
  return "";
}

// The number in a text: decimal, with an optional sign and exponent, or .inf; not "inf", "nan" or hexadecimal.
std::optional<double> number_of(std::string_view text) {
  const bool negative = text.starts_with('-');
  std::string_view digits = text;
  if (negative || text.starts_with('+')) digits.remove_prefix(1);
  if (digits == ".inf" || digits == ".Inf" || digits == ".INF") {
    return negative ? -std::numeric_limits<double>::infinity() : std::numeric_limits<double>::infinity();
  }
  if (digits.empty() || (digits[0] != '.' && (digits[0] < '0' || digits[0] > '9'))) return std::nullopt;
  double value = 0;
  const auto [end, error] = std::from_chars(digits.data(), digits.data() + digits.size(), value);
  if (error != std::errc() || end != digits.data() + digits.size()) return std::nullopt;
  return negative ? -value : value;
}

bool is_nan_text(std::string_view text) { return text == ".nan" || text == ".NaN" || text == ".NAN"; }

// Whether YAML reads the text back unchanged without quotes. Ignores numbers and booleans.
bool reads_as_plain_string(const std::string& text) {
  if (text.empty() || text == "~" || text == "null" || text == "Null" || text == "NULL") return false;
  if (text.front() == ' ' || text.back() == ' ' || text.front() == '-' || text.front() == '?' ||
      text.starts_with("...") || text == "<<") {
    return false;
  }
  return std::none_of(text.begin(), text.end(), [](char c) {
    return static_cast<unsigned char>(c) < 0x20 || c == 0x7f || std::strchr(":#{}[],&*!|>'\"%@`\\=", c) != nullptr;
  });
}

bool looks_like_something_else(const std::string& text) {
  return number_of(text) || is_nan_text(text) || text == "true" || text == "false";
}

std::string json_string(const std::string& text) {
  return nlohmann::json(text).dump(-1, ' ', false, nlohmann::json::error_handler_t::replace);
}

std::string yaml_scalar(const ConfigNode& node) {
  const auto& data = Access::data(node);
  const bool other = looks_like_something_else(data.text);
  if (!data.is_quoted && other) return data.text;
  if (reads_as_plain_string(data.text) && !other) return data.text;
  return json_string(data.text);  // a JSON string is a YAML string
}

void write_yaml(const ConfigNode& node, std::ostream& out, int indent, bool inline_allowed);

bool is_short_list(const ConfigNode& node) {
  return node.is_sequence() && std::all_of(Access::data(node).items.begin(), Access::data(node).items.end(),
                                           [](const ConfigNode& item) { return item.is_scalar(); });
}

void write_value(const ConfigNode& value, std::ostream& out, int indent) {
  const bool is_block = (value.is_mapping() || value.is_sequence()) && value.size() > 0 && !is_short_list(value);
  if (is_block) {
    out << '\n';
    write_yaml(value, out, indent + 2, false);
  } else {
    out << ' ';
    write_yaml(value, out, indent, true);
    out << '\n';
  }
}

void write_yaml(const ConfigNode& node, std::ostream& out, int indent, bool inline_allowed) {
  const auto& data = Access::data(node);
  const std::string pad(indent, ' ');
  switch (data.kind) {
    case ConfigNode::Kind::null:
      out << "null";
      break;
    case ConfigNode::Kind::scalar:
      out << yaml_scalar(node);
      break;
    case ConfigNode::Kind::sequence:
      if (inline_allowed || is_short_list(node)) {
        if (!inline_allowed) out << pad;
        out << '[';
        for (std::size_t i = 0; i < data.items.size(); ++i) {
          if (i > 0) out << ", ";
          write_yaml(data.items[i], out, indent, true);
        }
        out << ']';
        if (!inline_allowed) out << '\n';
        break;
      }
      for (const auto& item : data.items) {
        out << pad << '-';
        write_value(item, out, indent);
      }
      break;
    case ConfigNode::Kind::mapping:
      if (data.entries.empty()) {
        out << "{}";
        break;
      }
      for (const auto& [key, value] : data.entries) {
        out << pad << (reads_as_plain_string(key) ? key : json_string(key)) << ':';
        write_value(value, out, indent);
      }
      break;
  }
}

nlohmann::ordered_json to_json_value(const ConfigNode& node) {
  const auto& data = Access::data(node);
  switch (data.kind) {
    case ConfigNode::Kind::null:
      return nullptr;
    case ConfigNode::Kind::scalar: {
      if (data.is_quoted) return data.text;
      if (data.text == "true" || data.text == "false") return data.text == "true";
      std::int64_t integer = 0;
      const char* end = data.text.data() + data.text.size();
      if (auto [p, e] = std::from_chars(data.text.data(), end, integer); e == std::errc() && p == end) return integer;
      if (const auto number = number_of(data.text); number && std::isfinite(*number)) return *number;
      return data.text;
    }
    case ConfigNode::Kind::sequence: {
      auto array = nlohmann::ordered_json::array();
      for (const auto& item : data.items) array.push_back(to_json_value(item));
      return array;
    }
    case ConfigNode::Kind::mapping: {
      auto object = nlohmann::ordered_json::object();
      for (const auto& [key, value] : data.entries) object[key] = to_json_value(value);
      return object;
    }
  }
  return nullptr;
}

// Levenshtein distance, one row at a time.
std::size_t edit_distance(std::string_view a, std::string_view b) {
  std::vector<std::size_t> row(b.size() + 1);
  for (std::size_t j = 0; j < row.size(); ++j) row[j] = j;
  for (std::size_t i = 1; i <= a.size(); ++i) {
    std::size_t diagonal = row[0];
    row[0] = i;
    for (std::size_t j = 1; j < row.size(); ++j) {
      const std::size_t replaced = diagonal + (a[i - 1] == b[j - 1] ? 0 : 1);
      diagonal = row[j];
      row[j] = std::min({replaced, row[j] + 1, row[j - 1] + 1});
    }
  }
  return row.back();
}

// For an unknown key: the kind of file that has this key, and the command that reads it. Experiments extend tasks, so
// they come first. Keys from the command line have no line; they do not describe the file.
std::string other_kind(const ConfigNode& file, const std::vector<std::string>& known) {
  constexpr const char* kKinds[][2] = {
      {"factors", "an ablation, which `weft ablate` reads"},
      {"physics", "an experiment, which `weft evaluate physics` reads"},
      {"data", "an experiment, which `weft generate`, `weft train` and `weft evaluate` read"},
      {"evaluation", "an experiment, which `weft generate`, `weft train` and `weft evaluate` read"},
      {"duration_s", "a scene, which `weft simulate` reads"},
      {"manipulation", "a task, which `weft run` reads"},
      {"density_kg_per_m2", "a fabric: `fabric` of a scene, or `nominal` of a material space"},
      {"properties", "a material space: `material` of a task"},
      {"mesh", "a garment: `garment` of a task or a scene"},
  };
  for (const auto& [key, kind] : kKinds) {
    if (std::find(known.begin(), known.end(), key) != known.end() || !file.has(key)) continue;
    if (Access::data(file.at(key)).line > 0) return kind;
  }
  return "";
}

}  // namespace

ConfigNode::ConfigNode() {
  static const auto null = std::make_shared<const Data>();
  data_ = null;
}
ConfigNode::ConfigNode(std::shared_ptr<const Data> data) : data_(std::move(data)) {}

ConfigNode ConfigNode::load(const fs::path& file) {
  std::vector<fs::path> chain;
  return repath(load_file(file, chain, std::nullopt), "");
}

ConfigNode ConfigNode::parse(std::string_view text, const std::string& name, const fs::path& folder) {
  Source source{name, folder};
  return parse_text(text, source);
}

ConfigNode ConfigNode::scalar(std::string value) {
  return Access::make({.kind = Kind::scalar, .text = std::move(value)});
}
ConfigNode ConfigNode::quoted(std::string value) {
  return Access::make({.kind = Kind::scalar, .text = std::move(value), .is_quoted = true});
}
ConfigNode ConfigNode::number(double value) {
  if (std::isinf(value)) return scalar(value > 0 ? ".inf" : "-.inf");
  if (std::isnan(value)) return scalar(".nan");
  char buffer[40];
  const auto end = std::to_chars(buffer, buffer + sizeof(buffer), value).ptr;
  return scalar(std::string(buffer, end));
}
ConfigNode ConfigNode::integer(std::int64_t value) { return scalar(std::to_string(value)); }
ConfigNode ConfigNode::boolean(bool value) { return scalar(value ? "true" : "false"); }
ConfigNode ConfigNode::sequence(std::vector<ConfigNode> items) {
  return repath(Access::make({.kind = Kind::sequence, .items = std::move(items)}), "");
}
ConfigNode ConfigNode::mapping(std::vector<std::pair<std::string, ConfigNode>> entries) {
  return repath(Access::make({.kind = Kind::mapping, .entries = std::move(entries)}), "");
}

ConfigNode::Kind ConfigNode::kind() const { return data_->kind; }

std::optional<ConfigNode> ConfigNode::find(std::string_view key) const {
  if (is_null()) return std::nullopt;
  if (!is_mapping()) must_be(*this, "a mapping");
  for (const auto& [name, value] : data_->entries) {
    if (name == key) return value;
  }
  return std::nullopt;
}

ConfigNode ConfigNode::at(std::string_view key) const {
  if (auto value = find(key)) return *value;
  throw ConfigError(where() + ": " + join(path(), key) + " is missing" + nearest_hint(key, keys()));
}

std::vector<std::string> ConfigNode::keys() const {
  std::vector<std::string> result;
  for (const auto& entry : data_->entries) result.push_back(entry.first);
  return result;
}

std::size_t ConfigNode::size() const { return is_sequence() ? data_->items.size() : data_->entries.size(); }

ConfigNode ConfigNode::operator[](std::size_t i) const {
  if (!is_sequence()) must_be(*this, "a list");
  if (i >= data_->items.size()) {
    fail("has " + std::to_string(size()) + " items, but item " + std::to_string(i) + " (counted from 0) was asked for");
  }
  return data_->items[i];
}

double ConfigNode::as_double() const {
  const auto value = is_scalar() && !data_->is_quoted ? number_of(data_->text) : std::nullopt;
  if (!value) must_be(*this, "a number");
  return *value;
}

std::int64_t ConfigNode::as_int() const {
  if (!is_scalar() || data_->is_quoted) must_be(*this, "a whole number");
  std::string_view text = data_->text;
  if (text.starts_with('+') && !text.starts_with("+-")) text.remove_prefix(1);
  std::int64_t value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc() || end != text.data() + text.size()) {
    const auto number = number_of(data_->text);
    if (!number || std::floor(*number) != *number || std::abs(*number) > 9e15) must_be(*this, "a whole number");
    must_be(*this, "a whole number in digits: " + std::to_string(static_cast<std::int64_t>(*number)));
  }
  return value;
}

bool ConfigNode::as_bool() const {
  if (is_scalar() && !data_->is_quoted) {
    if (data_->text == "true") return true;
    if (data_->text == "false") return false;
  }
  must_be(*this, "true or false");
}

std::string ConfigNode::as_string() const {
  if (!is_scalar()) must_be(*this, "a text");
  return data_->text;
}

fs::path ConfigNode::as_path() const {
  const fs::path path = as_string();
  return path.is_absolute() ? path : (folder() / path).lexically_normal();
}

ConfigNode ConfigNode::with(std::string_view dotted_path, const ConfigNode& value) const {
  const auto dot = dotted_path.find('.');
  const std::string key(dotted_path.substr(0, dot));
  if (std::count(dotted_path.begin(), dotted_path.end(), '.') > kMaxDepth)
    fail("has a path of more than " + std::to_string(kMaxDepth) + " levels");
  if (key.empty()) fail("has an empty key in the path '" + std::string(dotted_path) + "'");
  auto copy = *data_;
  const auto changed = [&](const ConfigNode& old) {
    return repath(dot == std::string_view::npos ? value : old.with(dotted_path.substr(dot + 1), value),
                  join(data_->path, key));
  };
  if (is_sequence()) {
    std::size_t i = 0;
    const auto [end, error] = std::from_chars(key.data(), key.data() + key.size(), i);
    if (error != std::errc() || end != key.data() + key.size() || i >= copy.items.size()) {
      fail("has " + std::to_string(size()) + " items, so '" + key + "' must be the number of an item, counted from 0");
    }
    copy.items[i] = changed(copy.items[i]);
    return Access::make(std::move(copy));
  }
  if (is_scalar()) must_be(*this, "a mapping with a key " + key);
  copy.kind = Kind::mapping;
  for (auto& [name, old] : copy.entries) {
    if (name == key) {
      old = changed(old);
      return Access::make(std::move(copy));
    }
  }
  auto blank = Data{.file = value.data_->file,
                    .line = value.data_->line,
                    .folder = value.data_->folder,
                    .path = join(data_->path, key)};
  copy.entries.emplace_back(key, changed(Access::make(std::move(blank))));
  return Access::make(std::move(copy));
}

ConfigNode ConfigNode::without(std::string_view key) const {
  auto copy = *data_;
  std::erase_if(copy.entries, [&](const auto& entry) { return entry.first == key; });
  return Access::make(std::move(copy));
}

ConfigNode ConfigNode::merged(const ConfigNode& over) const {
  if (!is_mapping() || !over.is_mapping()) return repath(over, path());
  auto copy = *data_;
  copy.file = over.data_->file;
  copy.line = over.data_->line;
  copy.folder = over.data_->folder;
  // If the plugin changes, the parameters of the old plugin are dropped.
  const auto plugin = over.find("plugin");
  if (plugin && has("plugin") && at("plugin").data_->text != plugin->data_->text) return repath(over, path());
  for (const auto& [key, value] : over.data_->entries) {
    const auto old = std::find_if(copy.entries.begin(), copy.entries.end(),
                                  [&name = key](const auto& e) { return e.first == name; });
    if (old == copy.entries.end()) {
      copy.entries.emplace_back(key, repath(value, join(path(), key)));
    } else {
      old->second = old->second.merged(value);
    }
  }
  return Access::make(std::move(copy));
}

std::string ConfigNode::where() const {
  if (data_->file.empty()) return "built-in";
  return data_->line > 0 ? data_->file + ":" + std::to_string(data_->line) : data_->file;
}
std::string ConfigNode::path() const { return data_->path; }
fs::path ConfigNode::folder() const { return data_->folder.empty() ? fs::path(".") : data_->folder; }

void ConfigNode::fail(const std::string& message) const {
  throw ConfigError(where() + ": " + (path().empty() ? message : path() + " " + message));
}

void ConfigNode::refuse_unknown_keys(const std::vector<std::string>& known) const {
  if (is_null()) return;
  if (!is_mapping()) must_be(*this, "a mapping");
  for (const auto& [key, value] : data_->entries) {
    if (std::find(known.begin(), known.end(), key) != known.end()) continue;
    const std::string kind = path().empty() ? other_kind(*this, known) : "";
    value.fail("is not a known key" + (kind.empty() ? nearest_hint(key, known) : "; the file is " + kind));
  }
}

std::string ConfigNode::to_yaml() const {
  std::ostringstream out;
  write_yaml(*this, out, 0, false);
  std::string text = out.str();
  if (text.empty() || text.back() != '\n') text += '\n';
  return text;
}
std::string ConfigNode::to_json() const {
  return to_json_value(*this).dump(2, ' ', false, nlohmann::json::error_handler_t::replace);
}

std::string nearest(std::string_view word, const std::vector<std::string>& known) {
  const auto closest = std::min_element(known.begin(), known.end(), [&](const auto& a, const auto& b) {
    return edit_distance(word, a) < edit_distance(word, b);
  });
  return closest == known.end() ? "" : *closest;
}

ConfigNode place(const ConfigNode& config, std::string_view dotted_path) {
  const auto dot = dotted_path.find('.');
  const std::string_view key = dotted_path.substr(0, dot);
  std::optional<ConfigNode> next;
  if (config.is_sequence()) {
    std::size_t i = 0;
    const auto [end, error] = std::from_chars(key.data(), key.data() + key.size(), i);
    if (error == std::errc() && end == key.data() + key.size() && i < config.size()) next = config[i];
  } else if (config.is_mapping()) {
    next = config.find(key);
  }
  if (next) return dot == std::string_view::npos ? *next : place(*next, dotted_path.substr(dot + 1));
  const auto& data = Access::data(config);
  // For a key that is missing at the top level, the first line of the file would be misleading.
  return Access::make({.file = data.file,
                       .line = data.path.empty() ? 0 : data.line,
                       .folder = data.folder,
                       .path = join(data.path, dotted_path)});
}

std::string shown(const ConfigNode& node) {
  const auto& data = Access::data(node);
  if (!node.is_scalar() && !is_short_list(node)) return kind_name(data.kind);
  std::ostringstream out;
  if (node.is_scalar())
    out << (data.is_quoted ? '"' + data.text + '"' : data.text);
  else
    write_yaml(node, out, 0, true);
  const std::string text = out.str();
  return text.size() > 60 ? text.substr(0, 60) + "..." : text;
}

void must_be(const ConfigNode& node, const std::string& wanted) {
  node.fail((node.path().empty() ? "holds " : "= ") + shown(node) + (Access::data(node).is_quoted ? " (a text)" : "") +
            ", must be " + wanted);
}

void fail_because(const ConfigNode& node, const std::string& reason) {
  const bool is_short = node.is_scalar() || is_short_list(node);
  throw ConfigError(node.where() + ": " + node.path() + (is_short ? " = " + shown(node) : "") + ": " + reason);
}

std::string nearest_hint(std::string_view word, const std::vector<std::string>& known) {
  const std::string close = nearest(word, known);
  const std::size_t distance = edit_distance(word, close), longer = std::max(word.size(), close.size());
  const bool is_near = distance < longer && distance <= std::max<std::size_t>(2, longer / 2);
  return close.empty() || !is_near ? "" : "; nearest: " + close;
}

std::string one_of(const std::vector<std::string>& allowed) {
  std::string text = "one of";
  for (const auto& value : allowed) text += (&value == &allowed.front() ? " " : ", ") + value;
  return text;
}

namespace {

// `path.plugin` = name: drops the old plugin's params, as an extending file does. Turns a bare plugin name into a slot.
ConfigNode with_plugin(const ConfigNode& slot, const ConfigNode& name) {
  const auto plugin = ConfigNode::mapping({{"plugin", name}});
  return slot.is_mapping() ? slot.merged(plugin) : plugin;
}

}  // namespace

ConfigNode apply_override(const ConfigNode& config, const std::string& assignment) {
  const auto equals = assignment.find('=');
  if (equals == std::string::npos || equals == 0) {
    throw ConfigError("--set " + assignment + ": must be key.path=value");
  }
  const std::string path = assignment.substr(0, equals);
  const std::string text = assignment.substr(equals + 1);
  Source named{"--set " + path, ".", false};
  parse_text(text, named);             // a syntax error does not name a key, so its message shows the path
  Source source{"--set", ".", false};  // later errors name the key themselves
  const ConfigNode value = parse_text(text, source);
  const auto last = path.rfind('.');
  if (last != std::string::npos && path.substr(last + 1) == "plugin") {
    const std::string slot_path = path.substr(0, last);
    const ConfigNode slot = place(config, slot_path);
    if (slot.is_mapping() || slot.is_scalar()) return config.with(slot_path, with_plugin(slot, value));
  }
  return config.with(path, value);
}

}  // namespace weft
