#include "session/world.hpp"

#include <algorithm>
#include <cmath>

#include "simulation/task_config.hpp"
#include "weft/config.hpp"
#include "weft/random.hpp"

namespace weft {
namespace {

constexpr std::uint64_t kWorldStream = stream_key("world");

/// A constant of a fabric that no property of the material space changes.
struct FabricConstant {
  const char* name;
  double Fabric::*value;
};
// Factors are drawn in this order.
constexpr FabricConstant kConstants[] = {
    {"poisson", &Fabric::poisson},
    {"bend_bias", &Fabric::bend_bias_n_m},
    {"self_friction", &Fabric::self_friction},
    {"damping_stretch", &Fabric::damping_stretch_s},
    {"damping_bend", &Fabric::damping_bend_s},
    {"damping_air", &Fabric::damping_air_per_s},
    {"density", &Fabric::density_kg_per_m2},
};

/// The valid values of a constant, as read_fabric() has them.
std::pair<double, double> valid_values(const Fabric& fabric, double Fabric::*constant) {
  if (constant == &Fabric::poisson) {
    // An isotropic solid's Poisson ratio is below 0.5. A fabric's nu12 may be above, up to sqrt(K_warp / K_weft).
    const double most = std::min(std::max(0.49, std::abs(fabric.poisson)),
                                 std::sqrt(0.99 * fabric.stretch_warp_n_per_m / fabric.stretch_weft_n_per_m));
    return {-most, most};
  }
  if (constant == &Fabric::bend_bias_n_m) {
    // Below this the bending stiffness is negative between the yarns.
    const double warp = fabric.bend_warp_n_m, weft = fabric.bend_weft_n_m;
    return {(warp + weft - 2.0 * std::sqrt(warp * weft)) / 4.0, 1e3};
  }
  return {0.0, constant == &Fabric::self_friction ? 100.0 : 1e3};
}

bool is_in_tables(double Fabric::*constant) {
  return constant == &Fabric::poisson || constant == &Fabric::bend_bias_n_m;
}

/// The factor of a constant that gives a valid value.
double valid_factor(const Fabric& fabric, double Fabric::*constant, double factor) {
  // Without ground friction the self friction is the friction of the material space.
  if (constant == &Fabric::self_friction && !(fabric.friction > 0.0)) return 1.0;
  const double value = fabric.*constant;
  if (value == 0.0 || (fabric.tables && is_in_tables(constant))) return factor;
  const auto [least, most] = valid_values(fabric, constant);
  return std::clamp(value * factor, least, most) / value;
}

std::vector<double> draw_factors(const Fabric& fabric, const WorldParams& params, std::uint64_t seed) {
  RandomStream random(seed, kWorldStream);
  std::vector<double> factors;
  for (const auto& constant : kConstants) {
    const double factor = random.uniform(1.0 - params.spread, 1.0 + params.spread);  // also of one that is known
    const bool is_known = std::find(params.known.begin(), params.known.end(), constant.name) != params.known.end();
    factors.push_back(is_known ? 1.0 : valid_factor(fabric, constant.value, factor));
  }
  return factors;
}

Fabric changed(const Fabric& fabric, const std::vector<double>& factors) {
  Fabric result = fabric;
  MaterialTables tables = fabric.tables ? *fabric.tables : MaterialTables();
  for (std::size_t i = 0; i < factors.size(); ++i) {
    result.*kConstants[i].value *= factors[i];
    if (kConstants[i].value == &Fabric::poisson)
      for (auto& row : tables.stretching) row[1] *= factors[i];  // c12
    if (kConstants[i].value == &Fabric::bend_bias_n_m)
      for (double& bias : tables.bending[1]) bias *= factors[i];  // the row of 45 deg
  }
  if (!fabric.tables) return result;
  result.tables = std::make_shared<const MaterialTables>(tables);
  return result.scaled(1.0, 1.0);  // takes the other constants from the tables
}

}  // namespace

Task world_task(const Task& task, const WorldParams& params, std::uint64_t seed) {
  Task world = task;
  if (params.spread > 0.0)
    world.material.nominal = changed(task.material.nominal, draw_factors(task.material.nominal, params, seed));
  if (!params.simulator.is_null()) world.simulator = params.simulator;
  if (task.start)
    world.start = std::make_shared<const StartShape>(StartShape{task.start->world, task.start->world, {}});
  return world;
}

std::optional<WorldRecord> world_record(const Task& task, const WorldParams& params, std::uint64_t seed) {
  if (params.is_the_tasks()) return std::nullopt;
  const ConfigNode& slot = params.simulator.is_null() ? task.simulator : params.simulator;
  WorldRecord record{params.spread, slot.is_scalar() ? slot.as_string() : slot.at("plugin").as_string(), {}};
  if (params.spread == 0.0) return record;
  const auto factors = draw_factors(task.material.nominal, params, seed);
  for (std::size_t i = 0; i < factors.size(); ++i) record.factors.emplace_back(kConstants[i].name, factors[i]);
  return record;
}

void check_world(const WorldParams& params, const Task& task, const ConfigNode& config, Host& host) {
  std::vector<std::string> names;
  for (const auto& constant : kConstants) names.emplace_back(constant.name);
  for (std::size_t k = 0; k < params.known.size(); ++k)
    if (std::find(names.begin(), names.end(), params.known[k]) == names.end())
      place(config, "world.known." + std::to_string(k))
          .fail("= " + params.known[k] + ", must be " + one_of(names) + nearest_hint(params.known[k], names));
  if (!params.simulator.is_null()) check_simulator(params.simulator, task, host);
}

}  // namespace weft
