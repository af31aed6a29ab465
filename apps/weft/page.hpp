#pragma once
#include <filesystem>

#include "context.hpp"
#include "report/page.hpp"

namespace weft::app {

/// Writes folder/report.html from the results that lie there, and says where it is, or why there is none.
inline void write_page(const Context& context, const std::filesystem::path& folder) {
  const std::string why_not = write_report(folder);
  context.say(why_not.empty() ? "to look at it, open " + (folder / "report.html").string()
                              : "no report.html: " + why_not);
}

}  // namespace weft::app
