#include <cstdio>
#include <iostream>

#include "commands.hpp"
#include "experiments/reproduction.hpp"
#include "loader/processors.hpp"
#include "options.hpp"
#include "output.hpp"
#include "paper_options.hpp"
#include "report/measurement.hpp"
#include "reproduction_run.hpp"
#include "sdk/files.hpp"

namespace weft::app {
namespace {

namespace fs = std::filesystem;

struct ReproduceCall {
  std::vector<std::string> parts;
  std::string config, pages;
  bool quick = false, standard = false, full = false, dry_run = false, check = false;
  CLI::Option* pages_option = nullptr;
  ReproduceOptions options;
};

/// --config, or else configs/reproduce.yaml here or of this installation.
fs::path config_of(const ReproduceCall& call) {
  if (!call.config.empty()) return call.config;
  const fs::path here = fs::path("configs") / "reproduce.yaml";
  return fs::exists(here) ? here : tree_of_weft() / "share/weft" / here;
}

/// Makes the pages of a folder and the blocks of documents, or says what differs. @return the exit code.
int make_pages(const Context& context, const ReproduceCall& call) {
  const fs::path folder = call.pages.empty() ? fs::path("docs") / "measurements" : fs::path(call.pages);
  if (!fs::is_directory(folder)) throw ConfigError("--pages " + folder.string() + ": there is no such folder");
  const auto stale = stale_pages(folder);
  // As docs/measurements and configs/models lie in a repository.
  const auto others =
      other_models(folder, (fs::absolute(folder).lexically_normal() / "../../configs/models").lexically_normal());
  for (const auto& page : stale) {
    if (call.check) {
      std::fprintf(stderr, "%s: differs from its measurement; weft reproduce --pages makes it\n", page.file.c_str());
    } else {
      write_text(page.file, page.text);
      context.say(page.file.string());
    }
  }
  for (const auto& line : others) std::fprintf(stderr, "%s%s\n", call.check ? "" : "warning: ", line.c_str());
  if (stale.empty() && others.empty())
    context.say("everything is as the measurements of " + folder.string() + " have it");
  return call.check && (!stale.empty() || !others.empty()) ? 1 : 0;
}

int reproduce(Context& context, const ReproduceCall& call) {
  if (call.pages_option->count() > 0 || call.check) {
    if (!call.parts.empty()) throw ConfigError("--pages and --check are of all measurements of a folder: name no part");
    return make_pages(context, call);
  }
  const std::string size = call.full ? "full" : call.standard ? "standard" : "quick";
  const fs::path file = config_of(call);
  const Reproduction all = read_reproduction(ConfigNode::load(file), size);
  const auto parts = chosen_parts(all, call.parts);
  const fs::path out = result_folder(context, "reproduce-" + size);
  if (!call.dry_run) return ReproductionRun(context, all, out, call.options).run(parts);
  const auto steps = steps_of(all, parts);
  if (const auto expected = expected_time(steps, context.jobs > 0 ? context.jobs : allowed_processors());
      !expected.empty())
    context.output() << "# " << expected << '\n';
  for (const auto* step : steps)
    for (const auto& command : commands_of(*step, out)) context.output() << typed(command.words) << '\n';
  return 0;
}

}  // namespace

void register_reproduce(CLI::App& app, Context& context) {
  CLI::App* command =
      app.add_subcommand("reproduce", "Measure the paper's figures and weft's own, and make pages of them; resumable");
  auto call = std::make_shared<ReproduceCall>();
  command->add_option("parts", call->parts, "Parts of the config, such as fig3; default: all that the size has");
  add_output_options(*command, context);
  add_accept_option(*command, context);
  command->add_option("--config", call->config, "What to measure; default: configs/reproduce.yaml");
  CLI::Option* quick = command->add_flag("--quick", call->quick, "About 10 minutes on two cores; the default");
  CLI::Option* standard = command->add_flag("--standard", call->standard, "About 2.5 hours on two cores");
  CLI::Option* full = command->add_flag("--full", call->full, "Everything: hours, which it prints first");
  standard->excludes(quick);
  full->excludes(quick)->excludes(standard);
  command->add_flag("--dry-run", call->dry_run, "Print the commands and run nothing");
  command
      ->add_flag("--retry-failed{accidents}", call->options.retry_failed,
                 "Of the commands that have it: try cases again that crashed, hung or were lost; =all: all that failed")
      ->check(CLI::IsMember({"accidents", "all"}));
  command->add_option("--on", call->options.on, "Run the commands that can on a cluster: slurm, or slurm:PROFILE")
      ->type_name("SYSTEM[:PROFILE]");
  add_figures_option(*command, call->options.figures);
  call->pages_option =
      command
          ->add_option(
              "--pages", call->pages,
              "Measure nothing: write the pages of the measurements in this folder, docs/measurements by default, and "
              "the numbers in the documents around it")
          ->expected(0, 1)
          ->type_name("FOLDER");
  command->add_flag("--check", call->check, "With --pages: change nothing; exit code 1 if anything differs");
  command->callback([&context, call] { context.action = [&context, call] { return reproduce(context, *call); }; });
}

}  // namespace weft::app
