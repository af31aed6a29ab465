// Meshes, fabrics and the info of plugins.
#include <algorithm>
#include <cstring>

#include "fuzz.hpp"
#include "loader/plugin_info.hpp"
#include "sdk/obj_file.hpp"
#include "weft/config.hpp"
#include "weft/garment.hpp"
#include "weft/material.hpp"
#include "weft/mesh.hpp"
#include "weft/plugin.hpp"
#include "weft/trajectory.hpp"

namespace weft::fuzz {

void obj(std::string_view text) {
  const auto file = world().write("input.obj", text);
  refusal([&] { read_obj_file(file, false); });  // as `weft garment import` reads it
  refusal([&] {
    const Garment garment = read_garment(ConfigNode::quoted(file.string()));
    const Mesh mesh{garment.positions, garment.faces, garment.rest, garment.name};
    write_obj(world().file("output.obj"), mesh, true);
    if (read_garment(ConfigNode::quoted(world().file("output.obj").string())).hash != garment.hash)
      finding("a written garment reads back as another one");
  });
}

void fabric(std::string_view json) {
  const auto file = world().write("input.json", json);
  refusal([&] {
    const Fabric fabric = read_fabric(ConfigNode::quoted(file.string()));
    const std::string saved = write_fabric(fabric).to_yaml();
    const Fabric again = read_fabric(ConfigNode::parse(saved, "saved"));
    if (write_fabric(again).to_yaml() != saved) finding("a saved fabric reads back as another one:\n" + saved);
    MaterialSpace space = world().task.material;
    space.nominal = fabric;
    space.at(MaterialProperties::Constant(0.5));
  });
}

/// The first byte says where in a valid info the rest goes.
void plugin_info(std::string_view bytes) {
  WeftPluginInfo info = make_plugin_info<Trajectory>("square", "1.0.0");
  std::size_t at = 0;
  if (!bytes.empty()) {
    at = static_cast<unsigned char>(bytes[0]) * sizeof(info) / 256;
    bytes.remove_prefix(1);
  }
  std::memcpy(reinterpret_cast<char*>(&info) + at, bytes.data(), std::min(bytes.size(), sizeof(info) - at));
  const std::string reason = refusal([&] {
    const PluginEntry entry = checked_plugin_info(info, "/plugins/libsquare.so");
    if (entry.kind.empty() || entry.name.empty() || entry.version.empty()) finding("a plugin without a name");
  });
  for (const char c : reason)
    if (static_cast<unsigned char>(c) < ' ' || static_cast<unsigned char>(c) > '~')
      finding("a refusal that cannot be printed: " + reason);
}

}  // namespace weft::fuzz
