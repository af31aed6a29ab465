#pragma once
#include <filesystem>
#include <string>

#include "session/session_file.hpp"

/// The page that shows results: one self-contained HTML file. The template is built from apps/report when node is there
/// (docs/report.md); this fills in a result's data.
namespace weft {

struct ReportTemplate {
  std::string text;    ///< empty: there is none
  std::string reason;  ///< why not
};
/// WEFT_REPORT_TEMPLATE, else share/weft/report/report.html beside the library, in the build tree and installed alike.
ReportTemplate find_report_template();

/// The template with a session's data in it. @throws ConfigError for a template that is none.
std::string session_page(const std::string& page_template, const SessionRecord& session);
/// The template with the data of an evaluation or ablation: whichever of planning.json, estimation.json,
/// prediction.json, physics.json, ablation.json, provenance.json, config.yaml and cases.h5 lie in the folder.
/// @throws ConfigError.
std::string experiment_page(const std::string& page_template, const std::filesystem::path& folder);

/// Writes folder/report.html from the results in the folder (session.h5, or those of experiment_page).
/// @return why no page was written; empty if one was. @throws ConfigError for damaged results.
std::string write_report(const std::filesystem::path& folder);

}  // namespace weft
