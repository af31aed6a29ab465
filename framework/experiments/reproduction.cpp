#include "experiments/reproduction.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <functional>
#include <iterator>
#include <set>

#include "experiments/sweep_rows.hpp"
#include "identity/identity.hpp"
#include "identity/sha256.hpp"
#include "processes/shell_word.hpp"
#include "report/measurement.hpp"
#include "sdk/files.hpp"
#include "sdk/json_text.hpp"
#include "sdk/listed.hpp"
#include "weft/config.hpp"

namespace weft {
namespace {

namespace fs = std::filesystem;
using nlohmann::ordered_json;

std::vector<std::string> sizes_of(const ConfigNode& step) {
  std::vector<std::string> sizes;
  for (const char* size : kReproductionSizes)
    if (step.has(size)) sizes.emplace_back(size);
  return sizes;
}

/// Names of parts and steps become names of folders and files.
void check_name(const ConfigNode& at, const std::string& name) {
  const bool is_good = !name.empty() && name.front() != '-' &&
                       std::all_of(name.begin(), name.end(),
                                   [](unsigned char c) { return std::isalnum(c) != 0 || c == '-' || c == '_'; });
  if (!is_good) at.fail("has the name '" + name + "', which must be of letters, digits, - and _");
}

ReproductionStep read_step(const ConfigNode& node, const std::string& part, const std::string& name,
                           const std::string& size) {
  ReproductionStep step{part, name, {}, {}};
  check_name(node, name);
  read_params(node, step.params);
  step.size = size == "quick" ? step.params.quick : size == "standard" ? step.params.standard : step.params.full;
  if (step.params.results.empty() == step.params.config.empty()) node.fail("must have either config or results");
  if (sizes_of(node).empty()) node.fail("must have one of the sizes quick, standard, full");
  if (step.params.command == "run" && step.size.cases > 1 && step.params.seed < 0)
    node.fail("must have a seed, since it has several runs");
  return step;
}

/// The steps that a step needs.
std::vector<std::string> needs_of(const ReproductionStep& step) {
  std::vector<std::string> needs;
  for (const auto& one : {step.params.results, step.params.examples})
    if (!one.empty()) needs.push_back(one);
  return needs;
}

void check_needs(const Reproduction& all, const ConfigNode& steps, const ReproductionStep& step) {
  for (const auto& label : needs_of(step)) {
    const ReproductionStep* found = nullptr;
    std::vector<std::string> labels;
    for (const auto& part : all.parts)
      for (const auto& one : part.steps) {
        labels.push_back(one.label());
        if (one.label() == label) found = &one;
      }
    const ConfigNode node = steps.at(step.name).at(label == step.params.results ? "results" : "examples");
    if (found == nullptr)
      node.fail("= " + label + ", which is no step of size " + all.size + nearest_hint(label, labels));
    // So no step needs itself.
    if (!found->params.results.empty()) node.fail("= " + label + ", which has no results of its own");
    if (label == step.params.examples && (found->params.command != "generate" || !found->params.examples.empty()))
      node.fail("= " + label + ", which is no step that makes examples");
  }
}

void add_sets(std::vector<std::string>& words, const ConfigNode& set) {
  if (set.is_null()) return;
  for (const auto& key : set.keys()) {
    words.emplace_back("--set");
    const ConfigNode value = set.at(key);
    // One line, which is YAML too.
    words.push_back(key + "=" + (value.is_scalar() ? value.as_string() : parse_json(value.to_json()).dump()));
  }
}

/// The sessions of a step of runs: one row each.
PaperTable table_of_runs(const std::vector<ReproductionCommand>& commands) {
  PaperTable table{
      "runs",
      "Sessions: the mean distance from the goal that the default control leaves, and the mean and largest one that the "
      "session leaves",
      {{"seed", "seed", "", 0},
       {"segments", "segments", "", 0},
       {"default_error", "default control, mm", "mm", 1},
       {"error", "session, mm", "mm", 1},
       {"max_error", "session, largest, mm", "mm", 1},
       {"iou", "IoU", "", 3}},
      {},
      0};
  for (const auto& command : commands) {
    if (command.words.front() != "run") continue;
    const auto summary = parse_json(whole_text(command.folder / "summary.json"));
    const auto seed = parse_json(whole_text(command.folder / "provenance.json")).at("seed");
    table.rows.push_back({seed, summary.at("segments"), summary.at("default_error_mm"), summary.at("error_mm"),
                          summary.at("max_error_mm"), summary.at("silhouette_iou")});
  }
  return table;
}

/// The tables of a benchmark, which keeps them as a measurement does.
std::vector<PaperTable> tables_of_benchmark(const fs::path& folder) {
  std::vector<PaperTable> tables;
  const auto speed = parse_json(whole_text(folder / "speed.json"));
  for (const auto& json : speed.at("tables")) {
    tables.push_back(table_of_json(json));
    std::replace(tables.back().label.begin(), tables.back().label.end(), '/', '-');
  }
  return tables;
}

/// How many cases of a result failed. @throws ConfigError for a result that is not complete.
std::int64_t failed_cases(const fs::path& folder) {
  std::int64_t failed = 0;
  const auto count = [&](const ordered_json& list) {
    failed += std::count_if(list.begin(), list.end(), [](const auto& one) { return one.contains("failed"); });
  };
  for (const char* name : {"ablation.json", "planning.json", "estimation.json"}) {
    const fs::path file = folder / name;
    if (!fs::exists(file)) continue;
    const auto json = parse_json(whole_text(file));
    if (!json.value("complete", true)) throw ConfigError(file.string() + ": is not complete");
    for (const auto& arm : json.value("arms", ordered_json::array()))
      failed += static_cast<std::int64_t>(arm.at("failed").size());
    count(json.value("cases", ordered_json::array()));
  }
  return failed;
}

/// What all results of a folder belong to.
std::vector<Identity> identities_in(const fs::path& folder) {
  std::vector<Identity> all = recorded_identities(folder);
  if (const fs::path file = folder / "provenance.json"; fs::exists(file)) all.push_back(read_identity(file));
  std::error_code none;
  for (const auto& entry : fs::directory_iterator(folder, none))  // of the sources of cases
    if (fs::exists(entry.path() / "identities"))
      for (auto& one : recorded_identities(entry.path())) all.push_back(std::move(one));
  return all;
}

/// Adds the hashes of the models in an identity: the values of keys `model`.
void add_models(const ordered_json& json, std::set<std::string>& hashes) {
  const std::string prefix = "sha256 ";
  for (const auto& [key, value] : json.items()) {
    if (key == "model" && value.is_string() && value.get<std::string>().starts_with(prefix))
      hashes.insert(value.get<std::string>().substr(prefix.size()));
    else if (value.is_structured())
      add_models(value, hashes);
  }
}

/// Whether an identity is that of a physics experiment. It names the model of its task, but nothing in it plans.
bool is_of_physics(const ordered_json& identity) {
  const auto& config = identity.at("config");
  return std::any_of(config.items().begin(), config.items().end(),
                     [](const auto& item) { return item.key().starts_with("physics."); });
}

/// The models of a folder: name by hash.
std::map<std::string, std::string> models_in(const fs::path& folder) {
  std::map<std::string, std::string> models;
  std::error_code none;
  for (const auto& entry : fs::directory_iterator(folder, none))
    if (entry.path().extension() == ".h5") models[sha256_of_file(entry.path())] = entry.path().filename().string();
  return models;
}

bool is_wanted(const ReproductionStep& step, bool is_session_ablation, const std::string& label) {
  const auto& tables = step.params.tables;
  if (!tables.empty()) return std::find(tables.begin(), tables.end(), label) != tables.end();
  return !is_session_ablation || label == "ablation-error_mm";
}

/// The tables of a step. @param source the step that has the results.
void add_tables(const ReproductionStep& step, const ReproductionStep& source, const fs::path& out,
                ordered_json& tables) {
  if (source.params.command == "generate") return;
  const fs::path folder = out / source.part / source.name;
  const std::string& command = source.params.command;
  std::vector<PaperTable> found = command == "run"         ? std::vector{table_of_runs(commands_of(source, out))}
                                  : command == "benchmark" ? tables_of_benchmark(folder)
                                                           : paper_tables(folder);
  const bool is_session_ablation =
      std::any_of(found.begin(), found.end(), [](const auto& table) { return table.label == "ablation-error_mm"; });
  std::set<std::string> missing(step.params.tables.begin(), step.params.tables.end());
  std::vector<std::string> labels;
  for (auto& table : found) {
    labels.push_back(table.label);
    missing.erase(table.label);
    if (!is_wanted(step, is_session_ablation, table.label)) continue;
    table.label = step.name + "/" + table.label;
    tables.push_back(json_of_table(table));
  }
  if (!missing.empty())
    throw ConfigError("step " + step.label() + " has no table " + *missing.begin() + ", must be " + one_of(labels) +
                      nearest_hint(*missing.begin(), labels));
}

/// A file as it is named in a folder; whole if it lies elsewhere. @param folder empty: the working folder.
std::string name_from(const fs::path& folder, const fs::path& file) {
  const fs::path whole = fs::absolute(file).lexically_normal();
  const fs::path near = whole.lexically_relative(fs::absolute(folder.empty() ? "." : folder).lexically_normal());
  return near.empty() || *near.begin() == ".." ? whole.string() : near.string();
}

/// The step that has the results which a step shows.
const ReproductionStep& source_of(const Reproduction& all, const ReproductionStep& step) {
  return step.params.results.empty() ? step : all.step(step.params.results);
}

}  // namespace

std::vector<ParamInfo> describe_reproduction() {
  std::vector<ParamInfo> all;
  const auto add = [&](const std::string& prefix, const std::vector<ParamInfo>& params, const std::string& below,
                       const std::function<void()>& what) {
    for (ParamInfo info : params) {
      if (info.name == below) {
        what();
        continue;
      }
      info.name = prefix + info.name;
      all.push_back(std::move(info));
    }
  };
  add("", describe_params<ReproduceParams>(), "parts", [&] {
    add("parts.PART.", describe_params<PartParams>(), "steps",
        [&] { add("parts.PART.steps.STEP.", describe_params<StepParams>(), "", [] {}); });
  });
  return all;
}

const ReproductionPart* Reproduction::part(const std::string& name) const {
  const auto found = std::find_if(parts.begin(), parts.end(), [&](const auto& one) { return one.name == name; });
  return found == parts.end() ? nullptr : &*found;
}

const ReproductionStep& Reproduction::step(const std::string& label) const {
  for (const auto& part : parts)
    for (const auto& one : part.steps)
      if (one.label() == label) return one;
  throw Error("no step " + label);
}

Reproduction read_reproduction(const ConfigNode& config, const std::string& size) {
  ReproduceParams params;
  read_params(config, params);
  Reproduction all;
  all.size = size;
  all.root = (fs::absolute(config.folder()) / "..").lexically_normal();
  all.models = params.models.empty() ? config.folder() / "models" : params.models;
  if (!params.parts.is_mapping()) config.fail("must have parts: a mapping");
  std::vector<ConfigNode> steps;
  for (const auto& name : params.parts.keys()) {
    const ConfigNode node = params.parts.at(name);
    check_name(node, name);
    PartParams part;
    read_params(node, part);
    if (!part.steps.is_mapping()) node.fail("must have steps: a mapping");
    all.parts.push_back({name, part.title.empty() ? name : part.title, part.about, {}, {}});
    std::set<std::string> sizes;
    for (const auto& step : part.steps.keys()) {
      const auto read = read_step(part.steps.at(step), name, step, size);
      for (const auto& one : sizes_of(part.steps.at(step))) sizes.insert(one);
      if (part.steps.at(step).has(size)) all.parts.back().steps.push_back(read);
    }
    for (const char* one : kReproductionSizes)
      if (sizes.contains(one)) all.parts.back().sizes.emplace_back(one);
    steps.push_back(part.steps);
  }
  for (std::size_t i = 0; i < all.parts.size(); ++i)
    for (const auto& step : all.parts[i].steps) check_needs(all, steps[i], step);
  return all;
}

std::vector<const ReproductionPart*> chosen_parts(const Reproduction& all, const std::vector<std::string>& names) {
  std::vector<std::string> known;
  for (const auto& part : all.parts) known.push_back(part.name);
  for (const auto& name : names) {
    const ReproductionPart* part = all.part(name);
    if (part == nullptr)
      throw ConfigError("'" + name + "' is no part, must be " + one_of(known) + nearest_hint(name, known));
    if (part->steps.empty()) {
      std::string sizes;
      for (const auto& size : part->sizes) sizes += (sizes.empty() ? "--" : ", --") + size;
      throw ConfigError("part " + name + " is left out by --" + all.size + "; it is in " + sizes);
    }
  }
  std::vector<const ReproductionPart*> chosen;
  for (const auto& part : all.parts) {
    const bool is_named = std::find(names.begin(), names.end(), part.name) != names.end();
    if (!part.steps.empty() && (names.empty() || is_named)) chosen.push_back(&part);
  }
  if (chosen.empty()) throw ConfigError("--" + all.size + " has no part");
  return chosen;
}

std::vector<const ReproductionStep*> steps_of(const Reproduction& all,
                                              const std::vector<const ReproductionPart*>& parts) {
  std::vector<const ReproductionStep*> steps;
  const std::function<void(const ReproductionStep&)> add = [&](const ReproductionStep& step) {
    for (const auto& label : needs_of(step)) add(all.step(label));
    if (std::find(steps.begin(), steps.end(), &step) == steps.end()) steps.push_back(&step);
  };
  for (const auto* part : parts)
    for (const auto& step : part->steps) add(step);
  return steps;
}

std::string expected_time(const std::vector<const ReproductionStep*>& steps, int processors) {
  double cpu = 0.0, wall = 0.0;
  std::vector<std::string> unknown;
  for (const auto* step : steps) {
    const double minutes = step->size.cpu_minutes;
    // A benchmark does one thing at a time, mostly on one processor.
    const int used = step->params.command == "benchmark" ? 1 : processors;
    cpu += minutes;
    wall += minutes / used;
    if (minutes == 0.0 && step->params.results.empty()) unknown.push_back(step->label());
  }
  if (cpu == 0.0) return "";
  const auto text = [](double minutes) {
    char number[40];
    const double whole = std::ceil(minutes);
    if (minutes < 60.0)
      std::snprintf(number, sizeof number, "%.0f minute%s", whole, whole == 1.0 ? "" : "s");
    else
      std::snprintf(number, sizeof number, "%.1f hours", minutes / 60.0);
    return std::string(number);
  };
  return "about " + text(cpu) + " of CPU time, " + text(wall) + " on " + std::to_string(processors) +
         (processors == 1 ? " processor" : " processors") +
         (unknown.empty() ? "" : ", without " + listed(unknown) + ", whose time is unknown");
}

std::vector<ReproductionCommand> commands_of(const ReproductionStep& step, const fs::path& out, const fs::path& root) {
  const auto& params = step.params;
  if (!params.results.empty()) return {};
  const fs::path folder = out / step.part / step.name;
  const bool is_run = params.command == "run", is_physics = params.command == "evaluate physics";
  const auto after_sets = [&](std::vector<std::string>& words, const fs::path& target) {
    add_sets(words, params.set);
    add_sets(words, step.size.set);
    words.insert(words.end(), {"--out", target.string()});
  };
  std::vector<std::string> words;
  const auto space = params.command.find(' ');
  words.push_back(params.command.substr(0, space));
  if (space != std::string::npos) words.push_back(params.command.substr(space + 1));
  const bool is_benchmark = params.command == "benchmark";
  if (is_benchmark) words.emplace_back("--config");
  words.push_back(name_from(root, params.config));
  for (const auto* options : {&params.options, &step.size.options})
    words.insert(words.end(), options->begin(), options->end());
  if (is_run) {
    std::vector<ReproductionCommand> commands;
    for (std::int64_t i = 0; i < std::max<std::int64_t>(1, step.size.cases); ++i) {
      std::vector<std::string> run = words;
      const std::string seed = params.seed < 0 ? "config" : std::to_string(params.seed + i);
      const fs::path session = folder / ("seed-" + seed);
      if (params.seed >= 0) run.insert(run.end(), {"--seed", seed});
      after_sets(run, session);
      commands.push_back({run, session, false});
      if (params.stills.empty()) continue;
      const std::string frames = listed(params.stills, ",");
      const fs::path stills = session / "stills";
      std::vector<std::string> export_words = {"export", session.string(), "--png", frames};
      if (!params.still_size.empty()) export_words.insert(export_words.end(), {"--size", params.still_size});
      export_words.insert(export_words.end(),
                          {"--out", params.stills.size() == 1 ? (stills / "frame.png").string() : stills.string()});
      commands.push_back({export_words, stills, false});
    }
    return commands;
  }
  const std::string count = std::to_string(step.size.cases), seed = std::to_string(params.seed);
  const bool has_count = step.size.cases > 0, has_seed = params.seed >= 0;
  if (is_physics) {
    if (has_seed) words.insert(words.end(), {"--set", "physics.folds.first_seed=" + seed});
    if (has_count) words.insert(words.end(), {"--set", "physics.folds.count=" + count});
  } else {
    if (has_seed) words.insert(words.end(), {"--seed", seed});
    if (has_count && params.command == "ablate") words.insert(words.end(), {"--set", "seeds.count=" + count});
    if (has_count && is_benchmark) words.insert(words.end(), {"--repeats", count});
    if (has_count && params.command == "generate") words.insert(words.end(), {"--examples", count});
    if (has_count && params.command == "evaluate prediction")
      words.insert(words.end(), {"--set", "evaluation.max_examples=" + count});
    if (has_count && (params.command == "evaluate planning" || params.command == "evaluate estimation"))
      words.insert(words.end(), {"--cases", count});
  }
  if (!params.examples.empty()) words.insert(words.end(), {"--data", (out / params.examples).string()});
  after_sets(words, folder);
  return {{words, folder, !is_benchmark}};
}

std::string typed(const std::vector<std::string>& words) {
  std::string line = "weft";
  for (const auto& word : words) line += " " + shell_word(word);
  return line;
}

std::vector<ReproductionFigure> figures_of(const Reproduction& all, const ReproductionPart& part, const fs::path& out) {
  std::vector<ReproductionFigure> figures;
  for (const auto& step : part.steps) {
    const ReproductionStep& source = source_of(all, step);
    const fs::path folder = out / source.part / source.name;
    const auto add = [&](const fs::path& from, const std::string& title, const std::string& session = "") {
      if (!fs::exists(from)) return;
      const std::string name = part.name + "-" + step.name + "-" + (session.empty() ? "" : session + "-") + title;
      figures.push_back({from, step.name, title, "figures/" + name + from.extension().string(), session});
    };
    for (const auto& name : step.params.figures) add(folder / "figures" / (name + ".svg"), name);
    for (const auto& command : commands_of(source, out)) {
      if (command.words.front() != "export") continue;
      std::vector<fs::path> stills;
      std::error_code none;
      for (const auto& entry : fs::directory_iterator(command.folder, none)) stills.push_back(entry.path());
      std::sort(stills.begin(), stills.end());
      for (const auto& still : stills)
        add(still, still.stem().string(), command.folder.parent_path().filename().string());
    }
  }
  return figures;
}

ordered_json measurement_of(const Reproduction& all, const ReproductionPart& part, const fs::path& out,
                            const Origin& origin) {
  ordered_json steps = ordered_json::array(), tables = ordered_json::array(), figures = ordered_json::array();
  std::set<std::string> hashes;
  for (const auto& step : part.steps) {
    const ReproductionStep& source = source_of(all, step);
    add_tables(step, source, out, tables);
    const fs::path folder = out / source.part / source.name;
    ordered_json commands = ordered_json::array(), identities = ordered_json::array();
    std::set<std::string> known;
    // Where the results lay says nothing about them.
    for (const auto& command : commands_of(source, "results/reproduce-" + all.size, all.root))
      commands.push_back(typed(command.words));
    std::vector<fs::path> folders;
    for (const auto& command : commands_of(source, out)) folders.push_back(command.folder);
    for (const auto& one : folders)
      for (const auto& identity : identities_in(one)) {
        if (!identity.is_known() || !known.insert(identity.hash()).second) continue;
        identities.push_back(identity.hash());
        const auto belongs_to = parse_json(identity.to_json());
        if (!is_of_physics(belongs_to)) add_models(belongs_to, hashes);
      }
    // The other commands draw their cases from one seed.
    const auto& command = source.params.command;
    const bool counts_up = command == "ablate" || command == "run" || command == "evaluate physics";
    const std::int64_t count = counts_up ? std::max<std::int64_t>(1, source.size.cases) : 1;
    const ordered_json seeds =
        source.params.seed < 0 ? ordered_json() : ordered_json{{"first", source.params.seed}, {"count", count}};
    steps.push_back({{"name", step.name},
                     {"title", step.params.title},
                     {"commands", commands},
                     {"seeds", seeds},
                     {"failed", failed_cases(folder)},
                     {"identities", identities}});
  }
  if (tables.empty()) return nullptr;
  for (const auto& figure : figures_of(all, part, out)) {
    figures.push_back({{"step", figure.step}, {"title", figure.title}, {"file", figure.file}});
    if (!figure.session.empty()) figures.back()["session"] = figure.session;
  }
  ordered_json models = ordered_json::array();
  const auto known = models_in(all.models);
  for (const auto& hash : hashes) {
    const auto found = known.find(hash);
    if (found == known.end())
      throw ConfigError("it was measured with a model that is not in " + all.models.string() + ": sha256 " + hash);
    models.push_back({{"file", found->second}, {"sha256", hash}});
  }
  return {{"schema", kMeasurementSchema},
          {"name", part.name},
          {"title", part.title},
          {"about", part.about},
          {"size", all.size},
          {"command", "weft reproduce " + part.name + " --" + all.size},
          {"weft", WEFT_VERSION},
          {"commit", origin.commit},
          {"date", origin.date},
          {"models", models},
          {"machine", {{"processor", origin.processor}, {"cores", origin.cores}}},
          {"steps", steps},
          {"figures", figures},
          {"tables", tables}};
}

std::vector<std::string> other_models(const fs::path& folder, const fs::path& models) {
  const auto known = models_in(models);
  std::vector<std::string> others;
  for (const auto& [name, json] : read_measurements(folder))
    for (const auto& model : json.at("models"))
      if (const auto hash = model.at("sha256").get<std::string>(); !known.contains(hash))
        others.push_back((folder / (name + ".json")).string() + ": was measured with " +
                         model.at("file").get<std::string>() + " (sha256 " + hash.substr(0, 12) +
                         "), which is no model of " + models.string());
  return others;
}

}  // namespace weft
