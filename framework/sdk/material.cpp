#include "weft/material.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>
#include <sstream>

#include "sdk/files.hpp"
#include "sdk/json_text.hpp"
#include "weft/config.hpp"

namespace weft {
namespace {

constexpr double kUnlimited = std::numeric_limits<double>::max();

std::string text_of(double value) { return ConfigNode::number(value).as_string(); }

/// Reads a finite number in [low, high], or in (low, high] if `open`.
double number_in(const ConfigNode& node, double low, double high, bool open = false) {
  const double value = node.as_double();
  if (!std::isfinite(value) || value < low || (open && value == low) || value > high) {
    std::string wanted = "must be finite";
    if (high < kUnlimited) {
      wanted = "must be in " + std::string(open ? "(" : "[") + text_of(low) + ", " + text_of(high) + "]";
    } else if (low > -kUnlimited) {
      wanted = "must be finite and " + std::string(open ? "greater than " : "at least ") + text_of(low);
    }
    node.fail("= " + node.as_string() + ", " + wanted);
  }
  return value;
}

void read_positive(const ConfigNode& node, const char* key, double& value, double high = kUnlimited) {
  if (const auto found = node.find(key)) value = number_in(*found, 0.0, high, true);
}
void read_non_negative(const ConfigNode& node, const char* key, double& value, double high = kUnlimited) {
  if (const auto found = node.find(key)) value = number_in(*found, 0.0, high);
}

const std::vector<std::string> kPropertyKeys = {"density_kg_per_m2", "stretch_n_per_m", "poisson",     "bend_n_m",
                                                "friction",          "self_friction",   "thickness_m", "damping"};
// Keys that a mapping may add to an ARCSim file.
const std::vector<std::string> kTableOverrides = {"density_kg_per_m2", "friction", "self_friction", "thickness_m",
                                                  "damping"};
const std::vector<std::string> kMultipliers = {"stretch_multiplier", "bend_multiplier"};

std::vector<std::string> joined(std::vector<std::string> a, const std::vector<std::string>& b) {
  a.insert(a.end(), b.begin(), b.end());
  return a;
}

void check_bending(const Fabric& fabric, const ConfigNode& node) {
  //     B(p) = Bw c^4 + Bf s^4 + (4 Bb - Bw - Bf) c^2 s^2
  // is nowhere negative iff the factor of the mixed term is at least -2 sqrt(Bw Bf).
  const double mixed = 4.0 * fabric.bend_bias_n_m - fabric.bend_warp_n_m - fabric.bend_weft_n_m;
  const double least = -2.0 * std::sqrt(fabric.bend_warp_n_m * fabric.bend_weft_n_m);
  if (mixed < least * (1.0 + 1e-12)) {
    node.fail("bias = " + text_of(fabric.bend_bias_n_m) +
              " makes the bending stiffness negative between the yarns, must be at least " +
              text_of((least + fabric.bend_warp_n_m + fabric.bend_weft_n_m) / 4.0));
  }
}

/// Sets the constants to the tables' values at zero strain and zero curvature, times the multipliers. Simulators that
/// do not read tables use them. They depend on tables and multipliers only, so a written fabric reads back to the same
/// bits.
void constants_from_tables(Fabric& fabric) {
  const auto& row = fabric.tables->stretching[0];
  const double c11 = 2.0 * std::max(row[0], 0.0);
  const double c12 = 2.0 * std::max(row[1], 0.0);
  const double c22 = 2.0 * std::max(row[2], 0.0);
  const double c33 = 2.0 * std::max(row[3], 0.0);
  // C11 = Kw / (1 - nu12 nu21), C22 = Kf / (1 - nu12 nu21), C12 = nu12 C22 = nu21 C11; W has C33 E12^2, so G = C33 / 2.
  // Measured tables need not be positive definite, so the coupling is limited.
  const double coupling = c11 > 0.0 && c22 > 0.0 ? std::min(c12, 0.95 * std::sqrt(c11 * c22)) : 0.0;
  fabric.poisson = c22 > 0.0 ? coupling / c22 : 0.0;
  const double share = c11 > 0.0 && c22 > 0.0 ? 1.0 - coupling * coupling / (c11 * c22) : 1.0;
  fabric.stretch_warp_n_per_m = c11 * share * fabric.stretch_multiplier;
  fabric.stretch_weft_n_per_m = c22 * share * fabric.stretch_multiplier;
  fabric.stretch_shear_n_per_m = c33 / 2.0 * fabric.stretch_multiplier;
  // A row is a direction of the bend axis. The warp bends about the weft (90 deg).
  fabric.bend_warp_n_m = fabric.tables->bending[2][0] / 4.0 * fabric.bend_multiplier;
  fabric.bend_weft_n_m = fabric.tables->bending[0][0] / 4.0 * fabric.bend_multiplier;
  fabric.bend_bias_n_m = fabric.tables->bending[1][0] / 4.0 * fabric.bend_multiplier;
}

void read_properties(const ConfigNode& node, Fabric& fabric) {
  read_positive(node, "density_kg_per_m2", fabric.density_kg_per_m2, 1e3);
  read_non_negative(node, "friction", fabric.friction, 100.0);
  read_non_negative(node, "self_friction", fabric.self_friction, 100.0);
  read_non_negative(node, "thickness_m", fabric.thickness_m, 1.0);
  if (const auto damping = node.find("damping")) {
    damping->refuse_unknown_keys({"stretch_s", "bend_s", "air_per_s"});
    read_non_negative(*damping, "stretch_s", fabric.damping_stretch_s, 1e3);
    read_non_negative(*damping, "bend_s", fabric.damping_bend_s, 1e3);
    read_non_negative(*damping, "air_per_s", fabric.damping_air_per_s, 1e3);
  }
}

void read_elasticity(const ConfigNode& node, Fabric& fabric) {
  if (const auto poisson = node.find("poisson")) fabric.poisson = number_in(*poisson, -0.99, 10.0);
  if (const auto stretch = node.find("stretch_n_per_m")) {
    stretch->refuse_unknown_keys({"warp", "weft", "shear"});
    stretch->at("warp");
    stretch->at("weft");
    read_positive(*stretch, "warp", fabric.stretch_warp_n_per_m, 1e9);
    read_positive(*stretch, "weft", fabric.stretch_weft_n_per_m, 1e9);
    fabric.stretch_shear_n_per_m =
        (fabric.stretch_warp_n_per_m + fabric.stretch_weft_n_per_m) / 4.0 / (1.0 + fabric.poisson);
    read_positive(*stretch, "shear", fabric.stretch_shear_n_per_m, 1e9);
  }
  // nu12 nu21 = nu12^2 Kf / Kw < 1: otherwise the membrane's energy has no minimum at rest.
  if (fabric.poisson * fabric.poisson * fabric.stretch_weft_n_per_m >= 0.999 * fabric.stretch_warp_n_per_m) {
    const double limit = std::sqrt(0.999 * fabric.stretch_warp_n_per_m / fabric.stretch_weft_n_per_m);
    node.fail("poisson = " + text_of(fabric.poisson) + ", must be below " + text_of(limit) +
              " (nu12 < sqrt(K_warp / K_weft)) for this stretch_n_per_m");
  }
  if (const auto bend = node.find("bend_n_m")) {
    bend->refuse_unknown_keys({"warp", "weft", "bias"});
    bend->at("warp");
    bend->at("weft");
    read_non_negative(*bend, "warp", fabric.bend_warp_n_m, 1e3);
    read_non_negative(*bend, "weft", fabric.bend_weft_n_m, 1e3);
    fabric.bend_bias_n_m = (fabric.bend_warp_n_m + fabric.bend_weft_n_m) / 2.0;
    read_non_negative(*bend, "bias", fabric.bend_bias_n_m, 1e3);
    check_bending(fabric, *bend);
  }
}

Fabric with_multipliers(const ConfigNode& node, const Fabric& fabric) {
  double stretch = 1.0;
  double bend = 1.0;
  read_positive(node, "stretch_multiplier", stretch, 1e6);
  read_positive(node, "bend_multiplier", bend, 1e6);
  return stretch == 1.0 && bend == 1.0 ? fabric : fabric.scaled(stretch, bend);
}

/// Table of numbers, `rows` x `columns`, from the `tables:` that write_fabric wrote.
template <std::size_t rows, std::size_t columns>
void read_table(const ConfigNode& node, std::array<std::array<double, columns>, rows>& table, bool negative_allowed) {
  if (!node.is_sequence() || node.size() != rows) node.fail("must have " + std::to_string(rows) + " rows");
  for (std::size_t r = 0; r < rows; ++r) {
    const ConfigNode row = node[r];
    if (!row.is_sequence() || row.size() != columns) row.fail("must have " + std::to_string(columns) + " numbers");
    for (std::size_t c = 0; c < columns; ++c) {
      table[r][c] = number_in(row[c], negative_allowed ? -kUnlimited : 0.0, kUnlimited);
    }
  }
}

// --- ARCSim/ARGUS material files ---

template <std::size_t rows, std::size_t columns>
void read_json_table(const nlohmann::json& json, const std::string& where, const char* key,
                     std::array<std::array<double, columns>, rows>& table, bool negative_allowed) {
  if (!json.contains(key))
    throw ConfigError(where + key + " is missing, must be " + std::to_string(rows) + " rows of " +
                      std::to_string(columns) + " numbers");
  const auto& value = json.at(key);
  if (!value.is_array() || value.size() != rows) {
    throw ConfigError(where + key + " has " + (value.is_array() ? std::to_string(value.size()) + " rows" : "no rows") +
                      ", must have " + std::to_string(rows));
  }
  for (std::size_t r = 0; r < rows; ++r) {
    const std::string row_name = std::string(key) + "[" + std::to_string(r) + "]";
    const auto& row = value[r];
    if (!row.is_array() || row.size() != columns) {
      throw ConfigError(where + row_name + " has " +
                        (row.is_array() ? std::to_string(row.size()) + " numbers" : "no numbers") + ", must have " +
                        std::to_string(columns));
    }
    for (std::size_t c = 0; c < columns; ++c) {
      const std::string name = row_name + "[" + std::to_string(c) + "]";
      if (!row[c].is_number()) throw ConfigError(where + name + " = " + row[c].dump() + ", must be a number");
      const double number = row[c].get<double>();
      if (!std::isfinite(number)) throw ConfigError(where + name + " must be finite");
      if (!negative_allowed && number < 0.0) {
        throw ConfigError(where + name + " = " + text_of(number) + ", must be at least 0");
      }
      table[r][c] = number;
    }
  }
}

Fabric read_arcsim(const std::filesystem::path& path) {
  const std::string text = whole_text(path);
  nlohmann::json json;
  try {
    json = parse_json<nlohmann::json>(text, true);
  } catch (const nlohmann::json::exception& error) {
    throw ConfigError(path.string() + ": not valid JSON: " + error.what());
  }
  const std::string where = path.string() + ": ";
  if (!json.is_object()) throw ConfigError(where + "must be an object {density, stretching, bending}");
  const std::vector<std::string> known = {"density", "stretching",         "bending",
                                          "name",    "stretch_multiplier", "bend_multiplier"};
  for (const auto& entry : json.items()) {
    if (std::find(known.begin(), known.end(), entry.key()) == known.end()) {
      throw ConfigError(where + entry.key() + " is not a known key" + nearest_hint(entry.key(), known));
    }
  }
  Fabric fabric;
  fabric.name = path.stem().string();
  if (!json.contains("density") || !json["density"].is_number()) {
    throw ConfigError(where + "density is missing, must be a number [kg/m2]");
  }
  fabric.density_kg_per_m2 = json["density"].get<double>();
  if (!std::isfinite(fabric.density_kg_per_m2) || fabric.density_kg_per_m2 <= 0.0 || fabric.density_kg_per_m2 > 1e3) {
    throw ConfigError(where + "density = " + json["density"].dump() + ", must be in (0, 1000]");
  }
  auto tables = std::make_shared<MaterialTables>();
  // Fitted entries can be below zero. A simulator clamps them, as the format prescribes.
  read_json_table(json, where, "stretching", tables->stretching, true);
  read_json_table(json, where, "bending", tables->bending, false);
  if (!(tables->stretching[0][0] > 0.0 && tables->stretching[0][2] > 0.0 && tables->stretching[0][3] > 0.0)) {
    throw ConfigError(
        where + "stretching[0] must have c11, c22 and c33 greater than 0: the cloth would have no stiffness at rest");
  }
  fabric.tables = std::move(tables);
  constants_from_tables(fabric);
  double stretch = 1.0;
  double bend = 1.0;
  for (const auto& [key, value] : {std::pair{"stretch_multiplier", &stretch}, std::pair{"bend_multiplier", &bend}}) {
    if (!json.contains(key)) continue;
    if (json[key].is_number()) *value = json[key].get<double>();
    if (!json[key].is_number() || !std::isfinite(*value) || *value <= 0.0 || *value > 1e6) {
      throw ConfigError(where + key + " = " + json[key].dump() + ", must be in (0, 1000000]");
    }
  }
  return stretch == 1.0 && bend == 1.0 ? fabric : fabric.scaled(stretch, bend);
}

Fabric read_fabric_mapping(const ConfigNode& node, const std::string& default_name);

Fabric read_fabric_file(const ConfigNode& node) {
  const std::filesystem::path path = node.as_path();
  const std::string extension = path.extension().string();
  if (extension == ".json") return read_arcsim(path);
  if (extension != ".yaml" && extension != ".yml") {
    node.fail("= " + node.as_string() + ", must be a fabric .yaml or an ARCSim/ARGUS material .json");
  }
  return read_fabric_mapping(ConfigNode::load(path), path.stem().string());
}

Fabric read_fabric_mapping(const ConfigNode& node, const std::string& default_name) {
  if (!node.is_mapping()) node.fail("must be a mapping of a fabric's properties");
  Fabric fabric;
  fabric.name = default_name;
  if (const auto file = node.find("file")) {
    fabric = read_fabric_file(*file);
    // The tables of an ARCSim file define its elasticity, so constants for it are not allowed.
    node.refuse_unknown_keys(joined(joined({"file", "name", "source", "drape"}, kMultipliers),
                                    fabric.tables ? kTableOverrides : kPropertyKeys));
  } else {
    node.refuse_unknown_keys(
        joined(joined({"file", "name", "source", "drape", "tables"}, kMultipliers), kPropertyKeys));
  }
  if (const auto name = node.find("name")) fabric.name = name->as_string();
  if (const auto source = node.find("source")) source->as_string();
  if (const auto drape = node.find("drape")) drape->refuse_unknown_keys({"percent", "source"});
  read_properties(node, fabric);
  if (const auto tables = node.find("tables")) {
    tables->refuse_unknown_keys({"stretching", "bending"});
    for (const char* key : {"stretch_n_per_m", "bend_n_m", "poisson"}) {
      if (const auto both = node.find(key)) both->fail("must not be given together with tables");
    }
    auto read = std::make_shared<MaterialTables>();
    read_table(tables->at("stretching"), read->stretching, true);
    read_table(tables->at("bending"), read->bending, false);
    fabric.tables = std::move(read);
    constants_from_tables(fabric);
  } else if (!fabric.tables) {
    read_elasticity(node, fabric);
  }
  return with_multipliers(node, fabric);
}

template <std::size_t rows, std::size_t columns>
ConfigNode write_table(const std::array<std::array<double, columns>, rows>& table) {
  std::vector<ConfigNode> lines;
  for (const auto& row : table) {
    std::vector<ConfigNode> numbers;
    for (const double value : row) numbers.push_back(ConfigNode::number(value));
    lines.push_back(ConfigNode::sequence(std::move(numbers)));
  }
  return ConfigNode::sequence(std::move(lines));
}

}  // namespace

Fabric Fabric::scaled(double stretch, double bend) const {
  if (!(stretch > 0.0) || !(bend > 0.0) || !std::isfinite(stretch) || !std::isfinite(bend)) {
    throw Error("fabric " + name + ": multipliers stretch " + text_of(stretch) + " and bend " + text_of(bend) +
                ", must be finite and greater than 0");
  }
  Fabric result = *this;
  if (tables) {
    result.stretch_multiplier *= stretch;
    result.bend_multiplier *= bend;
    constants_from_tables(result);
    return result;
  }
  result.stretch_warp_n_per_m *= stretch;
  result.stretch_weft_n_per_m *= stretch;
  result.stretch_shear_n_per_m *= stretch;
  result.bend_warp_n_m *= bend;
  result.bend_weft_n_m *= bend;
  result.bend_bias_n_m *= bend;
  return result;
}

Fabric read_fabric(const ConfigNode& node) {
  if (node.is_scalar()) return read_fabric_file(node);
  if (!node.is_mapping()) node.fail("must be a mapping of a fabric's properties, a fabric .yaml or a material .json");
  return read_fabric_mapping(node, "fabric");
}

ConfigNode write_fabric(const Fabric& fabric) {
  const auto number = [](double value) { return ConfigNode::number(value); };
  std::vector<std::pair<std::string, ConfigNode>> entries;
  if (!fabric.name.empty()) entries.emplace_back("name", ConfigNode::quoted(fabric.name));
  entries.emplace_back("density_kg_per_m2", number(fabric.density_kg_per_m2));
  if (fabric.tables) {
    entries.emplace_back("tables", ConfigNode::mapping({{"stretching", write_table(fabric.tables->stretching)},
                                                        {"bending", write_table(fabric.tables->bending)}}));
    entries.emplace_back("stretch_multiplier", number(fabric.stretch_multiplier));
    entries.emplace_back("bend_multiplier", number(fabric.bend_multiplier));
  } else {
    entries.emplace_back("stretch_n_per_m", ConfigNode::mapping({{"warp", number(fabric.stretch_warp_n_per_m)},
                                                                 {"weft", number(fabric.stretch_weft_n_per_m)},
                                                                 {"shear", number(fabric.stretch_shear_n_per_m)}}));
    entries.emplace_back("poisson", number(fabric.poisson));
    entries.emplace_back("bend_n_m", ConfigNode::mapping({{"warp", number(fabric.bend_warp_n_m)},
                                                          {"weft", number(fabric.bend_weft_n_m)},
                                                          {"bias", number(fabric.bend_bias_n_m)}}));
  }
  entries.emplace_back("friction", number(fabric.friction));
  entries.emplace_back("self_friction", number(fabric.self_friction));
  entries.emplace_back("thickness_m", number(fabric.thickness_m));
  entries.emplace_back("damping", ConfigNode::mapping({{"stretch_s", number(fabric.damping_stretch_s)},
                                                       {"bend_s", number(fabric.damping_bend_s)},
                                                       {"air_per_s", number(fabric.damping_air_per_s)}}));
  return ConfigNode::mapping(std::move(entries));
}

double PropertyRange::at(double q) const {
  // Return the ends exactly; exp and log would round.
  if (q == 0.0) return low;
  if (q == 1.0) return high;
  return logarithmic ? low * std::exp(q * std::log(high / low)) : low + q * (high - low);
}

double PropertyRange::inverse(double v) const {
  return logarithmic ? std::log(v / low) / std::log(high / low) : (v - low) / (high - low);
}

Fabric MaterialSpace::at(const MaterialProperties& q) const {
  constexpr double kSlack = 1e-9;
  std::array<double, 4> value{};
  for (std::size_t p = 0; p < 4; ++p) {
    const double raw = q[p];
    if (!(raw >= -kSlack && raw <= 1.0 + kSlack)) {
      throw ConfigError(std::string("material property ") + kPropertyNames[p] + " = " + text_of(raw) +
                        ", must be in [0, 1]");
    }
    value[p] = ranges[p].at(std::clamp(raw, 0.0, 1.0));
  }
  Fabric fabric = nominal.scaled(value[2], value[1]);
  // Self friction keeps its ratio to ground friction. A nominal fabric without ground friction has no ratio.
  fabric.self_friction = nominal.friction > 0.0 ? nominal.self_friction * (value[0] / nominal.friction) : value[0];
  fabric.friction = value[0];
  fabric.thickness_m = value[3];
  return fabric;
}

MaterialSpace read_material_space(const ConfigNode& node) {
  if (node.is_scalar()) return blaming(node, [&] { return read_material_space(ConfigNode::load(node.as_path())); });
  if (!node.is_mapping()) node.fail("must be a mapping {nominal, properties} or the path of such a file");
  node.refuse_unknown_keys({"nominal", "properties"});
  MaterialSpace space;
  space.nominal = read_fabric(node.at("nominal"));
  const ConfigNode properties = node.at("properties");
  properties.refuse_unknown_keys({kPropertyNames.begin(), kPropertyNames.end()});
  for (std::size_t p = 0; p < 4; ++p) {
    const ConfigNode entry = properties.at(kPropertyNames[p]);
    entry.refuse_unknown_keys({"low", "high", "scale"});
    PropertyRange& range = space.ranges[p];
    const std::string scale = entry.has("scale") ? entry.at("scale").as_string() : "linear";
    if (scale != "log" && scale != "linear") entry.at("scale").fail("= " + scale + ", must be log or linear");
    range.logarithmic = scale == "log";
    // Multipliers and logarithmic ranges must start above 0; linear ranges of friction and thickness may start at 0.
    const bool open = range.logarithmic || p == 1 || p == 2;
    range.low = number_in(entry.at("low"), 0.0, 1e6, open);
    range.high = number_in(entry.at("high"), 0.0, 1e6, open);
    if (!(range.low < range.high)) {
      entry.fail("low = " + text_of(range.low) + ", must be less than high = " + text_of(range.high));
    }
  }
  return space;
}

ConfigNode write_material_space(const MaterialSpace& space) {
  std::vector<std::pair<std::string, ConfigNode>> properties;
  for (std::size_t p = 0; p < 4; ++p) {
    const PropertyRange& range = space.ranges[p];
    properties.emplace_back(kPropertyNames[p],
                            ConfigNode::mapping({{"low", ConfigNode::number(range.low)},
                                                 {"high", ConfigNode::number(range.high)},
                                                 {"scale", ConfigNode::scalar(range.logarithmic ? "log" : "linear")}}));
  }
  return ConfigNode::mapping(
      {{"nominal", write_fabric(space.nominal)}, {"properties", ConfigNode::mapping(std::move(properties))}});
}

}  // namespace weft
