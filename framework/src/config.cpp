#include "weft/config.hpp"

#include <yaml-cpp/yaml.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <fstream>
#include <limits>
#include <nlohmann/json.hpp>
#include <sstream>

namespace weft {

struct ConfigNode::Data {
  Kind kind = Kind::null;
  std::string text;      // of a scalar
  bool is_quoted = false;  // a scalar that is a string whatever it looks like
  std::vector<std::pair<std::string, ConfigNode>> entries;
  std::vector<ConfigNode> items;
  std::string file;  // for messages; empty: made by the program
  int line = 0;
  std::filesystem::path folder;
  std::string path;
};

struct ConfigNodeAccess {
  static ConfigNode make(ConfigNode::Data data) {
    return ConfigNode(std::make_shared<const ConfigNode::Data>(std::move(data)));
  }
  static const ConfigNode::Data& data(const ConfigNode& node) { return *node.data_; }
};

namespace {

using Access = ConfigNodeAccess;
namespace fs = std::filesystem;

constexpr int kMaxDepth = 64;         // deeper YAML is an attack, not a configuration
constexpr std::size_t kMaxNodes = 1'000'000;  // YAML aliases can multiply without bound

std::string join(const std::string& path, std::string_view key) {
  return path.empty() ? std::string(key) : path + "." + std::string(key);
}

struct Source {
  std::string name;
  fs::path folder;
  std::size_t nodes = 0;
};

[[noreturn]] void fail_at(const std::string& file, int line, const std::string& message) {
  throw ConfigError(file + (line > 0 ? ":" + std::to_string(line) : "") + ": " + message);
}

ConfigNode convert(const YAML::Node& node, Source& source, const std::string& path, int depth) {
  const int line = node.Mark().line + 1;
  if (depth > kMaxDepth) fail_at(source.name, line, "nested deeper than " + std::to_string(kMaxDepth) + " levels");
  if (++source.nodes > kMaxNodes) fail_at(source.name, line, "more than a million nodes");
  ConfigNode::Kind kind = ConfigNode::Kind::null;
  std::string text;
  bool is_quoted = false;
  std::vector<std::pair<std::string, ConfigNode>> entries;
  std::vector<ConfigNode> items;
  if (node.IsScalar()) {
    kind = ConfigNode::Kind::scalar;
    text = node.Scalar();
    is_quoted = node.Tag() == "!";
  } else if (node.IsSequence()) {
    kind = ConfigNode::Kind::sequence;
    for (std::size_t i = 0; i < node.size(); ++i) {
      items.push_back(convert(node[i], source, join(path, std::to_string(i)), depth + 1));
    }
  } else if (node.IsMap()) {
    kind = ConfigNode::Kind::mapping;
    for (const auto& entry : node) {
      if (!entry.first.IsScalar()) fail_at(source.name, entry.first.Mark().line + 1, "a key must be a plain text");
      const std::string key = entry.first.Scalar();
      for (const auto& other : entries) {
        if (other.first == key) {
          fail_at(source.name, entry.first.Mark().line + 1, join(path, key) + " is given twice");
        }
      }
      entries.emplace_back(key, convert(entry.second, source, join(path, key), depth + 1));
    }
  }
  return Access::make({kind, std::move(text), is_quoted, std::move(entries), std::move(items), source.name, line,
                       source.folder, path});
}

ConfigNode parse_text(std::string_view text, Source& source) {
  try {
    const auto documents = YAML::LoadAll(std::string(text));
    if (documents.size() > 1) fail_at(source.name, 0, "holds several YAML documents, must be one");
    if (documents.empty()) return Access::make({.file = source.name, .folder = source.folder});
    return convert(documents[0], source, "", 0);
  } catch (const YAML::Exception& error) {
    fail_at(source.name, error.mark.line + 1, "not valid YAML: " + error.msg);
  }
}

ConfigNode load_file(const fs::path& file, std::vector<fs::path>& chain) {
  std::error_code ignored;
  const fs::path canonical = fs::weakly_canonical(file, ignored);
  if (std::find(chain.begin(), chain.end(), canonical) != chain.end()) {
    throw ConfigError(file.string() + ": extends itself through " + chain.back().string());
  }
  if (fs::is_directory(file, ignored)) throw ConfigError(file.string() + ": is a folder, must be a YAML file");
  std::ifstream stream(file, std::ios::binary);
  if (!stream) throw ConfigError(file.string() + ": cannot be read, must be a YAML file");
  std::ostringstream text;
  text << stream.rdbuf();
  Source source{file.string(), file.parent_path().empty() ? fs::path(".") : file.parent_path()};
  ConfigNode node = parse_text(text.str(), source);
  if (!node.is_mapping()) return node;
  const auto base = node.find("extends");
  if (!base) return node;
  chain.push_back(canonical);
  const ConfigNode parent = load_file(base->as_path(), chain);
  chain.pop_back();
  if (!parent.is_mapping()) base->fail("names a file that is no mapping");
  return parent.merged(node.without("extends"));
}

// The same subtree with every path re-based, after it moved in the tree.
ConfigNode repath(const ConfigNode& node, const std::string& path) {
  const auto& data = Access::data(node);
  auto copy = data;
  copy.path = path;
  for (auto& [key, value] : copy.entries) value = repath(value, join(path, key));
  for (std::size_t i = 0; i < copy.items.size(); ++i) copy.items[i] = repath(copy.items[i], join(path, std::to_string(i)));
  return Access::make(std::move(copy));
}

const char* kind_name(ConfigNode::Kind kind) {
  switch (kind) {
    case ConfigNode::Kind::null: return "nothing";
    case ConfigNode::Kind::scalar: return "a value";
    case ConfigNode::Kind::sequence: return "a list";
    case ConfigNode::Kind::mapping: return "a mapping";
  }
  return "";
}

// What a message shows of a node.
std::string shown(const ConfigNode& node) {
  const auto& data = Access::data(node);
  if (data.kind != ConfigNode::Kind::scalar) return kind_name(data.kind);
  return data.text.size() > 60 ? data.text.substr(0, 60) + "..." : data.text;
}

[[noreturn]] void wrong_type(const ConfigNode& node, const std::string& wanted) {
  node.fail("= " + shown(node) + ", must be " + wanted);
}

bool reads_as_plain_string(const std::string& text) {
  if (text.empty() || text == "~" || text == "null" || text == "true" || text == "false") return false;
  if (std::isspace(static_cast<unsigned char>(text.front())) || std::isspace(static_cast<unsigned char>(text.back()))) {
    return false;
  }
  return text.find_first_of(":#{}[],&*!|>'\"%@`\n\r\t\\") == std::string::npos && text.front() != '-' &&
         text.front() != '?';
}

bool looks_like_number(const std::string& text) {
  double value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  return error == std::errc() && end == text.data() + text.size();
}

std::string yaml_scalar(const ConfigNode& node) {
  const auto& data = Access::data(node);
  if (!data.is_quoted && (looks_like_number(data.text) || data.text == "true" || data.text == "false")) return data.text;
  if (reads_as_plain_string(data.text) && !(data.is_quoted && looks_like_number(data.text))) return data.text;
  return nlohmann::json(data.text).dump();  // a JSON string is a YAML string
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
  const std::string pad(static_cast<std::size_t>(indent), ' ');
  switch (data.kind) {
    case ConfigNode::Kind::null: out << "null"; break;
    case ConfigNode::Kind::scalar: out << yaml_scalar(node); break;
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
        out << pad << (reads_as_plain_string(key) ? key : nlohmann::json(key).dump()) << ':';
        write_value(value, out, indent);
      }
      break;
  }
}

nlohmann::ordered_json to_json_value(const ConfigNode& node) {
  const auto& data = Access::data(node);
  switch (data.kind) {
    case ConfigNode::Kind::null: return nullptr;
    case ConfigNode::Kind::scalar: {
      if (data.is_quoted) return data.text;
      if (data.text == "true" || data.text == "false") return data.text == "true";
      std::int64_t integer = 0;
      const char* end = data.text.data() + data.text.size();
      if (auto [p, e] = std::from_chars(data.text.data(), end, integer); e == std::errc() && p == end) return integer;
      if (looks_like_number(data.text) && std::isfinite(node.as_double())) return node.as_double();
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

}  // namespace

ConfigNode::ConfigNode() {
  static const auto null = std::make_shared<const Data>();
  data_ = null;
}
ConfigNode::ConfigNode(std::shared_ptr<const Data> data) : data_(std::move(data)) {}

ConfigNode ConfigNode::load(const fs::path& file) {
  std::vector<fs::path> chain;
  return repath(load_file(file, chain), "");
}

ConfigNode ConfigNode::parse(std::string_view text, const std::string& name, const fs::path& folder) {
  Source source{name, folder};
  return parse_text(text, source);
}

ConfigNode ConfigNode::scalar(std::string value) { return Access::make({.kind = Kind::scalar, .text = std::move(value)}); }
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
  if (!is_mapping()) wrong_type(*this, "a mapping");
  for (const auto& [name, value] : data_->entries) {
    if (name == key) return value;
  }
  return std::nullopt;
}

ConfigNode ConfigNode::at(std::string_view key) const {
  if (auto value = find(key)) return *value;
  const std::string close = nearest(key, keys());
  throw ConfigError(where() + ": " + join(path(), key) + " is missing" +
                    (close.empty() ? "" : " (nearest key there: " + close + ")"));
}

std::vector<std::string> ConfigNode::keys() const {
  std::vector<std::string> result;
  for (const auto& entry : data_->entries) result.push_back(entry.first);
  return result;
}

std::size_t ConfigNode::size() const { return is_sequence() ? data_->items.size() : data_->entries.size(); }

ConfigNode ConfigNode::operator[](std::size_t i) const {
  if (!is_sequence()) wrong_type(*this, "a list");
  if (i >= data_->items.size()) fail("has " + std::to_string(size()) + " items, wanted item " + std::to_string(i));
  return data_->items[i];
}

double ConfigNode::as_double() const {
  if (!is_scalar() || data_->is_quoted) wrong_type(*this, "a number");
  const std::string& text = data_->text;
  if (text == ".inf" || text == "+.inf") return std::numeric_limits<double>::infinity();
  if (text == "-.inf") return -std::numeric_limits<double>::infinity();
  const char* begin = text.data() + (text.starts_with('+') ? 1 : 0);
  double value = 0;
  const auto [end, error] = std::from_chars(begin, text.data() + text.size(), value);
  if (error != std::errc() || end != text.data() + text.size() || std::isnan(value)) wrong_type(*this, "a number");
  return value;
}

std::int64_t ConfigNode::as_int() const {
  if (!is_scalar() || data_->is_quoted) wrong_type(*this, "a whole number");
  const std::string& text = data_->text;
  std::int64_t value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc() || end != text.data() + text.size()) wrong_type(*this, "a whole number");
  return value;
}

bool ConfigNode::as_bool() const {
  if (is_scalar() && !data_->is_quoted) {
    if (data_->text == "true") return true;
    if (data_->text == "false") return false;
  }
  wrong_type(*this, "true or false");
}

std::string ConfigNode::as_string() const {
  if (!is_scalar()) wrong_type(*this, "a text");
  return data_->text;
}

fs::path ConfigNode::as_path() const {
  const fs::path path = as_string();
  return path.is_absolute() ? path : (folder() / path).lexically_normal();
}

ConfigNode ConfigNode::with(std::string_view dotted_path, const ConfigNode& value) const {
  const auto dot = dotted_path.find('.');
  const std::string key(dotted_path.substr(0, dot));
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
      fail("has items 0 to " + std::to_string(size() - 1) + ", not '" + key + "'");
    }
    copy.items[i] = changed(copy.items[i]);
    return Access::make(std::move(copy));
  }
  if (is_scalar()) wrong_type(*this, "a mapping with a key " + key);
  copy.kind = Kind::mapping;
  for (auto& [name, old] : copy.entries) {
    if (name == key) {
      old = changed(old);
      return Access::make(std::move(copy));
    }
  }
  auto blank = Data{.file = value.data_->file, .line = value.data_->line, .folder = value.data_->folder,
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
  // A changed plugin takes none of the old one's parameters along.
  const auto plugin = over.find("plugin");
  if (plugin && has("plugin") && at("plugin").data_->text != plugin->data_->text) return repath(over, path());
  for (const auto& [key, value] : over.data_->entries) {
    const auto old = std::find_if(copy.entries.begin(), copy.entries.end(), [&](const auto& e) { return e.first == key; });
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
  if (!is_mapping()) wrong_type(*this, "a mapping");
  for (const auto& [key, value] : data_->entries) {
    if (std::find(known.begin(), known.end(), key) != known.end()) continue;
    const std::string close = nearest(key, known);
    value.fail("is not a known key" + (close.empty() ? std::string() : "; nearest: " + close));
  }
}

std::string ConfigNode::to_yaml() const {
  std::ostringstream out;
  write_yaml(*this, out, 0, false);
  std::string text = out.str();
  if (text.empty() || text.back() != '\n') text += '\n';
  return text;
}
std::string ConfigNode::to_json() const { return to_json_value(*this).dump(2); }

std::string nearest(std::string_view word, const std::vector<std::string>& known) {
  std::string best;
  std::size_t best_distance = std::numeric_limits<std::size_t>::max();
  for (const auto& candidate : known) {
    // Levenshtein distance, one row at a time.
    std::vector<std::size_t> row(candidate.size() + 1);
    for (std::size_t j = 0; j < row.size(); ++j) row[j] = j;
    for (std::size_t i = 1; i <= word.size(); ++i) {
      std::size_t diagonal = row[0];
      row[0] = i;
      for (std::size_t j = 1; j < row.size(); ++j) {
        const std::size_t replaced = diagonal + (word[i - 1] == candidate[j - 1] ? 0 : 1);
        diagonal = row[j];
        row[j] = std::min({replaced, row[j] + 1, row[j - 1] + 1});
      }
    }
    if (row.back() < best_distance) {
      best_distance = row.back();
      best = candidate;
    }
  }
  return best;
}

ConfigNode apply_override(const ConfigNode& config, const std::string& assignment) {
  const auto equals = assignment.find('=');
  if (equals == std::string::npos || equals == 0) {
    throw ConfigError("--set " + assignment + ": must be key.path=value");
  }
  const std::string path = assignment.substr(0, equals);
  const ConfigNode value = ConfigNode::parse(assignment.substr(equals + 1), "--set " + path);
  // `--set predictor.plugin=x` must drop the old plugin's params, exactly as an extending file would.
  const auto last = path.rfind('.');
  if (last != std::string::npos && path.substr(last + 1) == "plugin") {
    std::optional<ConfigNode> parent = config;
    for (std::size_t begin = 0; parent && parent->is_mapping() && begin < last;) {
      const auto end = std::min(path.find('.', begin), last);
      parent = parent->find(path.substr(begin, end - begin));
      begin = end + 1;
    }
    if (parent && parent->is_mapping()) {
      const auto slot = ConfigNode::mapping({{"plugin", value}});
      return config.with(path.substr(0, last), parent->merged(slot));
    }
  }
  return config.with(path, value);
}

}  // namespace weft
