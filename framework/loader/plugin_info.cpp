#include "loader/plugin_info.hpp"

#include <elf.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <fstream>
#include <iterator>
#include <optional>
#include <string_view>

#include "sdk/files.hpp"
#include "weft/error.hpp"
#include "weft/optimiser.hpp"
#include "weft/plugin.hpp"
#include "weft/predictor.hpp"
#include "weft/simulator.hpp"
#include "weft/trajectory.hpp"

namespace weft {
namespace {

std::string text_of(const char* chars, std::size_t size) { return std::string(chars, strnlen(chars, size)); }

/// What a plugin of some kind must agree on with this weft.
struct KindInfo {
  int version;
  std::vector<TypeSize> crossing;
};
template <class Interface>
KindInfo kind_info() {
  constexpr auto types = crossing_types<Interface>();
  return {Interface::kVersion, {types.begin(), types.end()}};
}
std::optional<KindInfo> info_of(const std::string& kind) {
  if (kind == Simulator::kKind) return kind_info<Simulator>();
  if (kind == Predictor::kKind) return kind_info<Predictor>();
  if (kind == Trajectory::kKind) return kind_info<Trajectory>();
  if (kind == Optimiser::kKind) return kind_info<Optimiser>();
  return std::nullopt;
}

/// Letters, digits and `more`, at least one of them. Independent of the locale.
bool is_made_of(const std::string& text, const std::string& more) {
  return !text.empty() && std::all_of(text.begin(), text.end(), [&](char c) {
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') ||
           more.find(c) != std::string::npos;
  });
}

/// The bytes of a text that may be anything, for a message.
std::string printable(std::string text) {
  for (char& c : text)
    if (c < ' ' || c > '~') c = '?';
  return text;
}

/// Why a library with this tag is refused. @param abi bytes that may be anything.
std::string other_abi(const std::string& abi) {
  return "built as '" + printable(abi) +
         "', this weft is '" WEFT_ABI_TAG
         "'; build it with weft_add_plugin() and the same compiler, Eigen and alignment";
}

}  // namespace

const std::vector<std::string>& plugin_kinds() {
  static const std::vector<std::string> kinds = {Simulator::kKind, Predictor::kKind, Trajectory::kKind,
                                                 Optimiser::kKind};
  return kinds;
}

std::pair<std::string, std::string> named_by(const std::filesystem::path& file) {
  const std::string stem = file.stem().string();
  for (const auto& kind : plugin_kinds()) {
    const std::string prefix = "libweft_" + kind + "_";
    if (stem.starts_with(prefix) && stem.size() > prefix.size()) return {kind, stem.substr(prefix.size())};
  }
  return {};
}

std::string no_library(const std::filesystem::path& file) {
  if (const std::string other = no_file(file); !other.empty()) return other + ", must be a library";
  if (is_lfs_pointer_file(file)) return kLfsPointer;
  std::error_code unknown;
  const std::uintmax_t size = std::filesystem::file_size(file, unknown);
  std::ifstream stream(file, std::ios::binary);
  if (unknown || !stream) return "";  // dlopen() says why it cannot be read
  if (size == 0) return "is empty; copy it or build it again";
  Elf64_Ehdr head{};
  stream.read(reinterpret_cast<char*>(&head), sizeof(head));
  const std::size_t got = stream.gcount();
  if (got < SELFMAG || std::memcmp(head.e_ident, ELFMAG, SELFMAG) != 0)
    return "is no library: it does not begin like an ELF file";
  const bool is_ours = head.e_ident[EI_CLASS] == ELFCLASS64 && head.e_ident[EI_DATA] == ELFDATA2LSB;
  if (got > EI_DATA && !is_ours) return "";  // dlopen() refuses it
  // Linkers put the table of sections last, so a file that was cut lacks it.
  const std::uint64_t whole = std::max<std::uint64_t>(
      sizeof(head), got < sizeof(head) ? 0 : head.e_shoff + std::uint64_t{head.e_shnum} * head.e_shentsize);
  if (size >= whole) return "";
  return "was cut short: it has " + std::to_string(size) + " bytes, must have at least " + std::to_string(whole) +
         "; copy it or build it again";
}

std::string other_abi_in(const std::filesystem::path& file) {
  std::ifstream stream(file, std::ios::binary);
  const std::string bytes{std::istreambuf_iterator<char>(stream), {}};
  constexpr std::string_view kBegin("weftplu\0weft", 12);  // the magic, and how each tag begins
  const auto place = bytes.find(kBegin);
  if (place == std::string::npos || bytes.size() - place < sizeof(WeftPluginInfo)) return "";
  const std::string abi =
      text_of(bytes.data() + place + offsetof(WeftPluginInfo, abi_tag), sizeof(WeftPluginInfo::abi_tag));
  return abi == WEFT_ABI_TAG ? "" : other_abi(abi);
}

PluginEntry checked_plugin_info(const WeftPluginInfo& info, const std::filesystem::path& file) {
  const auto refuse = [&](const std::string& reason) { throw PluginError(file.string() + ": refused: " + reason); };
  if (text_of(info.magic, sizeof(info.magic)) != "weftplu") {
    refuse("weft_plugin_info does not start with 'weftplu'; rebuild it with this weft's headers");
  }
  const std::string abi = text_of(info.abi_tag, sizeof(info.abi_tag));
  if (abi != WEFT_ABI_TAG) refuse(other_abi(abi));
  PluginEntry entry;
  entry.file = file;
  entry.kind = text_of(info.kind, sizeof(info.kind));
  entry.name = text_of(info.name, sizeof(info.name));
  entry.version = text_of(info.version, sizeof(info.version));
  const auto ours = info_of(entry.kind);
  if (!ours) {
    refuse("is of kind '" + printable(entry.kind) + "', must be simulator, predictor, trajectory or optimiser");
  }
  if (info.interface_version != ours->version) {
    refuse("has interface version " + std::to_string(info.interface_version) + " of " + entry.kind +
           ", this weft has " + std::to_string(ours->version) +
           "; rebuild it with this weft's headers (MIGRATION.md says what changed)");
  }
  for (std::size_t i = 0; i < ours->crossing.size(); ++i) {
    const auto& [type, bytes] = ours->crossing[i];
    if (info.sizes[i] != bytes) {
      refuse("in it " + std::string(type) + " has " + std::to_string(info.sizes[i]) + " bytes, in this weft " +
             std::to_string(bytes) + "; rebuild it with this weft's headers and the options of weft_add_plugin()");
    }
  }
  if (entry.name.empty()) refuse("has no name");
  if (!is_made_of(entry.name, "_-")) {
    refuse("is called '" + printable(entry.name) + "', must be letters, digits, _ and -; change WEFT_PLUGIN(...)");
  }
  if (!is_made_of(entry.version, "._+-")) {
    refuse("has the version '" + printable(entry.version) +
           "', must be letters, digits, '.', '_', '+' and '-', such as 1.0.0; change WEFT_PLUGIN(...)");
  }
  if (const auto [kind, name] = named_by(file); !kind.empty() && (kind != entry.kind || name != entry.name)) {
    refuse("is named after " + kind + "/" + name + ", but WEFT_PLUGIN(...) in it says " + entry.kind + "/" +
           entry.name + "; give weft_add_plugin() and WEFT_PLUGIN the same kind and name");
  }
  return entry;
}

}  // namespace weft
