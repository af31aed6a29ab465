#pragma once
#include <string>
#include <vector>

namespace weft {

/// How a cell of a sweep, or an example of a dataset, ended.
enum class WorkStatus {
  done,
  refused,   ///< weft or a plugin threw an error: it would do so again
  diverged,  ///< a numerical failure: no finite state, no finite loss
  crashed,   ///< its process died of it
  hung,      ///< its process was ended by weft: no progress, or far more time than any other
  lost       ///< its process was ended from outside, or the machine refused it memory, threads or a file
};
const char* to_string(WorkStatus status);
/// @param name as to_string() gives it, or "failed" of earlier versions: refused. @throws ConfigError for another one.
WorkStatus work_status_named(const std::string& name);

/// How it failed, and why.
struct WorkFailure {
  WorkStatus status = WorkStatus::refused;
  std::string message;
};
/// What the exception that is being handled means. Call it in a catch block.
WorkFailure current_failure();

/// Which failures an earlier run left are tried again.
enum class Retry {
  none,
  accidents,  ///< crashed, hung and lost
  all
};
bool tries_again(Retry retry, WorkStatus status);

/// "2 crashed, 1 hung"; empty if all are done.
std::string failures_text(const std::vector<WorkStatus>& statuses);

}  // namespace weft
