#include "meshes/import/garment_files.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>

#include "meshes/garment_writer.hpp"
#include "meshes/import/mesh_file.hpp"
#include "meshes/plane.hpp"
#include "sdk/files.hpp"
#include "weft/config.hpp"

namespace weft {

namespace {

/// Whether the layers are those of `layers: sides`.
bool are_sides(const ImportedGarment& garment) {
  if (garment.form != RestForm::two_sides) return false;
  std::vector<double> sides(garment.layers.size(), 1.0);
  for (Index f = 0; f < garment.mesh.faces.rows(); ++f) {
    const auto at = [&](Index k) -> Vec2 { return garment.mesh.positions.row(garment.mesh.faces(f, k)).head<2>(); };
    if (cross(at(1) - at(0), at(2) - at(0)) > 0.0) continue;
    for (Index k = 0; k < 3; ++k) sides[garment.mesh.faces(f, k)] = 0.0;
  }
  return sides == garment.layers;
}

/// Lets `write` write meshes elsewhere, and puts them into the folder whole: the first one with the comment that says that it was
/// imported.
template <class Write>
void write_meshes(const std::filesystem::path& mesh_file, Write&& write) {
  const TemporaryFolder elsewhere(mesh_file.parent_path());
  write(elsewhere.path() / mesh_file.filename());
  for (const auto& one : std::filesystem::directory_iterator(elsewhere.path())) {
    const auto target = mesh_file.parent_path() / one.path().filename();
    write_text(target,
               (target == mesh_file ? "#" + std::string(kImportedComment) + "\n" : "") + whole_text(one.path()));
  }
}

}  // namespace

void write_garment_files(const std::filesystem::path& folder, const std::string& name, const ImportedGarment& garment,
                         const std::string& command) {
  const auto mesh_file = folder / (name + ".obj");
  const std::string made_by = "# Made by: " + command + "\n";
  if (garment.kept) {
    const Garment whole = garment.garment(name);
    write_meshes(mesh_file, [&](const auto& file) { write_garment_meshes(file, whole); });
    write_text(folder / (name + ".yaml"), made_by + garment_node(name + ".obj", whole).to_yaml());
    return;
  }
  write_meshes(mesh_file, [&](const auto& file) { write_obj(file, garment.mesh); });
  std::vector<std::pair<std::string, ConfigNode>> entries{{"name", ConfigNode::scalar(name)},
                                                          {"mesh", ConfigNode::scalar(name + ".obj")}};
  if (garment.form != RestForm::chart)
    entries.emplace_back("rest", ConfigNode::mapping({{"from", ConfigNode::scalar("mesh")}}));
  if (are_sides(garment)) {
    entries.emplace_back("layers", ConfigNode::scalar("sides"));
  } else if (!garment.layers.empty()) {
    std::vector<ConfigNode> layers;
    for (const double layer : garment.layers) layers.push_back(ConfigNode::number(layer));
    entries.emplace_back("layers", ConfigNode::sequence(std::move(layers)));
  }
  if (!garment.vertices.empty()) {
    std::vector<std::pair<std::string, ConfigNode>> vertices;
    for (const auto& [vertex, index] : garment.vertices) vertices.emplace_back(vertex, ConfigNode::integer(index));
    entries.emplace_back("vertices", ConfigNode::mapping(std::move(vertices)));
  }
  std::string text = made_by;
  if (garment.form == RestForm::worn) text += "# It stands as it was drawn: `weft garment lay` lays it on the table.\n";
  write_text(folder / (name + ".yaml"), text + ConfigNode::mapping(std::move(entries)).to_yaml());
}

Vec2 fold_in_two(const Mesh& mesh, Index hand_1, Index hand_2, bool along_x) {
  const Vec2 a = mesh.positions.row(hand_1).head<2>(), b = mesh.positions.row(hand_2).head<2>();
  const Vec2 hands = (a + b) / 2.0;
  Vec2 direction(1.0, 0.0);
  if (!along_x && (b - a).norm() > 0.0) {
    const Vec2 low = mesh.positions.leftCols<2>().colwise().minCoeff();
    const Vec2 high = mesh.positions.leftCols<2>().colwise().maxCoeff();
    direction = Vec2(b.y() - a.y(), a.x() - b.x()).normalized();
    if (direction.dot((low + high) / 2.0 - hands) < 0.0) direction = -direction;
    for (const Vec2& axis : {Vec2(1, 0), Vec2(0, 1), Vec2(-1, 0), Vec2(0, -1)}) {
      if (direction.dot(axis) > std::cos(15.0 * kDegree)) direction = axis;
    }
  }
  const Vector along = mesh.positions.leftCols<2>() * direction;
  const double middle = (along.minCoeff() + along.maxCoeff()) / 2.0;
  const double length = 2.0 * (middle - hands.dot(direction));
  if (!(length > 0.05 * (along.maxCoeff() - along.minCoeff()))) {
    throw ConfigError(
        "--grasp: the hands lie at the middle of the garment, so they cannot fold it in two; grasp the "
        "outermost vertices of one side");
  }
  return length * direction;
}

std::string task_text(const std::string& name, const std::vector<std::string>& grasp, const Vec2& displacement,
                      const std::string& note) {
  char numbers[80];
  std::snprintf(numbers, sizeof numbers, "[%.4f, %.4f]", displacement.x() + 0.0, displacement.y() + 0.0);
  return "# Fold " + name + " in two. Every key: docs/configuration.md\n" + "description: fold " + name + " in two\n" +
         "garment: " + name + ".yaml\n" + "material: fabric.yaml\n" + "manipulation:\n" + "  grasp: [" + grasp.at(0) +
         ", " + grasp.at(1) + "]\n" + "  displacement_m: " + numbers + "  # " + note + "\n" +
         "  drop_height_m: 0.05\n" + "simulator: {plugin: cloth}\n" + "trajectory: {plugin: arc}\n" +
         "predictor: {plugin: rollout}  # plans with the simulator; a network is faster: " + name +
         "_experiment.yaml\n" + "optimiser: {plugin: rprop}\n" +
         "planning: {instances: 2, iterations: 8, replan_iterations: 2}\n" + "knowledge: \"true\"\n";
}

std::string experiment_text(const std::string& name) {
  return "# Learn to fold " + name + ", and fold it with the network (docs/my-garment.md):\n" + "#   weft learn " +
         name + "_experiment.yaml --out learned\n" + "#   weft run learned/task.yaml\n" + "extends: " + name +
         "_fold.yaml\n" + "predictor: {plugin: emd}\n" +
         "planning: {instances: 16, iterations: 80, replan_iterations: 30}  # a network is fast\n" +
         "correction: {simulations: 8, max_width: 0.2}  # the simulator corrects its plans\n";
}

}  // namespace weft
