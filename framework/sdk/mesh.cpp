#include <array>
#include <charconv>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <limits>
#include <string_view>
#include <system_error>
#include <vector>

#include "sdk/files.hpp"
#include "weft/garment.hpp"

namespace weft {
namespace {

// Larger than any mesh that can be simulated. It limits the memory that a hostile file can make us allocate.
constexpr std::uintmax_t kMaxFileBytes = std::uintmax_t{1} << 30;

// Ignored statements: normals, groups, materials, and the simulation state that ARCSim adds to a mesh.
constexpr std::array<std::string_view, 25> kIgnored = {
    "vn", "vp", "g",  "o",  "s",  "usemtl", "mtllib", "usemap", "maplib", "e",     "tn",       "ny",      "nv",
    "nl", "ns", "nm", "nc", "ea", "ed",     "el",     "tl",     "tp",     "bevel", "c_interp", "d_interp"};

[[noreturn]] void fail(const std::string& where, std::size_t line, const std::string& message) {
  throw ConfigError(where + ":" + std::to_string(line) + ": " + message);
}

std::string quote(std::string_view text) {
  std::string out = "'";
  for (const char c : text.substr(0, 40)) {
    out += (static_cast<unsigned char>(c) < 32 || static_cast<unsigned char>(c) > 126) ? '?' : c;
  }
  return out + (text.size() > 40 ? "...'" : "'");
}

std::string read_whole(const std::filesystem::path& path) {
  std::error_code error;
  const auto status = std::filesystem::status(path, error);
  if (error || !std::filesystem::exists(status)) throw ConfigError(path.string() + ": no such file");
  if (!std::filesystem::is_regular_file(status)) throw ConfigError(path.string() + ": not a file");
  const auto size = std::filesystem::file_size(path, error);
  if (error) throw ConfigError(path.string() + ": cannot be read: " + error.message());
  if (size > kMaxFileBytes) {
    throw ConfigError(path.string() + ": " + std::to_string(size) + " bytes, must be at most " +
                      std::to_string(kMaxFileBytes));
  }
  std::ifstream in(path, std::ios::binary);
  std::string text(size, '\0');
  if (!in || !in.read(text.data(), static_cast<std::streamsize>(size))) {
    throw ConfigError(path.string() + ": cannot be read");
  }
  return text;
}

bool is_space(char c) { return c == ' ' || c == '\t' || c == '\r' || c == '\v' || c == '\f'; }

/// Removes the next word of the line from `rest` and returns it; empty at the end.
std::string_view next_word(std::string_view& rest) {
  std::size_t begin = 0;
  while (begin < rest.size() && is_space(rest[begin])) ++begin;
  std::size_t end = begin;
  while (end < rest.size() && !is_space(rest[end])) ++end;
  const std::string_view word = rest.substr(begin, end - begin);
  rest.remove_prefix(end);
  return word;
}

struct Reader {
  std::string name;
  std::size_t line = 0;
  std::vector<std::array<double, 3>> vertices;
  std::vector<std::array<double, 2>> texture;
  std::vector<std::array<int, 3>> faces;          // vertex indices, 0-based
  std::vector<std::array<int, 3>> face_textures;  // likewise into `texture`, -1: none
  std::vector<std::size_t> face_lines;

  /// Numbers of a statement; refuses text, NaN, infinity and overflow.
  std::vector<double> numbers(std::string_view rest, const std::string& what) const {
    std::vector<double> values;
    for (std::string_view word = next_word(rest); !word.empty(); word = next_word(rest)) {
      std::string_view digits = word;
      if (digits.front() == '+') digits.remove_prefix(1);
      double value = 0.0;
      const auto [end, code] = std::from_chars(digits.data(), digits.data() + digits.size(), value);
      if (code == std::errc::result_out_of_range) {
        fail(name, line, what + " has " + quote(word) + ", which is out of the range of double");
      }
      if (code != std::errc() || end != digits.data() + digits.size()) {
        fail(name, line, what + " has " + quote(word) + ", must be a number");
      }
      if (!std::isfinite(value)) fail(name, line, what + " has " + quote(word) + ", must be finite");
      values.push_back(value);
      if (values.size() > 16) fail(name, line, what + " has more than 16 numbers");
    }
    return values;
  }

  void vertex(std::string_view rest) {
    const std::string what = "vertex " + std::to_string(vertices.size() + 1);
    const std::vector<double> values = numbers(rest, what);
    // x y z, x y z w, x y z r g b, x y z r g b a: the OBJ forms in use.
    if (values.size() < 3 || values.size() == 5 || values.size() > 7) {
      fail(name, line, what + " has " + std::to_string(values.size()) + " coordinates, must have 3");
    }
    if (values.size() == 4 && values[3] != 1.0) fail(name, line, what + " has a weight other than 1");
    vertices.push_back({values[0], values[1], values[2]});
  }

