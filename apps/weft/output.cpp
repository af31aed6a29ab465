#include "output.hpp"

#include <nlohmann/json.hpp>
#include <thread>

#include "report/page.hpp"
#include "sdk/files.hpp"
#include "weft_commit.hpp"

namespace weft::app {

namespace fs = std::filesystem;

fs::path session_file(const std::string& given) {
  const fs::path file = fs::is_directory(given) ? fs::path(given) / "session.h5" : fs::path(given);
  if (!fs::exists(file)) throw ConfigError(file.string() + ": no such file, must be session.h5 or the folder of a run");
  return file;
}

fs::path output_folder(const Context& context, const std::string& name) {
  const fs::path folder = context.out.empty() ? fs::path("results") / name : fs::path(context.out);
  make_writable_folder(folder);
  return folder;
}

std::string provenance_json(const PluginRegistry& registry, const Host& host, std::uint64_t seed) {
  auto plugins = nlohmann::ordered_json::array();
  for (const auto& entry : registry.used()) {
    plugins.push_back({{"kind", entry.kind}, {"name", entry.name}, {"version", entry.version}});
  }
  return nlohmann::ordered_json{{"weft", WEFT_VERSION},      {"commit", WEFT_COMMIT},
                                {"compiler", __VERSION__},   {"seed", seed},
                                {"threads", host.threads()}, {"cores", std::thread::hardware_concurrency()},
                                {"plugins", plugins}}
             .dump(2) +
         "\n";
}

void write_garment(const Task& task, const fs::path& folder) {
  const auto& garment = *task.garment;
  write_obj(folder / "garment.obj", {garment.positions, garment.faces, garment.rest, garment.name}, true);
}

ConfigNode self_contained(const ConfigNode& resolved, const std::vector<ParamInfo>& params, const Task& task,
                          const PluginRegistry& registry, const fs::path& folder) {
  write_garment(task, folder);
  return self_contained(resolved, params, task, registry);
}

ConfigNode self_contained(const ConfigNode& resolved, const std::vector<ParamInfo>& params, const Task& task,
                          const PluginRegistry& registry) {
  const auto& garment = *task.garment;
  std::vector<std::pair<std::string, ConfigNode>> vertices;
  for (const auto& [name, index] : garment.vertices) vertices.emplace_back(name, ConfigNode::integer(index));
  const ConfigNode config = resolved
                                .with("garment", ConfigNode::mapping({{"mesh", ConfigNode::quoted("garment.obj")},
                                                                      {"name", ConfigNode::quoted(garment.name)},
                                                                      {"vertices", ConfigNode::mapping(vertices)}}))
                                .with("material", write_material_space(task.material));
  return registry.resolve_slots(config, params);
}

void write_page(const Context& context, const fs::path& folder) {
  const std::string why_not = write_report(folder);
  context.say(why_not.empty() ? "to look at it, open " + (folder / "report.html").string()
                              : "no report.html: " + why_not);
}

}  // namespace weft::app
