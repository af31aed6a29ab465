#include <tiny_gltf.h>

#include <Eigen/Geometry>
#include <cstring>
#include <sstream>

#include "exports.hpp"
#include "sdk/files.hpp"

namespace weft::app {
namespace {

using Single = Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

/// Area-weighted vertex normals, unit length.
Positions normals_of(const Positions& positions, const Faces& faces) {
  Positions normals = Positions::Zero(positions.rows(), 3);
  for (Index f = 0; f < faces.rows(); ++f) {
    const Eigen::Vector3d a = positions.row(faces(f, 0)), b = positions.row(faces(f, 1)),
                          c = positions.row(faces(f, 2));
    const Eigen::RowVector3d normal = (b - a).cross(c - a);
    for (int k = 0; k < 3; ++k) normals.row(faces(f, k)) += normal;
  }
  normals.rowwise().normalize();
  return normals;
}

/// Appends arrays to a model's only buffer.
class Writer {
 public:
  explicit Writer(tinygltf::Model& model) : model_(model) { model_.buffers.emplace_back(); }

  int add(const Single& rows, int type, int target, bool bounds = false) {
    const int accessor =
        append(rows.data(), rows.size() * sizeof(float), rows.rows(), TINYGLTF_COMPONENT_TYPE_FLOAT, type, target);
    if (bounds) {
      const Eigen::RowVectorXd low = rows.colwise().minCoeff().cast<double>(),
                               high = rows.colwise().maxCoeff().cast<double>();
      model_.accessors.back().minValues.assign(low.data(), low.data() + low.size());
      model_.accessors.back().maxValues.assign(high.data(), high.data() + high.size());
    }
    return accessor;
  }
  int add(const Faces& faces) {
    const Eigen::Matrix<std::uint32_t, Eigen::Dynamic, 3, Eigen::RowMajor> indices = faces.cast<std::uint32_t>();
    return append(indices.data(), indices.size() * 4, indices.size(), TINYGLTF_COMPONENT_TYPE_UNSIGNED_INT,
                  TINYGLTF_TYPE_SCALAR, TINYGLTF_TARGET_ELEMENT_ARRAY_BUFFER);
  }