  void texture_vertex(std::string_view rest) {
    const std::string what = "vt " + std::to_string(texture.size() + 1);
    const std::vector<double> values = numbers(rest, what);
    if (values.size() != 2 && values.size() != 3) {
      fail(name, line, what + " has " + std::to_string(values.size()) + " coordinates, must have 2");
    }
    texture.push_back({values[0], values[1]});
  }

  /// One index of a face: 1-based, or negative and relative to the entries read so far. Forward references are checked
  /// at the end.
  int index(std::string_view text, std::size_t count, const std::string& what, std::string_view word) const {
    long long value = 0;
    std::string_view digits = text;
    if (!digits.empty() && digits.front() == '+') digits.remove_prefix(1);
    const auto [end, code] = std::from_chars(digits.data(), digits.data() + digits.size(), value);
    if (code == std::errc::result_out_of_range) {
      fail(name, line, what + ": index in " + quote(word) + " is out of range");
    }
    if (code != std::errc() || end != digits.data() + digits.size()) {
      fail(name, line, what + ": " + quote(word) + " must be v, v/vt, v//vn or v/vt/vn");
    }
    if (value == 0) fail(name, line, what + ": index 0 in " + quote(word) + ", OBJ indices start at 1");
    if (value < 0) {
      if (value < -static_cast<long long>(count)) {
        fail(name, line,
             what + ": relative index " + std::to_string(value) + " in " + quote(word) + ", but only " +
                 std::to_string(count) + " were read before it");
      }
      return static_cast<int>(static_cast<long long>(count) + value);
    }
    if (value > std::numeric_limits<int>::max()) {
      fail(name, line, what + ": index " + std::to_string(value) + " in " + quote(word) + " is out of range");
    }
    return static_cast<int>(value - 1);
  }

  void face(std::string_view rest) {
    const std::string what = "face " + std::to_string(faces.size() + 1);
    std::array<int, 3> corners{};
    std::array<int, 3> textures{};
    std::size_t count = 0;
    for (std::string_view word = next_word(rest); !word.empty(); word = next_word(rest)) {
      if (count < 3) {
        const std::size_t slash = word.find('/');
        corners[count] = index(word.substr(0, slash), vertices.size(), what, word);
        textures[count] = -1;
        if (slash != std::string_view::npos) {
          const std::string_view tail = word.substr(slash + 1);
          const std::size_t second = tail.find('/');
          const std::string_view vt = tail.substr(0, second);
          if (!vt.empty()) textures[count] = index(vt, texture.size(), what + " (vt)", word);
          if (second != std::string_view::npos && !tail.substr(second + 1).empty()) {
            index(tail.substr(second + 1), std::numeric_limits<int>::max(), what + " (vn)", word);
          }
        }
      }
      ++count;
    }
    if (count == 4) fail(name, line, what + " is a quad, must be a triangle (triangulate the mesh first)");
    if (count != 3) {
      fail(name, line, what + " has " + std::to_string(count) + " vertices, must be a triangle");
    }
    faces.push_back(corners);
    face_textures.push_back(textures);
    face_lines.push_back(line);
    if (faces.size() > static_cast<std::size_t>(std::numeric_limits<int>::max()) / 4) {
      fail(name, line, "too many faces");
    }
  }

  void statement(std::string_view text) {
    const std::size_t hash = text.find('#');
    if (hash != std::string_view::npos) text = text.substr(0, hash);
    std::string_view rest = text;
    const std::string_view keyword = next_word(rest);
    if (keyword.empty()) return;
    if (keyword == "v") return vertex(rest);
    if (keyword == "vt") return texture_vertex(rest);
    if (keyword == "f") return face(rest);
    if (keyword == "l" || keyword == "p") {
      fail(name, line, "a " + std::string(keyword == "l" ? "line" : "point") + " element, must be triangles only");
    }
    for (const std::string_view ignored : kIgnored) {
      if (keyword == ignored) return;
    }
    fail(name, line, quote(keyword) + " is not a statement of a triangle mesh (v, vt, vn, f, g, o, s, usemtl, mtllib)");
  }

