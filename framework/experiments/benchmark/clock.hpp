#pragma once
#include "sdk/cpu_time.hpp"

namespace weft::benchmark {

/// CPU time of all threads of this process, and wall time, since it was made or restarted, ms.
class Clock {
 public:
  Clock() { restart(); }
  void restart() { cpu_ = process_cpu_seconds(), wall_ = seconds_of(CLOCK_MONOTONIC); }
  double cpu_ms() const { return 1e3 * (process_cpu_seconds() - cpu_); }
  double wall_ms() const { return 1e3 * (seconds_of(CLOCK_MONOTONIC) - wall_); }

 private:
  double cpu_, wall_;
};

}  // namespace weft::benchmark
