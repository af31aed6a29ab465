#pragma once
#include <string>
#include <vector>

#include "experiments/benchmark/measure.hpp"

namespace weft::benchmark {

/// All samples of a row, in the order in which they were taken.
struct Measured {
  Row row;
  std::vector<nlohmann::ordered_json> samples = {};  ///< Sample::numbers
  std::string left_out = {};                         ///< why there are none; empty: there are, or will be
};

/// Rows with their samples as speed.json keeps them: {row, repeats, left_out or samples and, for every number, median, least
/// and most}. Rows without either are left away.
nlohmann::ordered_json to_json(const std::vector<Measured>& rows);
/// @throws nlohmann::json::exception for another form.
std::vector<Measured> measured_of(const nlohmann::ordered_json& json);

/// Median of a number over the samples; NaN without samples.
double median_of(const Measured& one, const std::string& number);

/// The tables of a part, in the form that measurement_page() takes, from the rows that have samples or were left out.
/// Their labels are "PART/...". Empty: there are no such rows.
nlohmann::ordered_json tables_of(const std::string& part, const std::vector<Measured>& rows);

}  // namespace weft::benchmark
