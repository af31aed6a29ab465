#pragma once
#include <filesystem>
#include <map>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "report/paper_tables.hpp"

/// Measurements: NAME.json, and what documents show of it (docs/reproduce.md).
namespace weft {

inline constexpr const char* kMeasurementSchema = "weft measurement 1";

/// A table as a measurement keeps it, and back. @throws nlohmann::json::exception for what is no table.
nlohmann::ordered_json json_of_table(const PaperTable& table);
PaperTable table_of_json(const nlohmann::ordered_json& json);

/// The page of a measurement, NAME.md: made of NAME.json alone. @throws nlohmann::json::exception if that is damaged.
std::string measurement_page(const nlohmann::ordered_json& measurement);

/// The measurements of a folder by name.
using Measurements = std::map<std::string, nlohmann::ordered_json>;
/// Reads every NAME.json of the folder that is a measurement; other files are ignored. @throws ConfigError for a damaged one,
/// and for one that another name is written in.
Measurements read_measurements(const std::filesystem::path& folder);

/// A document in which everything between `<!-- measured NAME TABLE -->` and `<!-- end -->` is the table of that measurement, and
/// between `<!-- measured NAME TABLE; ROW; COLUMN -->` and `<!-- end -->` the cell. ROW holds the words of the row with a comma
/// between them, or the first number of a row without words. Code is left as it is.
/// @param where for messages. @throws ConfigError naming line and mark for what is not there.
std::string with_measured(const std::string& document, const Measurements& measurements, const std::string& where);

/// A document that is not as the measurements have it.
struct StalePage {
  std::filesystem::path file;
  std::string text;  ///< what it must hold
};
/// What differs: the pages of the folder's measurements, and the blocks in the documents of its parent folder and in the README.md
/// above that, as docs/measurements, docs and README.md lie.
/// @throws ConfigError as the functions above; also for a page that was made of a measurement which is not there, and for one
/// that somebody wrote by hand and that has the name of a measurement.
std::vector<StalePage> stale_pages(const std::filesystem::path& folder);

}  // namespace weft
