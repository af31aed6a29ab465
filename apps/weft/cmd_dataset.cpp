#include <atomic>
#include <cstdio>
#include <map>
#include <nlohmann/json.hpp>
#include <set>
#include <thread>

#include "commands.hpp"
#include "identity/identity.hpp"
#include "learning/dataset_files.hpp"
#include "learning/generate.hpp"
#include "loader/processors.hpp"
#include "options.hpp"
#include "output.hpp"
#include "sdk/json_text.hpp"
#include "weft/dataset.hpp"

namespace weft::app {
namespace {

namespace fs = std::filesystem;
using nlohmann::ordered_json;

int info(const Context& context, const std::string& folder) {
  const auto files = list_shards(folder);
  if (files.empty()) throw ConfigError(folder + ": holds no dataset (no shard-*.h5)");
  DatasetHeader header;
  std::int64_t examples = 0, failed = 0, released = 0, unsettled = 0, segments = 0;
  std::int64_t splits[3] = {};
  std::map<std::int64_t, std::int64_t> lengths;
  std::map<std::string, std::int64_t> failures;
  std::set<std::string> commits;
  std::map<std::string, std::int64_t> belonging;  // examples by what they belong to
  std::map<std::string, Identity> identities;
  std::uintmax_t bytes = 0;
  for (const auto& file : files) {
    const Shard shard = read_shard(file);
    header = shard.header;
    bytes += fs::file_size(file);
    const auto provenance = parse_json_if_valid(header.provenance);
    const bool named = provenance.is_object() && provenance.contains("commit") && provenance["commit"].is_string();
    commits.insert(named ? provenance["commit"].get<std::string>() : "unknown");
    const Identity identity = identity_in(header.provenance, file.string());
    identities[identity.hash()] = identity;
    belonging[identity.hash()] += std::ssize(shard.examples);
    for (const auto& e : shard.examples) {
      ++examples;
      ++splits[static_cast<int>(header.split(e.index))];
      if (e.failed()) {
        ++failed;
        ++failures[e.failure];
        continue;
      }
      released += e.released;
      unsettled += e.released && !e.settle.settled;
      segments += e.segments();
      ++lengths[e.segments()];
    }
  }
  ordered_json json{{"identity", header.identity}, {"seed", header.seed},   {"garment", header.garment_name},
                    {"vertices", header.vertices}, {"files", files.size()}, {"bytes", bytes},
                    {"examples", examples},        {"failed", failed},      {"released", released},
                    {"unsettled", unsettled},      {"segments", segments},  {"commits", commits}};
  for (std::size_t s = 0; s < 3; ++s) json["splits"][kSplitNames[s]] = splits[s];
  for (const auto& [length, count] : lengths) json["by_length"][std::to_string(length)] = count;
  const Identity last = identity_in(header.provenance, folder);
  json["mixed"] = ordered_json::array();
  for (const auto& [hash, count] : belonging) {
    if (hash == last.hash()) continue;
    json["mixed"].push_back(
        {{"identity", hash}, {"examples", count}, {"changes", last.changes_since(identities[hash])}});
  }
  if (context.json) {
    context.output() << json.dump(2) << '\n';
    return 0;
  }
  std::printf("dataset %s, seed %llu: %s, %td vertices\n", header.identity.c_str(),
              static_cast<unsigned long long>(header.seed), header.garment_name.c_str(), header.vertices);
  std::printf("%lld examples in %zu files (%.1f MB): %lld train, %lld validation, %lld test\n",
              static_cast<long long>(examples), files.size(), static_cast<double>(bytes) / 1e6,
              static_cast<long long>(splits[0]), static_cast<long long>(splits[1]), static_cast<long long>(splits[2]));
  std::printf("%lld released (%lld of them not settled in time), %lld failed\n", static_cast<long long>(released),
              static_cast<long long>(unsettled), static_cast<long long>(failed));
  std::printf("segments per example:");
  for (const auto& [length, count] : lengths)
    std::printf(" %lld:%lld", static_cast<long long>(length), static_cast<long long>(count));
  std::printf("\nmade by commit:");
  for (const auto& commit : commits) std::printf(" %s", commit.c_str());
  std::printf("\n");
  for (const auto& mixed : json["mixed"]) {
    std::printf("MIXED: %lld examples belong to something else than the last ones:\n",
                mixed["examples"].get<long long>());
    for (const auto& change : mixed["changes"]) std::printf("  %s\n", change.get<std::string>().c_str());
  }
  for (const auto& [text, count] : failures) std::printf("%6lld x %s\n", static_cast<long long>(count), text.c_str());
  return 0;
}

/// What a check found of one file.
struct CheckedFile {
  std::string problem, identity;
  std::vector<std::int64_t> examples;  ///< their numbers
};

CheckedFile check_file(const fs::path& file) {
  CheckedFile found;
  try {
    const Shard shard = read_shard(file);
    found.identity = shard.header.identity;
    for (const auto& e : shard.examples) found.examples.push_back(e.index);
  } catch (const std::exception& error) {
    found.problem = error.what();
  }
  return found;
}

/// Reads the files on several threads. @return what was found, in the order of the files.
std::vector<CheckedFile> check_files(const std::vector<fs::path>& files, std::size_t threads) {
  std::vector<CheckedFile> found(files.size());
  std::atomic<std::size_t> next = 0;
  const auto work = [&] {
    for (std::size_t i = next++; i < files.size(); i = next++) found[i] = check_file(files[i]);
  };
  std::vector<std::jthread> others;
  while (others.size() + 1 < std::min(threads, files.size())) others.emplace_back(work);
  work();
  others.clear();
  return found;
}

int check(const Context& context, const std::string& folder) {
  const auto files = list_shards(folder);
  if (files.empty()) throw ConfigError(folder + ": holds no dataset (no shard-*.h5)");
  const auto found =
      check_files(files, static_cast<std::size_t>(context.jobs > 0 ? context.jobs : allowed_processors()));
  std::int64_t bad = 0, examples = 0;
  std::string identity;
  std::set<std::int64_t> seen;
  auto problems = ordered_json::array();
  for (std::size_t i = 0; i < files.size(); ++i) {
    std::string problem = found[i].problem;
    if (problem.empty()) {
      if (identity.empty()) identity = found[i].identity;
      if (found[i].identity != identity)
        problem = files[i].string() + ": belongs to another dataset than the first file";
    }
    for (const std::int64_t index : found[i].examples) {
      ++examples;
      if (!seen.insert(index).second)
        problem = files[i].string() + ": example " + std::to_string(index) +
                  " is also in another file; `weft dataset merge` removes duplicates";
    }
    if (problem.empty()) continue;
    ++bad;
    problems.push_back(problem);
    if (!context.json) std::fprintf(stderr, "%s\n", problem.c_str());
  }
  if (context.json) {
    context.output()
        << ordered_json{{"files", files.size()}, {"examples", examples}, {"bad", bad}, {"problems", problems}}.dump(2)
        << '\n';
  }
  context.say(std::to_string(files.size()) + " files, " + std::to_string(examples) + " examples, " +
              std::to_string(bad) + " files bad");
  return bad == 0 ? 0 : 1;
}

/// For work that the user may stop, which then leaves nothing.
Cancelled until_stopped(const Context& context) {
  Context::catch_signals();
  return [flag = context.cancel_flag()] { return flag->load(); };
}

int merge(const Context& context, const std::vector<std::string>& folders) {
  if (context.out.empty()) throw ConfigError("weft dataset merge: --out FOLDER is required");
  const Cancelled cancelled = until_stopped(context);
  const PlacedFolder placed(context.out);
  const std::int64_t files = merge_datasets({folders.begin(), folders.end()}, context.out, cancelled);
  context.say(std::to_string(files) + " files in " + context.out);
  return 0;
}

int split(const Context& context, const std::string& folder) {
  if (context.out.empty()) throw ConfigError("weft dataset split: --out FOLDER is required");
  const Cancelled cancelled = until_stopped(context);
  const PlacedFolder placed(context.out);
  const auto counts = split_dataset(folder, context.out, cancelled);
  if (context.json) {
    context.output() << ordered_json{{"train", counts[0]}, {"validation", counts[1]}, {"test", counts[2]}}.dump(2)
                     << '\n';
  }
  context.say(std::to_string(counts[0]) + " train, " + std::to_string(counts[1]) + " validation, " +
              std::to_string(counts[2]) + " test examples in " + context.out);
  return 0;
}

}  // namespace

void register_dataset(CLI::App& app, Context& context) {
  CLI::App* command = app.add_subcommand("dataset", "Look at, check, merge or split the examples of `weft generate`");
  command->require_subcommand(1);
  const auto add = [&](const char* name, const char* text, int (*run)(const Context&, const std::string&)) {
    CLI::App* sub = command->add_subcommand(name, text);
    add_output_options(*sub, context);
    auto folder = std::make_shared<std::string>();
    sub->add_option("folder", *folder, "Folder of shard-*.h5")->required();
    sub->callback(
        [&context, folder, run] { context.action = [&context, folder, run] { return run(context, *folder); }; });
  };
  add("info", "Counts, splits, lengths, failures", info);
  add("check", "Read every file whole; exit code 1 if one is damaged", check);
  add("split", "Write train, validation and test as datasets of their own", split);
  CLI::App* sub = command->add_subcommand("merge", "Put the parts made on several machines into one folder");
  add_output_options(*sub, context);
  auto folders = std::make_shared<std::vector<std::string>>();
  sub->add_option("folders", *folders, "Folders of one dataset")->required();
  sub->callback([&context, folders] { context.action = [&context, folders] { return merge(context, *folders); }; });
}

}  // namespace weft::app