 private:
  int append(const void* data, std::size_t bytes, std::size_t count, int component, int type, int target) {
    auto& buffer = model_.buffers[0].data;
    tinygltf::BufferView view;
    view.buffer = 0;
    view.byteOffset = buffer.size();
    view.byteLength = bytes;
    view.target = target;
    buffer.resize(buffer.size() + bytes);  // every array is made of 4-byte words, so each starts aligned
    std::memcpy(buffer.data() + view.byteOffset, data, bytes);
    model_.bufferViews.push_back(view);
    tinygltf::Accessor accessor;
    accessor.bufferView = static_cast<int>(model_.bufferViews.size()) - 1;
    accessor.componentType = component;
    accessor.count = count;
    accessor.type = type;
    model_.accessors.push_back(accessor);
    return static_cast<int>(model_.accessors.size()) - 1;
  }
  tinygltf::Model& model_;
};

int add_material(tinygltf::Model& model, const std::string& name, std::vector<double> colour) {
  tinygltf::Material material;
  material.name = name;
  material.doubleSided = true;
  if (colour[3] < 1.0) material.alphaMode = "BLEND";
  material.pbrMetallicRoughness.baseColorFactor = std::move(colour);
  material.pbrMetallicRoughness.metallicFactor = 0.0;
  material.pbrMetallicRoughness.roughnessFactor = 0.9;
  model.materials.push_back(material);
  return static_cast<int>(model.materials.size()) - 1;
}

constexpr int kVertices = TINYGLTF_TARGET_ARRAY_BUFFER, kVec3 = TINYGLTF_TYPE_VEC3;

/// Adds a mesh of one primitive, and a node that shows it.
/// @param faces,uv accessors; uv < 0: none. @return the node.
int add_mesh(tinygltf::Model& model, Writer& out, const std::string& name, const Positions& positions,
             const Faces& topology, int faces, int uv, int material) {
  tinygltf::Primitive primitive;
  primitive.mode = TINYGLTF_MODE_TRIANGLES;
  primitive.indices = faces;
  primitive.material = material;
  primitive.attributes["POSITION"] = out.add(Single(positions.cast<float>()), kVec3, kVertices, true);
  primitive.attributes["NORMAL"] = out.add(Single(normals_of(positions, topology).cast<float>()), kVec3, kVertices);
  if (uv >= 0) primitive.attributes["TEXCOORD_0"] = uv;
  tinygltf::Mesh mesh;
  mesh.name = name;
  mesh.primitives.push_back(primitive);
  model.meshes.push_back(mesh);
  tinygltf::Node node;
  node.name = name;
  node.mesh = static_cast<int>(model.meshes.size()) - 1;
  model.nodes.push_back(node);
  return static_cast<int>(model.nodes.size()) - 1;
}

/// Frame k > 0 is the first frame plus target k - 1 of the mesh.
void add_targets(tinygltf::Mesh& mesh, Writer& out, const SessionRecord& session, const Timeline& timeline) {
  const Positions& first = session.frames[timeline.frames.front()];
  const Positions first_normals = normals_of(first, session.faces);
  tinygltf::Value::Array names;
  for (std::size_t k = 1; k < timeline.frames.size(); ++k) {
    const Positions& shape = session.frames[timeline.frames[k]];
    std::map<std::string, int> target;
    target["POSITION"] = out.add(Single((shape - first).cast<float>()), kVec3, kVertices, true);
    target["NORMAL"] =
        out.add(Single((normals_of(shape, session.faces) - first_normals).cast<float>()), kVec3, kVertices);
    mesh.primitives[0].targets.push_back(target);
    mesh.weights.push_back(0.0);
    names.emplace_back("frame " + std::to_string(timeline.frames[k]));
  }
  if (!names.empty()) mesh.extras = tinygltf::Value(tinygltf::Value::Object{{"targetNames", tinygltf::Value(names)}});
}

/// At the time of frame k > 0 the weight of target k - 1 is 1 and all others are 0.
void add_animation(tinygltf::Model& model, Writer& out, const Timeline& timeline, int node) {
  const std::size_t keys = timeline.frames.size(), targets = keys - 1;
  Single times(keys, 1);
  for (std::size_t k = 0; k < keys; ++k) times(k, 0) = static_cast<float>(timeline.seconds[k]);
  Single weights = Single::Zero(keys * targets, 1);
  for (std::size_t k = 1; k < keys; ++k) weights(k * targets + k - 1, 0) = 1.0f;
  tinygltf::AnimationSampler sampler;
  sampler.input = out.add(times, TINYGLTF_TYPE_SCALAR, 0, true);
  sampler.output = out.add(weights, TINYGLTF_TYPE_SCALAR, 0);
  sampler.interpolation = "LINEAR";
  tinygltf::AnimationChannel channel;
  channel.sampler = 0;
  channel.target_node = node;
  channel.target_path = "weights";
  tinygltf::Animation animation;
  animation.name = "fold";
  animation.samplers.push_back(sampler);
  animation.channels.push_back(channel);
  model.animations.push_back(animation);
}

/// The model's only scene. Positions stay in weft's frame, z up; its root turns them to glTF's y up.
void add_scene(tinygltf::Model& model, std::vector<int> nodes) {
  tinygltf::Node root;
  root.name = "weft";
  root.rotation = {-std::sqrt(0.5), 0.0, 0.0, std::sqrt(0.5)};
  root.children = std::move(nodes);
  model.nodes.push_back(root);
  tinygltf::Scene scene;
  scene.nodes = {static_cast<int>(model.nodes.size()) - 1};
  model.scenes.push_back(scene);
  model.defaultScene = 0;
}

}  // namespace

void export_gltf(const std::filesystem::path& file, const SessionRecord& session, const Timeline& timeline) {
  tinygltf::Model model;
  model.asset.version = "2.0";
  model.asset.generator = "weft";
  Writer out(model);
  const int faces = out.add(session.faces);
  const int uv = out.add(Single(session.rest.cast<float>()), TINYGLTF_TYPE_VEC2, kVertices);
  const int cloth = add_mesh(model, out, session.garment_name, session.frames[timeline.frames.front()], session.faces,
                             faces, uv, add_material(model, "cloth", {0.07, 0.26, 0.56, 1.0}));
  const Mesh shown = session.drawn_goal();
  const bool is_garment = session.has_correspondence;
  const int goal = add_mesh(model, out, "goal", shown.positions, shown.faces, is_garment ? faces : out.add(shown.faces),
                            is_garment ? uv : -1, add_material(model, "goal", {0.0, 0.25, 0.12, 0.4}));
  std::vector<int> nodes{cloth, goal};
  for (std::size_t k = 0; k < session.obstacles.size(); ++k) {
    const Mesh body = session.drawn_obstacle(k);
    nodes.push_back(add_mesh(model, out, body.source, body.positions, body.faces, out.add(body.faces), -1,
                             add_material(model, body.source, {0.45, 0.42, 0.38, 1.0})));
  }
  add_targets(model.meshes[0], out, session, timeline);
  if (timeline.frames.size() > 1) add_animation(model, out, timeline, cloth);
  add_scene(model, std::move(nodes));

  tinygltf::TinyGLTF writer;
  const bool binary = file.extension() != ".gltf";
  // Not by tinygltf itself, which does not see that a disk is full.
  std::ostringstream text(std::ios::binary);
  if (!writer.WriteGltfSceneToStream(&model, text, false, binary)) throw Error(file.string() + ": cannot be made");
  write_text(file, text.str());
}

}  // namespace weft::app
