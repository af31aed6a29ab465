#include "metadata.hpp"

#include <cmath>

#include "weft/config.hpp"

namespace weft::torchscript {
namespace {

std::string join(const std::vector<std::string>& words) {
  std::string text;
  for (const auto& w : words) text += (text.empty() ? "" : " ") + w;
  return text.empty() ? "nothing" : text;
}

}  // namespace

Metadata read_metadata(const std::filesystem::path& file) {
  Metadata metadata;
  read_params(ConfigNode::load(file), metadata);
  return metadata;
}

void require_task(const Metadata& m, const std::string& file, const Task& task) {
  const auto refuse = [&](const std::string& what, const std::string& given, const std::string& wanted) {
    throw ConfigError(file + ": " + what + " = " + given + ", the task has " + wanted);
  };
  const auto names = [](const std::vector<Variable>& variables) {
    std::vector<std::string> all;
    for (const auto& v : variables) all.push_back(v.name);
    return all;
  };
  const auto number = [](double x) { return ConfigNode::number(x).as_string(); };
  const auto numbers = [&](const std::vector<double>& v) {
    std::string text;
    for (const double x : v) text += (text.empty() ? "" : ", ") + number(x);
    return "[" + text + "]";
  };
  const auto& manipulation = task.manipulation;
  if (m.garment_hash != std::to_string(task.garment->hash))
    refuse("garment_hash", m.garment_hash, std::to_string(task.garment->hash));
  if (m.controls != names(task.trajectory->controls()))
    refuse("controls", join(m.controls), join(names(task.trajectory->controls())));
  if (m.states != names(task.trajectory->state()))
    refuse("states", join(m.states), join(names(task.trajectory->state())));
  const std::vector<double> held(manipulation.grasp_vertices.begin(), manipulation.grasp_vertices.end());
  if (m.grasp_vertices != held) refuse("grasp_vertices", numbers(m.grasp_vertices), numbers(held));
  const std::vector<double> d = {manipulation.displacement.x(), manipulation.displacement.y()};
  if (m.displacement_m.size() != 2 || std::abs(m.displacement_m[0] - d[0]) > 1e-6 ||
      std::abs(m.displacement_m[1] - d[1]) > 1e-6) {
    refuse("displacement_m", numbers(m.displacement_m), numbers(d));
  }
  if (std::abs(m.drop_height_m - manipulation.drop_height) > 1e-6) {
    refuse("drop_height_m", number(m.drop_height_m), number(manipulation.drop_height));
  }
  const std::vector<double> opens_at(manipulation.opens_at.begin(), manipulation.opens_at.end());
  if (m.opens_at != opens_at) refuse("opens_at", numbers(m.opens_at), numbers(opens_at));
  const auto lists = [&](const std::vector<double>& a, const std::string& name_a, const std::vector<double>& b,
                         const std::string& name_b, const std::vector<std::string>& variables) {
    for (const auto& [name, values] : {std::pair(name_a, a), std::pair(name_b, b)}) {
      if (values.size() != variables.size() && !(a.empty() && b.empty()))
        refuse(name, numbers(values), std::to_string(variables.size()) + " variables: " + join(variables));
    }
  };
  lists(m.control_low, "control_low", m.control_high, "control_high", m.controls);
  lists(m.control_mean, "control_mean", m.control_sd, "control_sd", m.controls);
  lists(m.state_mean, "state_mean", m.state_sd, "state_sd", m.states);
  const auto variables = task.trajectory->controls();
  for (std::size_t c = 0; c < m.control_low.size(); ++c) {
    const auto& v = variables[c];
    const double low = m.control_low[c], high = m.control_high[c];
    if (low > high) {
      throw ConfigError(file + ": control_low of " + v.name + " = " + number(low) +
                        ", above control_high = " + number(high));
    }
    if (low > v.upper || high < v.lower)
      refuse("range of " + v.name, numbers({low, high}), numbers({v.lower, v.upper}) + ", without overlap");
  }
}

}  // namespace weft::torchscript
