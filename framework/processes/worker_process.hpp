#pragma once
#include <atomic>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "processes/work_status.hpp"

namespace weft {

/// What a child of weft may take for one unit of work before it counts as hung.
struct WorkLimits {
  double cpu_s = 0.0;    ///< CPU time; 0: no limit
  double idle_s = 60.0;  ///< time without any CPU time
};

/// How often a unit of work is begun whose processes vanish; then it is lost.
inline constexpr int kMostAttempts = 3;

/// The limits of a unit among others. @param cell_limit_s from --cell-limit; 0: none was given.
/// @param slowest CPU time of the slowest unit that has ended, s; 0: none has, and a unit may take a day of CPU time.
WorkLimits work_limits(double cell_limit_s, double slowest);

/// The limits of units that are done by several threads. Thread-safe.
class SlowestUnit {
 public:
  explicit SlowestUnit(double cell_limit_s) : cell_limit_s_(cell_limit_s) {}
  void add(double cpu_seconds);  ///< of a unit that has ended
  WorkLimits limits() const { return work_limits(cell_limit_s_, slowest_); }

 private:
  double cell_limit_s_;
  std::atomic<double> slowest_ = 0.0;
};

/// How a unit of work ended.
struct WorkEnd {
  enum class Kind {
    answered,
    crashed,   ///< its process died of it
    hung,      ///< ended by weft, see WorkLimits
    lost,      ///< its process was ended from outside
    cancelled  ///< the user asked to stop
  };
  Kind kind = Kind::answered;
  std::string text;          ///< the answer, or what happened: signal, plugin, function
  double cpu_seconds = 0.0;  ///< that an answered unit used; 0 if it took less than a second
};

/// How and why a unit failed that was not answered: crashed, hung or lost; done if it was answered.
WorkFailure failure_of(const WorkEnd& end);

/// A child process of weft, started afresh and not forked, that does units of work one after the other. It is started
/// by the first one, and again by the first one after it died. Use it from one thread, which must outlive it: the child
/// is killed when that thread ends, also if this program is killed.
class WorkerProcess {
 public:
  /// @param command of a program that calls serve_work().
  explicit WorkerProcess(std::vector<std::string> command);
  ~WorkerProcess();
  WorkerProcess(const WorkerProcess&) = delete;
  WorkerProcess& operator=(const WorkerProcess&) = delete;

  /// A unit that is lost is tried again, three times in all.
  /// @param request one line. @param limits asked for every half second. @param cancelled the same.
  /// @throws ConfigError if the command cannot be run.
  WorkEnd run(const std::string& request, const std::function<WorkLimits()>& limits,
              const std::function<bool()>& cancelled);

 private:
  WorkEnd run_once(const std::string& request, const std::function<WorkLimits()>& limits,
                   const std::function<bool()>& cancelled);
  struct State;
  std::unique_ptr<State> state_;
};

/// The other side: answers every line of stdin with one line on stdout, until stdin ends. What else is printed to stdout
/// goes to stderr. SIGTERM sets `cancelled`, and what is answered then does not count; SIGINT and SIGHUP are ignored, since
/// ^C in a terminal, and its end, also reach the parent.
/// @param answer the answer to a request, one line; must not throw.
void serve_work(const std::function<std::string(const std::string& request)>& answer, std::atomic<bool>& cancelled);

/// The command that runs this program's file with other arguments.
std::vector<std::string> this_program(std::vector<std::string> arguments);

}  // namespace weft
