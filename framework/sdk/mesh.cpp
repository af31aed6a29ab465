#include "weft/mesh.hpp"

#include <charconv>
#include <fstream>
#include <system_error>
#include <vector>

#include "sdk/files.hpp"
#include "sdk/obj_file.hpp"
#include "weft/error.hpp"
#include "weft/garment.hpp"

namespace weft {
namespace {

/// Checks what a file of triangles may still lack: rest coordinates for all corners, one for each vertex.
Mesh mesh_of(const ObjFile& file, const std::string& name) {
  std::vector<int> texture_of(file.vertices.size(), -1);
  // The first face decides whether the mesh has rest coordinates; all others must agree.
  const bool with_texture = file.faces[0].corners[0].texture >= 0;
  for (std::size_t f = 0; f < file.faces.size(); ++f) {
    const auto& corners = file.faces[f].corners;
    const auto fail = [&](const std::string& message) {
      throw ConfigError(name + ":" + std::to_string(file.faces[f].line) + ": face " + std::to_string(f + 1) + message);
    };
    for (const ObjFile::Corner& corner : corners) {
      const int v = corner.vertex, vt = corner.texture;
      if ((vt >= 0) != with_texture) {
        fail((with_texture ? std::string(" has no vt") : std::string(" has a vt")) +
             ", unlike the faces before it; all faces must have vt, or none");
      }
      if (vt < 0) continue;
      int& known = texture_of[v];
      if (known >= 0 && file.texture[known] != file.texture[vt]) {
        fail(" gives vertex " + std::to_string(v + 1) + " vt " + std::to_string(vt + 1) +
             ", but an earlier face gave it vt " + std::to_string(known + 1) +
             ": a vertex has one rest position (seams must be split)");
      }
      if (known < 0) known = vt;
    }
    const int a = corners[0].vertex, b = corners[1].vertex, c = corners[2].vertex;
    if (a == b || b == c || c == a) {
      fail(" is degenerate: it names vertex " + std::to_string((a == b || a == c ? a : b) + 1) + " twice");
    }
  }
  if (!with_texture && !file.texture.empty()) {
    throw ConfigError(name + ": " + std::to_string(file.texture.size()) +
                      " vt, but no face uses them: write f v/vt v/vt v/vt, or remove the vt");
  }
  Mesh mesh;
  mesh.source = name;
  mesh.positions.resize(file.vertices.size(), 3);
  for (Index v = 0; v < mesh.positions.rows(); ++v) {
    for (Index k = 0; k < 3; ++k) {
      mesh.positions(v, k) = file.vertices[v][k];
    }
  }
  mesh.rest.resize(with_texture ? mesh.positions.rows() : 0, 2);
  for (Index v = 0; v < mesh.rest.rows(); ++v) {
    const int vt = texture_of[v];
    if (vt < 0) throw ConfigError(name + ": vertex " + std::to_string(v + 1) + " is in no face");
    mesh.rest(v, 0) = file.texture[vt][0];
    mesh.rest(v, 1) = file.texture[vt][1];
  }
  mesh.faces.resize(file.faces.size(), 3);
  for (Index f = 0; f < mesh.faces.rows(); ++f) {
    for (Index k = 0; k < 3; ++k) mesh.faces(f, k) = file.faces[f].corners[k].vertex;
  }
  return mesh;
}

/// Shortest decimal text that reads back to the same double, or 9 significant digits.
void append_number(std::string& out, double value, bool exact) {
  char buffer[40];
  const auto result = exact ? std::to_chars(buffer, buffer + sizeof buffer, value)
                            : std::to_chars(buffer, buffer + sizeof buffer, value, std::chars_format::general, 9);
  out.append(buffer, result.ptr);
}

}  // namespace

Mesh read_obj(const std::filesystem::path& path) { return mesh_of(read_obj_file(path, true), path.string()); }

void write_obj(const std::filesystem::path& path, const Mesh& mesh, bool exact) {
  if (!mesh.positions.allFinite() || !mesh.rest.allFinite()) {
    throw Error(path.string() + ": not written: the mesh has a coordinate that is not finite");
  }
  if (mesh.rest.rows() != 0) require_shape("write_obj: rest rows", mesh.rest.rows(), mesh.positions.rows());
  std::string out;
  out.reserve(mesh.positions.rows() * 60 + mesh.faces.rows() * 30);
  for (Index v = 0; v < mesh.positions.rows(); ++v) {
    out += 'v';
    for (Index k = 0; k < 3; ++k) append_number(out += ' ', mesh.positions(v, k), exact);
    out += '\n';
  }
  for (Index v = 0; v < mesh.rest.rows(); ++v) {
    out += "vt";
    for (Index k = 0; k < 2; ++k) append_number(out += ' ', mesh.rest(v, k), exact);
    out += '\n';
  }
  const bool with_texture = mesh.rest.rows() > 0;
  for (Index f = 0; f < mesh.faces.rows(); ++f) {
    out += 'f';
    for (Index k = 0; k < 3; ++k) {
      const std::string index = std::to_string(mesh.faces(f, k) + 1);
      out += ' ' + index;
      if (with_texture) out += '/' + index;
    }
    out += '\n';
  }
  write_text(path, out);
}

}  // namespace weft
