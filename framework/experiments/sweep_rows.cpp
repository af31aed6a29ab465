#include "experiments/sweep_rows.hpp"

#include <algorithm>
#include <cstdio>
#include <map>
#include <nlohmann/json.hpp>

#include "experiments/json_numbers.hpp"
#include "sdk/files.hpp"
#include "sdk/fingerprint.hpp"
#include "sdk/json_text.hpp"
#include "weft/error.hpp"

namespace weft {
namespace {

namespace fs = std::filesystem;
using nlohmann::ordered_json;

constexpr const char* kRowSchema = "weft sweep row 3";
constexpr const char* kRowSchema2 = "weft sweep row 2";         // times among the metrics, no identity
constexpr const char* kAblationSchema = "weft ablation row 1";  // the same without a payload

/// Seed and arm_hash() of a row's file: seed5-b4f2b3c9.json, or seed5-arm0-b4f2b3c9.json of earlier versions.
bool parse_row_name(const std::string& name, std::uint64_t& seed, std::string& arm) {
  unsigned long long number = 0;
  char hash[9] = {};
  int end = 0;
  const auto fits = [&](const char* pattern) {
    end = 0;
    return std::sscanf(name.c_str(), pattern, &number, hash, &end) == 2 && end == static_cast<int>(name.size());
  };
  if (!fits("seed%llu-%8[0-9a-f].json%n") && !fits("seed%llu-arm%*u-%8[0-9a-f].json%n")) return false;
  seed = number;
  arm = hash;
  return true;
}

ordered_json numbers_json(const SweepMetrics& numbers) {
  ordered_json json = ordered_json::object();
  for (const auto& [name, value] : numbers) json[name] = json_number(value);
  return json;
}

fs::path identity_file(const fs::path& folder, const std::string& hash) {
  return folder / "identities" / (hash + ".json");
}

ordered_json read_json(const fs::path& file) { return parse_json(whole_text(file)); }

SweepRow read_row(const fs::path& file, const SweepPlan& plan, std::size_t arm, std::uint64_t seed) {
  SweepRow row{arm, seed, "", {}, file};
  try {
    const ordered_json json = read_json(file);
    const auto schema = json.at("schema").get<std::string>();
    if (schema != kRowSchema && schema != kRowSchema2 && schema != kAblationSchema)
      throw ConfigError(file.string() + ": is not a row of a sweep");
    if (json.at("arm") != plan.arms[arm].name || json.at("seed") != seed)
      throw ConfigError(file.string() + ": is the row of another cell than its name says; remove it");
    row.failure = json.at("failure").get<std::string>();
    row.status = work_status_named(json.at("status").get<std::string>());
    if ((row.status == WorkStatus::done) != row.failure.empty())
      throw ConfigError(file.string() + ": is damaged: status and failure disagree");
    row.outcome.paired_by = json.at("paired_by").get<std::string>();
    for (const auto& [name, value] : json.at("metrics").items())
      row.outcome.metrics.emplace_back(name, number_of(value));
    if (const auto payload = json.find("payload"); payload != json.end())
      row.outcome.payload = {payload->at("schema").get<std::string>(), payload->at("value").dump()};
    if (schema == kRowSchema) {
      row.identity = json.at("identity").get<std::string>();
      if (fs::exists(times_file(file))) {
        const ordered_json times = read_json(times_file(file));
        for (const auto& [name, value] : times.items()) row.outcome.times.emplace_back(name, number_of(value));
      }
    }
  } catch (const nlohmann::json::exception& error) {
    throw ConfigError(file.string() + ": is damaged: " + error.what() + "; remove it to run its cell again");
  }
  return row;
}

/// The identities that rows of a folder name, each read once.
class Identities {
 public:
  explicit Identities(const fs::path& folder) : folder_(folder) {}
  const Identity& find(const std::string& hash) {
    const auto [place, is_new] = read_.try_emplace(hash);
    const fs::path file = identity_file(folder_, hash);
    if (is_new && !hash.empty() && fs::exists(file)) {
      const std::string text = whole_text(file);
      try {
        place->second = Identity::from_json(text);
      } catch (const ConfigError& error) {
        throw ConfigError(file.string() + ": " + error.what());
      }
    }
    return place->second;
  }

