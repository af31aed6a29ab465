#include "reproduction_run.hpp"

#include <sys/types.h>
#include <unistd.h>

#include <algorithm>
#include <csignal>
#include <fstream>

#include "commit.hpp"
#include "loader/processors.hpp"
#include "output.hpp"
#include "processes/child_process.hpp"
#include "processes/worker_process.hpp"
#include "report/measurement.hpp"
#include "sdk/files.hpp"
#include "sdk/json_text.hpp"
#include "sdk/listed.hpp"

namespace weft::app {
namespace {

namespace fs = std::filesystem;
using nlohmann::ordered_json;

constexpr double kLook = 0.2;          // s between two looks at what a command prints
constexpr std::size_t kLongest = 100;  // characters of a progress line
constexpr const char* kTimes = "times.json";

bool begins_with(const std::vector<std::string>& words, std::initializer_list<const char*> begin) {
  return words.size() >= begin.size() && std::equal(begin.begin(), begin.end(), words.begin());
}
bool is_physics(const std::vector<std::string>& words) { return begins_with(words, {"evaluate", "physics"}); }
bool has_figures(const std::vector<std::string>& words) {
  return begins_with(words, {"ablate"}) || begins_with(words, {"evaluate"});
}

/// The last file that a command writes results to, which is there only if it ended its work.
const char* result_of(const std::vector<std::string>& words) {
  if (begins_with(words, {"ablate"})) return "ablation.json";
  if (begins_with(words, {"evaluate", "planning"})) return "planning.json";
  if (begins_with(words, {"evaluate", "estimation"})) return "estimation.json";
  if (begins_with(words, {"evaluate", "prediction"})) return "prediction.json";
  if (is_physics(words)) return "physics.json";
  if (begins_with(words, {"benchmark"})) return "speed.json";
  return nullptr;
}

std::string count_of(std::size_t parts) { return std::to_string(parts) + (parts == 1 ? " part" : " parts"); }

/// A measurement as it was before, if only what does not belong to the results is different now.
bool is_same(const ordered_json& earlier, const ordered_json& now) {
  if (!earlier.is_object()) return false;
  for (const char* key : {"schema", "title", "about", "size", "weft", "models", "steps", "figures", "tables"})
    if (!earlier.contains(key) || earlier[key] != now.at(key)) return false;
  return true;
}

}  // namespace

ReproductionRun::ReproductionRun(Context& context, const Reproduction& all, const fs::path& out,
                                 const ReproduceOptions& options)
    : context_(context), all_(all), out_(out), options_(options), line_(context) {
  const auto times = parse_json_if_valid(text_of_file(out_ / kTimes));
  seconds_ = times.is_object() && times.contains("seconds") ? times["seconds"] : ordered_json::object();
}

int ReproductionRun::run(const std::vector<const ReproductionPart*>& parts) {
  Context::catch_signals();
  make_writable_folder(out_);
  const auto steps = steps_of(all_, parts);
  const std::string expected = expected_time(steps, context_.jobs > 0 ? context_.jobs : allowed_processors());
  if (options_.on.empty() && !expected.empty())
    context_.say(count_of(parts.size()) + " of size " + all_.size + ": " + expected);
  bool is_refused = false;
  std::vector<std::string> missing;
  for (std::size_t i = 0; i < steps.size() && !*context_.cancel_flag(); ++i) {
    const End end = run_step(*steps[i], i + 1, steps.size());
    is_refused = is_refused || end == End::refused;
    if (end == End::failed || end == End::refused) missing.push_back(steps[i]->label());
    for (const auto* part : parts) {
      const auto is_done = [&](const auto& step) { return ended_.contains(step.label()); };
      const bool is_last =
          std::any_of(part->steps.begin(), part->steps.end(), [&](const auto& step) { return &step == steps[i]; });
      if (is_last && std::all_of(part->steps.begin(), part->steps.end(), is_done) && !measure(*part))
        missing.push_back(part->name);
    }
  }
  line_.end();
  write_index();
  if (*context_.cancel_flag()) {
    context_.say("interrupted; run the same command again to finish it");
    return 1;
  }
  double seconds = 0.0;
  for (const auto* part : parts) seconds += seconds_of(*part);
  context_.say(count_of(parts.size()) + " of size " + all_.size + ", " + duration_text(seconds) +
               " in all; the list is " + (out_ / "index.md").string());
  if (context_.json) {
    auto list = ordered_json::array();
    for (const auto* part : parts)
      if (const auto json = parse_json_if_valid(text_of_file(out_ / (part->name + ".json"))); json.is_object())
        list.push_back(json);
    context_.output() << list.dump(2) << '\n';
  }
  if (missing.empty()) return has_failures_ ? 1 : 0;
  const std::string names = listed(missing);
  std::fprintf(stderr, "error: not done: %s; the same command goes on, with --retry-failed also where cases failed\n",
               names.c_str());
  return is_refused ? 2 : 1;
}

ReproductionRun::End ReproductionRun::run_step(const ReproductionStep& step, std::size_t number, std::size_t steps) {
  for (const auto& need : {step.params.results, step.params.examples}) {
    if (need.empty() || ended_.contains(need)) continue;
    context_.complain(step.label() + ": needs " + need + ", which is not done");
    return End::failed;
  }
  const std::string label = "[" + std::to_string(number) + "/" + std::to_string(steps) + "] " + step.label();
  const auto commands = commands_of(step, out_);
  const auto begun = Clock::now();
  const fs::path log = out_ / step.part / (step.name + ".log");
  make_folder_for_results(log.parent_path());
  std::ofstream(log, std::ios::trunc).close();
  End end = End::done;
  for (std::size_t i = 0; i < commands.size() && end == End::done; ++i) end = run_command(commands[i], label, log);
  const double seconds = std::chrono::duration<double>(Clock::now() - begun).count();
  line_.end();
  if (!commands.empty()) keep_seconds(step, seconds);
  if (end == End::done) ended_.insert(step.label());
  const char* what = end == End::done          ? "done"
                     : end == End::interrupted ? "interrupted"
                     : end == End::refused     ? "refused"
                                               : "failed";
  context_.say(label + ": " + what +
               (commands.empty() ? ", results of " + step.params.results : ", " + duration_text(seconds)));
  return end;
}

ReproductionRun::End ReproductionRun::run_command(const ReproductionCommand& command, const std::string& label,
                                                  const fs::path& log) {
  std::vector<std::string> words = command.words;
  const auto add = [&](std::vector<std::string>& to, const std::vector<std::string>& some) {
    to.insert(to.end(), some.begin(), some.end());
  };
  const bool is_export = begins_with(words, {"export"});
  if (!is_export && context_.jobs > 0) add(words, {"--jobs", std::to_string(context_.jobs)});
  if ((command.is_sweep || begins_with(words, {"run"})) && context_.accept_changed) add(words, {"--accept-changed"});
  if (!options_.retry_failed.empty() && command.is_sweep && !is_physics(words))
    add(words, {options_.retry_failed == "all" ? "--retry-failed=all" : "--retry-failed"});
  const auto begun = fs::file_time_type::clock::now() - std::chrono::seconds(1);  // times of files are coarse
  if (!options_.on.empty() && command.is_sweep) {
    std::vector<std::string> on_cluster = words;
    add(on_cluster, {"--on", options_.on});
    if (const End end = run_words(on_cluster, label, log);
        end != End::done && !(end == End::failed && has_results(command, begun)))
      return end;
    // Once more here, where everything is there already: it checks that, and nodes need not be able to draw.
  }
  if (!options_.figures.empty() && has_figures(words)) {
    add(words, {"--figures", listed(options_.figures, ",")});
  }
  const char* result = result_of(words);
  const std::string before = result ? text_of_file(command.folder / result) : std::string();
  const End end = run_words(words, label, log);
  // Pictures of earlier results do not stand beside new ones.
  if (options_.figures.empty() && has_figures(words) && result && text_of_file(command.folder / result) != before) {
    std::error_code none;
    fs::remove_all(command.folder / "figures", none);
  }
  return end == End::failed && has_results(command, begun) ? End::done : end;
}

bool ReproductionRun::has_results(const ReproductionCommand& command, fs::file_time_type begun) const {
  const char* name = result_of(command.words);
  if (name == nullptr) return false;
  std::error_code none;
  const auto written = fs::last_write_time(command.folder / name, none);
  if (none || written < begun) return false;
  const auto json = parse_json_if_valid(text_of_file(command.folder / name));
  return json.is_object() && json.value("complete", true);
}

ReproductionRun::End ReproductionRun::run_words(const std::vector<std::string>& words, const std::string& label,
                                                const fs::path& log) {
  ChildOptions options;
  options.command = this_program(words);
  options.environment = {{kParentVariable, std::to_string(getpid())}};
  options.own_group = true;  // ^C comes here, and the command gets a SIGTERM
  options.keep_errors = true;
  std::ofstream log_stream(log, std::ios::app);
  log_stream << "$ " << typed(words) << '\n' << std::flush;
  const auto begun = Clock::now();
  ChildProcess child(options);
  child.close_input();
  std::string last;
  bool is_told = false;
  const auto look = [&] {
    if (*context_.cancel_flag() && !is_told) {
      is_told = true;
      ::kill(child.id(), SIGTERM);  // not its group: it tells its own children
    }
    if (!line_.is_in_place()) return;
    const double seconds = std::chrono::duration<double>(Clock::now() - begun).count();
    line_.show((label + ", " + duration_text(seconds) + (last.empty() ? "" : ": " + last)).substr(0, kLongest));
  };
  if (!line_.is_in_place()) context_.say(label + ": " + typed(words));
  for (bool is_open = true; is_open;) {
    std::string line;
    const auto outcome = child.read_line(line, seconds_from_now(kLook));
    is_open = outcome == ChildProcess::Outcome::done || outcome == ChildProcess::Outcome::late;
    if (outcome == ChildProcess::Outcome::done) {
      log_stream << line << '\n' << std::flush;
      if (!line.empty()) last = line;
    }
    look();
  }
  auto end = child.wait_until(seconds_from_now(kLook));
  for (; !end; end = child.wait_until(seconds_from_now(kLook))) look();
  const std::string errors = child.errors();
  log_stream << errors;
  if (*context_.cancel_flag()) return End::interrupted;
  if (!errors.empty()) {
    line_.end();
    std::fprintf(stderr, "%s:\n%s%s", label.c_str(), errors.c_str(), errors.ends_with('\n') ? "" : "\n");
  }
  if (end->exit_code == 0) return End::done;
  if (end->exit_code < 0) std::fprintf(stderr, "%s: %s\n", label.c_str(), end->text().c_str());
  return end->exit_code == 2 ? End::refused : End::failed;
}

bool ReproductionRun::measure(const ReproductionPart& part) {
  try {
    const bool is_here = options_.on.empty();
    const Origin origin{commit(), is_here ? processor_name() : "a cluster (" + options_.on + ")", today(),
                        is_here ? allowed_processors() : 0};
    ordered_json json = measurement_of(all_, part, out_, origin);
    if (json.is_null()) return true;
    const fs::path file = out_ / (part.name + ".json");
    const ordered_json earlier = parse_json_if_valid(text_of_file(file));
    if (is_same(earlier, json)) json = earlier;  // its commit, machine and date are those that measured it
    for (const auto& figure : figures_of(all_, part, out_)) {
      make_folder_for_results((out_ / figure.file).parent_path());
      write_text(out_ / figure.file, text_of_file(figure.from));
    }
    std::vector<PaperTable> tables;
    for (const auto& table : json.at("tables")) tables.push_back(table_of_json(table));
    write_text(out_ / (part.name + ".tex"), latex_of(tables));
    write_text(out_ / (part.name + ".md"), measurement_page(json));
    write_text(file, json.dump(1) + "\n");
    std::int64_t failed = 0;
    for (const auto& step : json.at("steps")) failed += step.at("failed").get<std::int64_t>();
    if (failed > 0) {
      has_failures_ = true;
      std::fprintf(stderr, "warning: %s: %ld cases failed; --retry-failed tries them again\n", part.name.c_str(),
                   static_cast<long>(failed));
    }
    context_.say(part.name + ": " + file.string() + ", " + duration_text(seconds_of(part)) + " in all");
    return true;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "error: %s: %s\n", part.name.c_str(), error.what());
    return false;
  }
}