  Mesh finish() const {
    if (vertices.empty()) throw ConfigError(name + ": no vertices");
    if (faces.empty()) throw ConfigError(name + ": no faces");
    const int vertex_count = static_cast<int>(vertices.size());
    const int texture_count = static_cast<int>(texture.size());
    std::vector<int> texture_of(vertices.size(), -1);
    // The first face decides whether the mesh has rest coordinates; all others must agree.
    const bool with_texture = face_textures[0][0] >= 0;
    for (std::size_t f = 0; f < faces.size(); ++f) {
      const std::string what = "face " + std::to_string(f + 1);
      const auto& corners = faces[f];
      for (std::size_t k = 0; k < 3; ++k) {
        const int v = corners[k];
        if (v >= vertex_count) {
          fail(name, face_lines[f],
               what + " names vertex " + std::to_string(static_cast<long long>(v) + 1) + ", but the file has only " +
                   std::to_string(vertex_count));
        }
        const int vt = face_textures[f][k];
        if ((vt >= 0) != with_texture) {
          fail(name, face_lines[f],
               what + (with_texture ? " has no vt" : " has a vt") +
                   ", unlike the faces before it; all faces must have vt, or none");
        }
        if (vt < 0) continue;
        if (vt >= texture_count) {
          fail(name, face_lines[f],
               what + " names vt " + std::to_string(static_cast<long long>(vt) + 1) + ", but the file has only " +
                   std::to_string(texture_count));
        }
        int& known = texture_of[v];
        if (known >= 0 && texture[known] != texture[vt]) {
          fail(name, face_lines[f],
               what + " gives vertex " + std::to_string(v + 1) + " vt " + std::to_string(vt + 1) +
                   ", but an earlier face gave it vt " + std::to_string(known + 1) +
                   ": a vertex has one rest position (seams must be split)");
        }
        if (known < 0) known = vt;
      }
      if (corners[0] == corners[1] || corners[1] == corners[2] || corners[2] == corners[0]) {
        const int twice = corners[0] == corners[1] || corners[0] == corners[2] ? corners[0] : corners[1];
        fail(name, face_lines[f], what + " is degenerate: it names vertex " + std::to_string(twice + 1) + " twice");
      }
    }
    if (!with_texture && !texture.empty()) {
      throw ConfigError(name + ": " + std::to_string(texture_count) +
                        " vt, but no face uses them: write f v/vt v/vt v/vt, or remove the vt");
    }
    Mesh mesh;
    mesh.source = name;
    mesh.positions.resize(vertex_count, 3);
    for (Index v = 0; v < vertex_count; ++v) {
      for (Index k = 0; k < 3; ++k) {
        mesh.positions(v, k) = vertices[v][k];
      }
    }
    mesh.rest.resize(with_texture ? vertex_count : 0, 2);
    for (Index v = 0; v < mesh.rest.rows(); ++v) {
      const int vt = texture_of[v];
      if (vt < 0) throw ConfigError(name + ": vertex " + std::to_string(v + 1) + " is in no face");
      mesh.rest(v, 0) = texture[vt][0];
      mesh.rest(v, 1) = texture[vt][1];
    }
    mesh.faces.resize(faces.size(), 3);
    for (Index f = 0; f < mesh.faces.rows(); ++f) {
      for (Index k = 0; k < 3; ++k) mesh.faces(f, k) = faces[f][k];
    }
    return mesh;
  }
};

/// Shortest decimal text that reads back to the same double, or 9 significant digits.
void append_number(std::string& out, double value, bool exact) {
  char buffer[40];
  const auto result = exact ? std::to_chars(buffer, buffer + sizeof buffer, value)
                            : std::to_chars(buffer, buffer + sizeof buffer, value, std::chars_format::general, 9);
  out.append(buffer, result.ptr);
}

}  // namespace

Mesh read_obj(const std::filesystem::path& path) {
  const std::string text = read_whole(path);
  Reader reader;
  reader.name = path.string();
  std::string joined;  // a statement continued over several lines by a trailing backslash
  std::size_t begin = 0;
  std::size_t line = 0;
  while (begin < text.size()) {
    std::size_t end = text.find_first_of("\n\r", begin);
    if (end == std::string::npos) end = text.size();
    std::string_view statement(text.data() + begin, end - begin);
    // CR LF is one line end; a lone CR (old Macintosh) is one too.
    begin = end + (end + 1 < text.size() && text[end] == '\r' && text[end + 1] == '\n' ? 2 : 1);
    ++line;
    if (joined.empty()) reader.line = line;
    if (!statement.empty() && statement.back() == '\\') {
      joined.append(statement.substr(0, statement.size() - 1)).push_back(' ');
      continue;
    }
    if (!joined.empty()) {
      joined.append(statement);
      reader.statement(joined);
      joined.clear();
    } else {
      reader.statement(statement);
    }
  }
  if (!joined.empty()) reader.statement(joined);
  return reader.finish();
}

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
