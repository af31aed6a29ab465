#include "context.hpp"

#include <fcntl.h>
#include <sys/prctl.h>
#include <unistd.h>
#include <ext/stdio_filebuf.h>

#include <atomic>
#include <cerrno>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <iostream>

#include "loader/program_host.hpp"
#include "options.hpp"
#include "processes/crash_report.hpp"

namespace weft::app {
namespace {

std::atomic<bool> interrupted = false, terminated = false;  // set in a signal handler: must be lock-free
static_assert(std::atomic<bool>::is_always_lock_free);
bool is_slurm_job = false;            // set before there is a handler
std::ostream* kept_output = nullptr;  // null: stdout as it is

/// ^C; what Slurm, docker and `timeout` send; the end of a terminal or of a connection.
constexpr int kStopSignals[] = {SIGINT, SIGTERM, SIGHUP};

/// Answers at once: what is being done may take a while to end. A job of Slurm that is cancelled gets SIGTERM from slurmd, and
/// from its script, which is asked as well: that is one wish to end, not two.
void stop(int signal) {
  constexpr char kAnswer[] = "stopping; ^C or SIGTERM once more ends weft at once\n", kJobAnswer[] = "stopping\n";
  const bool is_first = !interrupted.exchange(true);
  if (signal == SIGTERM) terminated = true;
  if (signal == SIGTERM && is_slurm_job) {
    [[maybe_unused]] const auto written = is_first ? write(STDERR_FILENO, kJobAnswer, sizeof(kJobAnswer) - 1) : 0;
    return;
  }
  [[maybe_unused]] const auto written = write(STDERR_FILENO, kAnswer, sizeof(kAnswer) - 1);
  // The next one ends weft, and says in which plugin: that is why it has not ended yet.
  for (const int one : kStopSignals) report_before_end(one);
}

}  // namespace

ConfigNode Context::load(const std::string& file) const {
  ConfigNode config = ConfigNode::load(file);
  for (const auto& assignment : overrides) config = apply_override(config, assignment);
  if (seed) config = config.with("seed", ConfigNode::integer(static_cast<std::int64_t>(*seed)));
  return config;
}

std::shared_ptr<const PluginRegistry> Context::registry(const ConfigNode& config) const {
  std::vector<std::filesystem::path> folders;
  if (const auto given = config.is_mapping() ? config.find("plugin_path") : std::nullopt) {
    if (given->is_scalar()) folders.push_back(given->as_path());
    for (std::size_t i = 0; given->is_sequence() && i < given->size(); ++i) folders.push_back((*given)[i].as_path());
  }
  // Never freed: main prints an error after the command has ended, and the error's type may live in a plugin.
  static auto& kept = *new std::vector<std::shared_ptr<const PluginRegistry>>();
  return kept.emplace_back(std::make_shared<PluginRegistry>(std::move(folders)));
}

std::unique_ptr<Host> Context::host(std::shared_ptr<const PluginRegistry> plugins, std::uint64_t host_seed,
                                    PluginChecks checks) const {
  catch_signals();
  HostOptions options;
  options.threads = jobs;
  options.seed = host_seed;
  options.cancel = &interrupted;
  options.checks = checks;
  options.log = [this](LogLevel level, const std::string& message) {
    if (level == LogLevel::debug || (level == LogLevel::info && (quiet || json || is_step))) return;
    const char* prefix = level == LogLevel::warning ? "warning: " : level == LogLevel::error ? "error: " : "";
    std::fprintf(level == LogLevel::info ? stdout : stderr, "%s%s\n", prefix, message.c_str());
    std::fflush(level == LogLevel::info ? stdout : stderr);
  };
  return make_host(std::move(plugins), options);
}

void Context::catch_signals() {
  is_slurm_job = std::getenv("SLURM_JOB_ID") != nullptr;
  struct sigaction before {};
  for (const int signal : kStopSignals)  // under nohup SIGHUP stays ignored
    if (signal != SIGHUP || (sigaction(signal, nullptr, &before) == 0 && before.sa_handler != SIG_IGN))
      std::signal(signal, stop);
}

bool Context::is_terminated() { return terminated; }

const std::atomic<bool>* Context::cancel_flag() const { return &interrupted; }

void Context::say(const std::string& line) const {
  if (!quiet && !json && !is_step) std::cout << line << std::endl;
}

void Context::keep_output() {
  if (kept_output != nullptr) return;
  std::cout.flush();
  std::fflush(stdout);
  const int own = fcntl(STDOUT_FILENO, F_DUPFD_CLOEXEC, 10);  // above the numbers that children know
  if (own < 0 || dup2(STDERR_FILENO, STDOUT_FILENO) < 0)
    throw Error(std::string("stdout cannot be kept for the result: ") + std::strerror(errno));
  static __gnu_cxx::stdio_filebuf<char> buffer(own, std::ios::out);
  static std::ostream stream(&buffer);
  kept_output = &stream;
}

std::ostream& Context::output() { return kept_output != nullptr ? *kept_output : std::cout; }

void Context::flush_output() {
  errno = 0;
  bool good = std::fflush(stdout) == 0 && std::ferror(stdout) == 0;
  for (std::ostream* stream : {&std::cout, &output()}) good = stream->flush().good() && good;
  if (!good) throw Error("the output cannot be written" + (errno != 0 ? std::string(": ") + std::strerror(errno) : ""));
}

void Context::open_standard_streams() {
  for (const int stream : {STDIN_FILENO, STDOUT_FILENO, STDERR_FILENO}) {
    // open() takes the lowest number that is free.
    if (fcntl(stream, F_GETFD) < 0 && open("/dev/null", O_RDWR) < 0) return;
  }
}

void Context::end_with_parent() {
  const char* value = std::getenv(kParentVariable);
  if (value == nullptr) return;
  const std::string parent = value;
  unsetenv(kParentVariable);  // its own children are not that one's
  prctl(PR_SET_PDEATHSIG, SIGTERM);
  if (parent != std::to_string(getppid())) raise(SIGTERM);  // it has ended before
}

void Context::complain(const std::string& line) const {
  if (!quiet) std::fprintf(stderr, "%s\n", line.c_str());
}

std::shared_ptr<const PluginRegistry> registry_of_overrides(const Context& context) {
  ConfigNode config;
  for (const auto& assignment : context.overrides) config = apply_override(config, assignment);
  config.refuse_unknown_keys({"plugin_path"});
  return context.registry(config);
}

void add_output_options(CLI::App& command, Context& context) {
  command.add_option("--out", context.out, "Output folder or file");
  command.add_option("--jobs", context.jobs, "Threads; 0: as many as the processors that weft may use")
      ->check(within(0, 1024));
  command.add_flag("--quiet", context.quiet, "Print nothing but errors");
  command.add_flag("--json", context.json, "Print the result as JSON");
}

void add_accept_option(CLI::App& command, Context& context) {
  command.add_flag(
      "--accept-changed", context.accept_changed,
      "Go on where --out holds results of another config, file, plugin or version; what differs is recorded");
}

void add_common_options(CLI::App& command, Context& context) {
  command.add_option("--set", context.overrides, "Replace a value of the config: key.path=value (repeatable)")
      ->allow_extra_args(false)
      ->type_name("KEY=VALUE");
  command.add_option("--seed", context.seed, "Seed of everything random")
      ->check(within(std::uint64_t{0}, std::uint64_t{9000000000000000000}));
  add_output_options(command, context);
}

}  // namespace weft::app
