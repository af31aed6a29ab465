#include "progress_line.hpp"

#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <iostream>

namespace weft::app {

ProgressLine::ProgressLine(const Context& context)
    : context_(context), in_place_(isatty(STDOUT_FILENO) == 1 && !context.quiet && !context.json) {}

void ProgressLine::show(const std::string& text) {
  if (text == shown_) return;
  shown_ = text;
  if (in_place_)
    std::cout << "\r\033[K" << text << std::flush;
  else
    context_.say(text);
}

void ProgressLine::end() {
  if (in_place_ && !shown_.empty()) std::cout << std::endl;
  shown_.clear();
}

std::string duration_text(double seconds) {
  char text[40];
  const auto s = static_cast<long>(std::max(0.0, seconds));
  if (s < 3600) {
    std::snprintf(text, sizeof(text), "%ld:%02ld", s / 60, s % 60);
  } else {
    std::snprintf(text, sizeof(text), "%ld:%02ld:%02ld", s / 3600, s / 60 % 60, s % 60);
  }
  return text;
}

}  // namespace weft::app