void ReproductionRun::keep_seconds(const ReproductionStep& step, double seconds) {
  const double earlier = seconds_.value(step.label(), 0.0);
  seconds_[step.label()] = earlier + seconds;
  write_text(out_ / kTimes, ordered_json{{"seconds", seconds_}}.dump(2) + "\n");
}

double ReproductionRun::seconds_of(const ReproductionPart& part) const {
  double seconds = 0.0;
  for (const auto& step : part.steps) seconds += seconds_.value(step.label(), 0.0);
  return seconds;
}

void ReproductionRun::write_index() const {
  std::string text =
      "# Size " + all_.size + "\n\n| part | size | commit | date | measured in |\n|---|---|---|---|---|\n";
  std::vector<std::string> left_out, missing;
  for (const auto& part : all_.parts) {
    const auto json = parse_json_if_valid(text_of_file(out_ / (part.name + ".json")));
    if (json.is_object()) {
      text += "| [" + part.title + "](" + part.name + ".md) | " + json.value("size", "") + " | " +
              json.value("commit", "") + " | " + json.value("date", "") + " | " + duration_text(seconds_of(part)) +
              " |\n";
    } else if (part.steps.empty()) {
      left_out.push_back(part.name);
    } else {
      const bool is_page = std::any_of(part.steps.begin(), part.steps.end(),
                                       [](const auto& step) { return step.params.command != "generate"; });
      if (is_page) missing.push_back(part.name);
    }
  }
  const auto add = [&](const std::string& what, const std::vector<std::string>& names) {
    if (!names.empty()) text += "\n" + what + ": " + listed(names) + ".\n";
  };
  add("Not measured yet", missing);
  add("Not part of this size", left_out);
  write_text(out_ / "index.md", text);
}

}  // namespace weft::app
