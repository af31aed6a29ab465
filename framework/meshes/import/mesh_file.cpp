#include "meshes/import/mesh_file.hpp"

#include <algorithm>
#include <cctype>

#include "sdk/files.hpp"
#include "weft/error.hpp"

#ifdef WEFT_HAS_ASSIMP
#include <assimp/postprocess.h>
#include <assimp/scene.h>

#include <assimp/Importer.hpp>
#endif

namespace weft {

const char* const kImportedComment = " weft: metres, z up";

namespace {

namespace fs = std::filesystem;

#ifdef WEFT_HAS_ASSIMP
/// Adds the meshes of a node and of those below it, moved to where the nodes are.
void add_node(const aiScene& scene, const aiNode& node, const aiMatrix4x4& above, const std::string& name,
              ObjFile& file) {
  const aiMatrix4x4 frame = above * node.mTransformation;
  for (unsigned i = 0; i < node.mNumMeshes; ++i) {
    const aiMesh& mesh = *scene.mMeshes[node.mMeshes[i]];
    const auto first = static_cast<int>(file.vertices.size());
    const bool textured = mesh.HasTextureCoords(0);
    const auto first_texture = static_cast<int>(file.texture.size());
    for (unsigned v = 0; v < mesh.mNumVertices; ++v) {
      const aiVector3D p = frame * mesh.mVertices[v];
      if (!std::isfinite(p.x) || !std::isfinite(p.y) || !std::isfinite(p.z)) {
        throw ConfigError(name + ": vertex " + std::to_string(file.vertices.size() + 1) +
                          " has a coordinate that is not finite");
      }
      file.vertices.push_back({p.x, p.y, p.z});
      if (textured) file.texture.push_back({mesh.mTextureCoords[0][v].x, mesh.mTextureCoords[0][v].y});
    }
    for (unsigned f = 0; f < mesh.mNumFaces; ++f) {
      const aiFace& face = mesh.mFaces[f];
      if (face.mNumIndices < 3) {
        ++file.elements;
        continue;
      }
      ObjFile::Face polygon;
      for (unsigned k = 0; k < face.mNumIndices; ++k) {
        if (face.mIndices[k] >= mesh.mNumVertices) {
          throw ConfigError(name + ": face " + std::to_string(file.faces.size() + 1) + " names vertex " +
                            std::to_string(face.mIndices[k] + 1) + ", but its mesh has only " +
                            std::to_string(mesh.mNumVertices));
        }
        const auto v = static_cast<int>(face.mIndices[k]);
        polygon.corners.push_back({first + v, textured ? first_texture + v : -1});
      }
      file.faces.push_back(std::move(polygon));
    }
  }
  for (unsigned i = 0; i < node.mNumChildren; ++i) add_node(scene, *node.mChildren[i], frame, name, file);
}
#endif

/// @param needs_faces refuse a point cloud.
ObjFile read_other_format(const fs::path& path, bool needs_faces) {
#ifdef WEFT_HAS_ASSIMP
  require_file(path);
  if (is_lfs_pointer_file(path)) throw ConfigError(path.string() + ": " + kLfsPointer);
  Assimp::Importer importer;
  const aiScene* scene = importer.ReadFile(path.string(), 0);
  if (scene == nullptr || scene->mRootNode == nullptr) {
    throw ConfigError(path.string() + ": cannot be read: " + importer.GetErrorString());
  }
  ObjFile file;
  add_node(*scene, *scene->mRootNode, aiMatrix4x4(), path.string(), file);
  if (file.vertices.empty()) throw ConfigError(path.string() + ": no vertices");
  if (needs_faces && file.faces.empty()) throw ConfigError(path.string() + ": no faces");
  return file;
#else
  static_cast<void>(needs_faces);
  throw ConfigError(
      path.string() +
      ": this build of weft reads OBJ only: assimp was missing when it was configured. Install it (Debian: "
      "libassimp-dev), then configure and build again; `./weft garment import` does all of this");
#endif
}

std::string extension_of(const fs::path& path) {
  std::string extension = path.extension().string();
  std::transform(extension.begin(), extension.end(), extension.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  return extension;
}

}  // namespace

Positions read_points(const fs::path& path) {
  const std::string extension = extension_of(path);
  if (extension != ".ply" && extension != ".obj")
    throw ConfigError(path.string() + ": must be a .ply point cloud, or an .obj, of which the vertices are taken");
  return bare_mesh(extension == ".obj" ? read_obj_file(path, false) : read_other_format(path, false), path.string())
      .positions;
}

MeshFile read_mesh_file(const fs::path& path, Findings& findings) {
  const std::string extension = extension_of(path);
  MeshFile file;
  if (extension == ".obj") {
    file.polygons = read_obj_file(path, false);
    const auto& comments = file.polygons.comments;
    if (std::find(comments.begin(), comments.end(), kImportedComment) != comments.end()) {
      file.frame = {"m", "z", "as the file says"};
    }
  } else if (extension == ".ply" || extension == ".stl" || extension == ".gltf" || extension == ".glb") {
    file.polygons = read_other_format(path, true);
    if (extension[1] == 'g') file.frame = {"m", "y", "as glTF is defined"};
  } else {
    throw ConfigError(path.string() + ": must be an .obj, .ply, .stl, .gltf or .glb mesh, or the .yaml of a garment");
  }
  std::string text = counted(static_cast<std::int64_t>(file.polygons.vertices.size()), "vertex", "vertices") + ", " +
                     counted(static_cast<std::int64_t>(file.polygons.faces.size()), "face");
  if (!file.polygons.texture.empty()) {
    text += ", " + counted(static_cast<std::int64_t>(file.polygons.texture.size()), "texture coordinate");
  }
  findings.push_back({"file", FindingKind::fact, static_cast<std::int64_t>(file.polygons.faces.size()), text});
  for (const std::string& skipped : file.polygons.skipped) {
    findings.push_back({"file", FindingKind::mended, 1, "skipped " + skipped});
  }
  if (file.polygons.elements > 0) {
    const auto count = static_cast<std::int64_t>(file.polygons.elements);
    findings.push_back(
        {"file", FindingKind::mended, count, counted(count, "line or point", "lines and points") + " skipped"});
  }
  return file;
}

}  // namespace weft
