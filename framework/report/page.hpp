#pragma once
#include <filesystem>
#include <string>

#include "session/session_file.hpp"

/// The page that shows results: one self-contained HTML file. The build makes the template from apps/report if node is
/// installed (docs/report.md). The functions here fill in a result's data.
namespace weft {

struct ReportTemplate {
  std::string text;    ///< empty: no template was found
  std::string reason;  ///< why none was found
};
/// Reads WEFT_REPORT_TEMPLATE, or else share/weft/report/report.html near the library. The path is the same in the
/// build tree and after installation.
ReportTemplate find_report_template();

/// The template with a session's data in it. @throws ConfigError if the text is not a template of weft.
std::string session_page(const std::string& page_template, const SessionRecord& session);
/// The template with the data of an evaluation or ablation: all files in the folder of planning.json, estimation.json,
/// prediction.json, physics.json, ablation.json, provenance.json, times.json, config.yaml and cases.h5.
/// @throws ConfigError.
std::string experiment_page(const std::string& page_template, const std::filesystem::path& folder);

/// Writes folder/report.html from the results in the folder (session.h5, or those of experiment_page).
/// @return why no page was written; empty if one was. @throws ConfigError for damaged results.
std::string write_report(const std::filesystem::path& folder);

}  // namespace weft
