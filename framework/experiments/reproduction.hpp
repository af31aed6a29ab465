#pragma once
#include <cstdint>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "weft/params.hpp"

/// `weft reproduce`: which commands measure a part of the results, and the measurement that their results become.
namespace weft {

/// What one size takes of a step.
struct StepSizeParams {
  std::int64_t cases = 0;
  double cpu_minutes = 0.0;
  std::vector<std::string> options;
  ConfigNode set;

  template <class Visitor>
  void visit(Visitor& v) {
    v("cases", cases, range(0, 1000000),
      "Number of cases, seeds, examples, runs, random folds, or repeats, as the command has them; 0: that of its config.");
    v("cpu_minutes", cpu_minutes, range(0, 1e6, "min"),
      "CPU time of one processor that the step takes, as it was last measured or estimated; 0: unknown. Their sum is printed.");
    v("options", options, "Further words of the command.");
    v("set", set, "Keys of the command's config and their values, dotted: {planning.instances: 8}.");
  }
};

struct StepParams {
  std::string title, command = "ablate", examples, results, still_size;
  std::filesystem::path config;
  std::int64_t seed = -1;
  std::vector<std::string> options, tables, figures, stills;
  ConfigNode set;
  StepSizeParams quick, standard, full;

  template <class Visitor>
  void visit(Visitor& v) {
    v("title", title, "Heading of the step on the part's page; empty: none.");
    v("command", command,
      choice({"ablate", "evaluate planning", "evaluate estimation", "evaluate prediction", "evaluate physics",
              "generate", "run", "benchmark"}),
      "The command of weft that the step is.");
    v("config", config, "The config file of the command.");
    v("results", results, "In place of a command: PART/STEP, whose results this step shows other tables of.");
    v("examples", examples,
      "PART/STEP: a step with command generate, which makes the examples that this command reads.");
    v("seed", seed, range(-1, 9e15), "The first seed; -1: that of the config.");
    v("options", options, "Further words of the command, in every size; of benchmark also its parts.");
    v("set", set, "Keys of the command's config and their values, dotted, in every size.");
    v("tables", tables,
      "Names of the tables of the page; empty: all, but of an ablation of sessions ablation-error_mm.");
    v("figures", figures, "Names of the figures of the page, where figures are drawn.");
    v("stills", stills, "Of runs: the frames of which there are pictures, as in `weft export --png`.");
    v("still_size", still_size, "Their size in pixels, as in `weft export --size`; empty: the default of that.");
    v.group("quick", quick, "With --quick; a size that is not given leaves the step out.");
    v.group("standard", standard, "With --standard.");
    v.group("full", full, "With --full.");
  }
};

struct PartParams {
  std::string title, about;
  ConfigNode steps;

  template <class Visitor>
  void visit(Visitor& v) {
    v("title", title, "Title of the part's page.");
    v("about", about, "What the page says before its tables.");
    v("steps", steps, "The steps by name, in their order.");
  }
};

struct ReproduceParams {
  std::string description;
  std::filesystem::path models;
  ConfigNode parts;

  template <class Visitor>
  void visit(Visitor& v) {
    v("description", description, "A description for people.");
    v("models", models,
      "Folder of the models (*.h5) that a part may be measured with, others are refused; empty: models beside this file.");
    v("parts", parts, "The parts by name, in their order.");
  }
};

/// All keys, for `weft describe`: those of parts and steps below `parts.PART`.
std::vector<ParamInfo> describe_reproduction();

inline constexpr const char* kReproductionSizes[] = {"quick", "standard", "full"};

struct ReproductionStep {
  std::string part, name;
  StepParams params;
  StepSizeParams size;  ///< of the size that was read

  std::string label() const { return part + "/" + name; }
};
struct ReproductionPart {
  std::string name, title, about;
  std::vector<ReproductionStep> steps;  ///< of the size that was read; empty: it leaves the part out
  std::vector<std::string> sizes;       ///< that have steps
};
struct Reproduction {
  std::string size;
  std::filesystem::path models;
  std::filesystem::path root;  ///< the folder above that of the config, in which the pages' commands are typed
  std::vector<ReproductionPart> parts;

  const ReproductionPart* part(const std::string& name) const;  ///< null if there is none
  /// @param label PART/STEP of this size, as read_reproduction() has checked.
  const ReproductionStep& step(const std::string& label) const;
};
/// @param size one of kReproductionSizes. @throws ConfigError with file and line, also for a step that needs one which its size
/// leaves out.
Reproduction read_reproduction(const ConfigNode& config, const std::string& size);

/// The parts of these names, in the file's order; without names all that the size has.
/// @throws ConfigError for an unknown name, and for a part that the size leaves out.
std::vector<const ReproductionPart*> chosen_parts(const Reproduction& all, const std::vector<std::string>& names);
/// Their steps and those that they need, each once and after what it needs.
std::vector<const ReproductionStep*> steps_of(const Reproduction& all,
                                              const std::vector<const ReproductionPart*>& parts);

/// "about 3.2 hours of CPU time, 1.6 hours on 2 processors", by `cpu_minutes` of the steps; those that have none are named.
/// Empty if no step has them.
std::string expected_time(const std::vector<const ReproductionStep*>& steps, int processors);

/// A call of weft: its words without the program, and the folder of its results.
struct ReproductionCommand {
  std::vector<std::string> words;
  std::filesystem::path folder;
  bool is_sweep = true;  ///< of many cases: it takes --accept-changed, --on, and --retry-failed unless it is of physics
};
/// The calls of a step, none if it shows the results of another one.
/// @param out the folder of all results. @param root config files below it are named from there; empty: the working folder.
std::vector<ReproductionCommand> commands_of(const ReproductionStep& step, const std::filesystem::path& out,
                                             const std::filesystem::path& root = {});
/// As a user types it: "weft ablate ...".
std::string typed(const std::vector<std::string>& words);

/// A picture of a page, among the results and beside the page.
struct ReproductionFigure {
  std::filesystem::path from;
  std::string step, title, file;  ///< file: from the page's folder
  std::string session = {};       ///< whose stills stand in a row; empty: it stands alone
};
/// The pictures of a part that have been drawn.
std::vector<ReproductionFigure> figures_of(const Reproduction& all, const ReproductionPart& part,
                                           const std::filesystem::path& out);

/// What measured it.
struct Origin {
  std::string commit, processor, date;
  int cores = 0;  ///< 0: unknown
};
/// NAME.json of a part: an object of kMeasurementSchema. Null if its steps have no tables.
/// @param out the folder of all results; the commands that the measurement names have results/reproduce-SIZE in its place.
/// @throws ConfigError for results that are not complete, and for those of a model that is not in the folder of models.
nlohmann::ordered_json measurement_of(const Reproduction& all, const ReproductionPart& part,
                                      const std::filesystem::path& out, const Origin& origin);

/// What a measurement in the folder was made with that is no model of these: one line each. @param models folder.
std::vector<std::string> other_models(const std::filesystem::path& folder, const std::filesystem::path& models);

}  // namespace weft
