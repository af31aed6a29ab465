#include "sdk/ended_process.hpp"

#include <cerrno>
#include <csignal>
#include <filesystem>
#include <fstream>
#include <string>

namespace weft {

namespace fs = std::filesystem;

bool has_ended(pid_t process) {
  if (kill(process, 0) != 0 && errno == ESRCH) return true;
  // The first thread is a zombie while others still run, so all of them are asked.
  bool is_known = false;
  std::error_code none;  // also for the next entry: the folder may go while it is read
  fs::directory_iterator thread("/proc/" + std::to_string(process) + "/task", none);
  for (; thread != fs::directory_iterator(); thread.increment(none)) {
    std::string stat;
    std::getline(std::ifstream(thread->path() / "stat"), stat);
    const auto name_end = stat.rfind(") ");
    if (name_end == std::string::npos) continue;  // it has ended since
    const char state = stat[name_end + 2];
    if (state != 'Z' && state != 'X') return false;
    is_known = true;
  }
  return is_known;
}

}  // namespace weft