 private:
  fs::path folder_;
  std::map<std::string, Identity> read_;
};

}  // namespace

fs::path times_file(const fs::path& row) { return fs::path(row).replace_extension(".times.json"); }

std::string arm_hash(const SweepArm& arm) { return hex_digits(fnv1a(arm.name)).substr(0, 8); }

fs::path row_file(const SweepPlan& plan, const fs::path& folder, std::size_t arm, std::uint64_t seed) {
  return folder / "cells" / ("seed" + std::to_string(seed) + "-" + arm_hash(plan.arms[arm]) + ".json");
}

SweepFolder read_sweep(const SweepPlan& plan, const fs::path& folder, bool accept_changed) {
  SweepFolder found;
  if (!fs::is_directory(folder / "cells")) return found;
  std::map<std::string, std::size_t> arms;
  for (std::size_t a = 0; a < plan.arms.size(); ++a) arms[arm_hash(plan.arms[a])] = a;
  std::vector<fs::path> files;
  for (const auto& entry : fs::directory_iterator(folder / "cells")) files.push_back(entry.path());
  std::sort(files.begin(), files.end());
  Identities identities(folder);
  for (const auto& file : files) {
    std::uint64_t seed = 0;
    std::string hash;
    if (!parse_row_name(file.filename().string(), seed, hash)) continue;
    const auto arm = arms.find(hash);
    if (arm == arms.end() || std::find(plan.seeds.begin(), plan.seeds.end(), seed) == plan.seeds.end()) {
      found.others.push_back(file);
      continue;
    }
    SweepRow row = read_row(file, plan, arm->second, seed);
    const Identity& now = plan.arms[arm->second].identity;
    if (row.identity != now.hash()) {
      row.changes = now.changes_since(identities.find(row.identity));
      if (!accept_changed) throw ConfigError(changed_message(file.string(), row.changes));
    }
    const auto same = std::find_if(found.rows.begin(), found.rows.end(),
                                   [&](const SweepRow& other) { return other.arm == row.arm && other.seed == seed; });
    if (same == found.rows.end()) {
      found.rows.push_back(std::move(row));
    } else if (same->identity.empty()) {  // an earlier version's row was run again
      *same = std::move(row);
    }
  }
  return found;
}

std::vector<Identity> recorded_identities(const fs::path& folder) {
  std::vector<std::string> hashes;
  std::error_code ignored;
  for (const auto& entry : fs::directory_iterator(folder / "identities", ignored))
    if (entry.path().extension() == ".json") hashes.push_back(entry.path().stem().string());
  std::sort(hashes.begin(), hashes.end());
  Identities identities(folder);
  std::vector<Identity> all;
  for (const auto& hash : hashes) all.push_back(identities.find(hash));
  return all;
}

void write_identities(const SweepPlan& plan, const fs::path& folder) {
  for (const auto& arm : plan.arms) {
    const fs::path file = identity_file(folder, arm.identity.hash());
    if (!arm.identity.is_known() || fs::exists(file)) continue;
    fs::create_directories(file.parent_path());
    write_text(file, arm.identity.to_json());
  }
}

void write_row(const SweepPlan& plan, const SweepRow& row) {
  ordered_json json{{"schema", kRowSchema},
                    {"arm", plan.arms[row.arm].name},
                    {"seed", row.seed},
                    {"identity", row.identity},
                    {"status", to_string(row.status)},
                    {"failure", row.failure},
                    {"paired_by", row.outcome.paired_by},
                    {"metrics", numbers_json(row.outcome.metrics)}};
  const auto& payload = row.outcome.payload;
  if (!payload.schema.empty())
    json["payload"] = {{"schema", payload.schema}, {"value", ordered_json::parse(payload.json)}};
  write_text(times_file(row.file), text_of_json(numbers_json(row.outcome.times)));
  write_text(row.file, text_of_json(json));
}

std::string other_rows_text(const std::vector<fs::path>& others) {
  if (others.empty()) return "";
  constexpr std::size_t kMost = 10;
  std::string text = std::to_string(others.size()) + " rows of the folder are not asked for; they stay:";
  for (std::size_t i = 0; i < std::min(kMost, others.size()); ++i) text += " " + others[i].filename().string();
  return text + (others.size() > kMost ? " ..." : "");
}

std::string list_of_seeds(std::vector<std::uint64_t> seeds) {
  std::sort(seeds.begin(), seeds.end());
  std::string text;
  for (std::size_t i = 0; i < seeds.size();) {
    std::size_t end = i + 1;
    while (end < seeds.size() && seeds[end] == seeds[end - 1] + 1) ++end;
    text += (text.empty() ? "" : ", ") + std::to_string(seeds[i]);
    if (end - i > 1) text += "-" + std::to_string(seeds[end - 1]);
    i = end;
  }
  return text;
}

void add_mixed(ordered_json& result, const std::vector<SweepRow>& rows, std::optional<std::size_t> arm) {
  auto mixed = ordered_json::array();
  for (const auto& row : rows) {
    if (row.changes.empty() || (arm && row.arm != *arm)) continue;
    const auto same = std::find_if(mixed.begin(), mixed.end(),
                                   [&](const ordered_json& one) { return one["identity"] == row.identity; });
    if (same != mixed.end())
      (*same)["seeds"].push_back(row.seed);
    else
      mixed.push_back({{"identity", row.identity}, {"seeds", {row.seed}}, {"changes", row.changes}});
  }
  if (!mixed.empty()) result["mixed"] = mixed;
}

std::string mixed_rows_text(const SweepPlan& plan, const std::vector<SweepRow>& rows) {
  std::string text;
  for (std::size_t a = 0; a < plan.arms.size(); ++a) {
    std::map<std::string, std::vector<std::uint64_t>> seeds;  // by identity
    std::map<std::string, const std::vector<std::string>*> changes;
    std::size_t count = 0;
    for (const auto& row : rows) {
      if (row.arm != a) continue;
      ++count;
      if (row.changes.empty()) continue;
      seeds[row.identity].push_back(row.seed);
      changes[row.identity] = &row.changes;
    }
    for (const auto& [identity, of] : seeds) {
      text += "MIXED: " + std::to_string(of.size()) + " of the " + std::to_string(count) + " rows of " +
              plan.arms[a].name + " (seeds " + list_of_seeds(of) + ") belong to something else:\n";
      for (const auto& line : *changes[identity]) text += "  " + line + "\n";
    }
  }
  return text;
}

}  // namespace weft
