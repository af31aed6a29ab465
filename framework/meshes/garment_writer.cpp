#include "meshes/garment_writer.hpp"

#include "weft/rest_shape.hpp"

namespace weft {
namespace {

constexpr double kMostStrain = 0.02;  // what read_garment() takes without a reason

std::string rest_file_of(const std::string& mesh_file) {
  return std::filesystem::path(mesh_file).stem().string() + "_rest.obj";
}

}  // namespace

void write_garment_meshes(const std::filesystem::path& mesh_file, const Garment& garment) {
  const bool frames = garment.has_frames();
  write_obj(mesh_file, {garment.positions, garment.faces, frames ? RestPositions(0, 2) : garment.rest, garment.name},
            true);
  if (!frames) return;
  Mesh rest;
  rest.positions = Positions::Zero(3 * garment.face_count(), 3);
  rest.faces.resize(garment.face_count(), 3);
  for (Index f = 0; f < garment.face_count(); ++f) {
    const auto frame = garment.form.frames.row(f);
    rest.positions.row(3 * f + 1).head<2>() = frame.head<2>();
    rest.positions.row(3 * f + 2).head<2>() = frame.tail<2>();
    const int first = static_cast<int>(3 * f);
    rest.faces.row(f) << first, first + 1, first + 2;
  }
  write_obj(mesh_file.parent_path() / rest_file_of(mesh_file.filename().string()), rest, true);
}

ConfigNode garment_node(const std::string& mesh_file, const Garment& garment) {
  std::vector<std::pair<std::string, ConfigNode>> vertices;
  for (const auto& [name, index] : garment.vertices) vertices.emplace_back(name, ConfigNode::integer(index));
  std::vector<std::pair<std::string, ConfigNode>> entries{{"mesh", ConfigNode::quoted(mesh_file)},
                                                          {"name", ConfigNode::quoted(garment.name)},
                                                          {"vertices", ConfigNode::mapping(std::move(vertices))}};
  const bool strained = median_strain(garment) > kMostStrain;
  if (garment.has_frames() || strained) {
    std::vector<std::pair<std::string, ConfigNode>> rest;
    if (garment.has_frames()) {
      rest = {{"from", ConfigNode::scalar("file")},
              {"file", ConfigNode::quoted(rest_file_of(mesh_file))},
              {"warp", ConfigNode::scalar("x")}};
    } else {
      rest = {{"from", ConfigNode::scalar("texture")}};
    }
    if (strained) rest.emplace_back("strained", ConfigNode::quoted("as it was given"));
    entries.emplace_back("rest", ConfigNode::mapping(std::move(rest)));
  }
  if (!garment.form.layers.empty()) {
    std::vector<ConfigNode> layers;
    for (const double layer : garment.form.layers) layers.push_back(ConfigNode::number(layer));
    entries.emplace_back("layers", ConfigNode::sequence(std::move(layers)));
    entries.emplace_back("seams", ConfigNode::mapping({{"bend", ConfigNode::boolean(garment.form.seams.rows() == 0)}}));
  }
  return ConfigNode::mapping(std::move(entries));
}

}  // namespace weft
