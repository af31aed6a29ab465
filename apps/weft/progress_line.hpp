#pragma once
#include <string>

#include "context.hpp"

namespace weft::app {

/// Prints one line that changes; on a terminal in its place.
class ProgressLine {
 public:
  explicit ProgressLine(const Context& context);
  ~ProgressLine() { end(); }
  ProgressLine(const ProgressLine&) = delete;
  ProgressLine& operator=(const ProgressLine&) = delete;

  void show(const std::string& text);
  /// Whether it stays in one place: on a terminal. Elsewhere every text is a line of its own.
  bool is_in_place() const { return in_place_; }
  void end();

 private:
  const Context& context_;
  bool in_place_;
  std::string shown_;
};

/// "4:05" or "1:04:05". @param seconds a negative number counts as 0.
std::string duration_text(double seconds);

}  // namespace weft::app
