#include <unistd.h>

#include <clocale>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <exception>

#include "cluster/job_scripts.hpp"
#include "commands.hpp"
#include "commit.hpp"
#include "loader/where.hpp"
#include "processes/crash_report.hpp"
#include "weft/config.hpp"

namespace {

/// The error about a word in the place of a command that is not one. Empty if there is no such word.
std::string unknown_command(const CLI::App& app) {
  const CLI::App* innermost = &app;
  while (!innermost->get_subcommands().empty()) innermost = innermost->get_subcommands().front();
  std::vector<std::string> known;
  for (const CLI::App* command : innermost->get_subcommands([](const CLI::App*) { return true; }))
    if (!command->get_group().empty()) known.push_back(command->get_name());
  const std::vector<std::string> rest = innermost->remaining();
  if (known.empty() || rest.empty() || rest.front().starts_with("-")) return "";
  return "'" + rest.front() + "' is not a command of weft" + (innermost == &app ? "" : " " + innermost->get_name()) +
         ", must be " + weft::one_of(known) + weft::nearest_hint(rest.front(), known);
}

/// The exit code of a command. The script of a Slurm job starts one that SIGTERM stopped again.
int failed_or_stopped(int code) {
  const bool is_job = std::getenv("SLURM_JOB_ID") != nullptr;
  return code == 1 && is_job && weft::app::Context::is_terminated() ? weft::kStartAgain : code;
}

}  // namespace

/// `weft`: parses the command line, runs one command, turns errors into exit codes: 0 done, 1 failed, 2 wrong use, 3 others
/// are at work on the rest (--share), 75 SIGTERM came before it was done, in a job of Slurm.
int main(int argc, char** argv) {
  using namespace weft;
  using namespace weft::app;
  // Numbers are read and written with a point, whatever locale a library that was loaded before has set.
  std::setlocale(LC_NUMERIC, "C");
  Context::open_standard_streams();
  Context::end_with_parent();
  CLI::App app{"weft: plans how two hands fold a piece of cloth whose fabric they do not know"};
  app.require_subcommand(1);
  app.set_version_flag("--version", std::string("weft " WEFT_VERSION " (") + commit() + ")");
  Context context;
  context.words.assign(argv + 1, argv + argc);
  register_run(app, context);
  register_plan(app, context);
  register_estimate(app, context);
  register_simulate(app, context);
  register_displacement(app, context);
  register_garment(app, context);
  register_generate(app, context);
  register_dataset(app, context);
  register_train(app, context);
  register_calibrate(app, context);
  register_learn(app, context);
  register_evaluate(app, context);
  register_ablate(app, context);
  register_benchmark(app, context);
  register_reproduce(app, context);
  register_status(app, context);
  register_cancel(app, context);
  register_export(app, context);
  register_conformance(app, context);
  register_plugins(app, context);
  register_describe(app, context);
  register_new(app, context);
  register_completion(app, context);
  register_worker(app, context);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    if (const std::string problem = unknown_command(app); !problem.empty()) {
      std::fprintf(stderr, "error: %s\n", problem.c_str());
      return 2;
    }
    return app.exit(error) == 0 ? 0 : 2;
  }
  // Writing beyond a limit on the size of files then fails like writing to a full disk, with a message.
  std::signal(SIGXFSZ, SIG_IGN);
  install_crash_report(STDERR_FILENO, write_where);
  try {
    const CrashWatch watch;
    if (context.json) Context::keep_output();
    const int code = context.action();
    Context::flush_output();
    return failed_or_stopped(code);
  } catch (const ConfigError& error) {
    std::fprintf(stderr, "error: %s\n", error.what());
    return 2;
  } catch (const PluginError& error) {
    std::fprintf(stderr, "error: %s\n", error.what());
    return 2;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "error: %s\n", error.what());
    return failed_or_stopped(1);
  }
}
