#pragma once
#include <nlohmann/json.hpp>
#include <string>

namespace weft {

/// A page of docs/measurements, made of its JSON alone: title, a line that says where the numbers come from, and for every
/// step its commands and tables.
/// @param json {title, about, size, commit, models: [{file, sha256}], machine: {processor, cores}, date, steps: [{name, title,
/// commands, seeds: {first, count} or null}], tables: [{label: "STEP/...", caption, texts, columns: [{name, head, unit,
/// digits}], rows}]}. A cell is a text, a number, an interval [lower, upper], or null: nothing to show.
/// @throws nlohmann::json::exception for another form.
std::string measured_markdown(const nlohmann::ordered_json& json);

}  // namespace weft
