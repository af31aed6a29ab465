#include "conformance/isolated.hpp"

#include <dlfcn.h>

#include <cmath>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <limits>
#include <nlohmann/json.hpp>

#include "processes/child_process.hpp"
#include "processes/crash_report.hpp"
#include "weft/error.hpp"

namespace weft {
namespace {

/// How much slower a plugin is here than elsewhere: a sanitizer is compiled in, or loaded before the program.
double slowdown() {
  for (const char* symbol : {"__asan_init", "__tsan_init", "__msan_init"})
    if (dlsym(RTLD_DEFAULT, symbol) != nullptr) return 10.0;
  return 1.0;
}

constexpr double kSecondsBetweenLooks = 0.2;
constexpr double kSecondsToReport = 10.0;  ///< for a child that hangs and is told to end

/// All digits, and infinity and NaN, which JSON does not have.
std::string exact(double value) {
  char text[40];
  std::snprintf(text, sizeof(text), "%a", value);
  return text;
}

/// What the child's crash report says; how it ended if it has none.
std::string why_it_ended(ChildProcess& child, const ChildEnd& end) {
  CrashReport report;
  return read_crash_report(child.crash_report(), report) ? report.text() : "its process " + end.text();
}

/// Ends a child that hangs. SIGABRT lets it report where it is.
std::string where_it_hung(ChildProcess& child) {
  child.kill(SIGABRT);
  auto end = child.wait_until(seconds_from_now(kSecondsToReport));
  if (!end) {
    child.kill(SIGKILL);
    end = child.wait_until(seconds_from_now(kSecondsToReport));
  }
  return end ? why_it_ended(child, *end) : "its process cannot be ended";
}

/// @return false if the line is no answer.
bool read_answer(const std::string& line, LawResult& law) {
  const auto answer = nlohmann::json::parse(line, nullptr, false);
  if (!answer.is_object()) return false;
  if (answer.contains("config_error")) throw ConfigError(answer["config_error"].get<std::string>());
  if (answer.contains("plugin_error")) throw PluginError(answer["plugin_error"].get<std::string>());
  if (!answer.contains("measured") || !answer.contains("detail")) return false;
  law.measured = std::strtod(answer["measured"].get<std::string>().c_str(), nullptr);
  law.detail = answer["detail"].get<std::string>();
  law.passed = law.measured <= law.bound;  // false for NaN
  return true;
}

}  // namespace

LawResult check_in_child(std::vector<std::string> command, LawResult law, double limit_s) {
  command.insert(command.end(), {"--law", law.law});
  ChildProcess child({.command = std::move(command), .crash_report = true});
  child.close_input();
  HangWatch watch(slowdown() * limit_s, slowdown() * limit_s);
  watch.start(0.0);
  const auto failed = [&](const std::string& why) {
    law.measured = std::numeric_limits<double>::infinity();
    law.passed = false;
    law.detail = why;
    return law;
  };
  std::string line;
  auto outcome = ChildProcess::Outcome::late;
  while (outcome == ChildProcess::Outcome::late) {
    outcome = child.read_line(line, seconds_from_now(kSecondsBetweenLooks));
    if (outcome != ChildProcess::Outcome::late) break;
    if (const std::string hang = watch.check(child.cpu_seconds()); !hang.empty())
      return failed(hang + ": " + where_it_hung(child));
  }
  const bool answered = outcome == ChildProcess::Outcome::done && read_answer(line, law);
  // The plugin may also crash or hang while it is destroyed.
  auto end = child.wait_until(seconds_from_now(kSecondsBetweenLooks));
  while (!end) {
    if (const std::string hang = watch.check(child.cpu_seconds()); !hang.empty())
      return failed(hang + (answered ? " after the law: " : ": ") + where_it_hung(child));
    end = child.wait_until(seconds_from_now(kSecondsBetweenLooks));
  }
  if (answered && end->signal == 0 && end->exit_code == 0) return law;
  return failed(why_it_ended(child, *end) + (answered ? " after the law" : ""));
}

std::string answer_of(const LawResult& law) {
  return nlohmann::json{{"measured", exact(law.measured)}, {"detail", law.detail}}.dump(
      -1, ' ', true, nlohmann::json::error_handler_t::replace);
}
std::string answer_of(const ConfigError& error) {
  return nlohmann::json{{"config_error", error.what()}}.dump(-1, ' ', true, nlohmann::json::error_handler_t::replace);
}
std::string answer_of(const PluginError& error) {
  return nlohmann::json{{"plugin_error", error.what()}}.dump(-1, ' ', true, nlohmann::json::error_handler_t::replace);
}

}  // namespace weft
