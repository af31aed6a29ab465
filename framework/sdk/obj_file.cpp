#include "sdk/obj_file.hpp"

#include <charconv>
#include <cmath>
#include <fstream>
#include <limits>
#include <string_view>
#include <system_error>

#include "sdk/files.hpp"
#include "weft/error.hpp"

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
  require_file(path);
  const auto size = std::filesystem::file_size(path, error);
  if (error) throw ReadError(path.string() + ": cannot be read: " + error.message());
  if (size > kMaxFileBytes) {
    throw ConfigError(path.string() + ": " + std::to_string(size) + " bytes, must be at most " +
                      std::to_string(kMaxFileBytes));
  }
  std::ifstream in(path, std::ios::binary);
  std::string text(size, '\0');
  if (!in || !in.read(text.data(), static_cast<std::streamsize>(size))) {
    throw ReadError(path.string() + ": cannot be read");
  }
  if (is_lfs_pointer(text)) throw ConfigError(path.string() + ": " + kLfsPointer);
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

struct ObjReader {
  std::string name;
  std::size_t line = 0;
  bool triangles_only = true;
  ObjFile file;

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
    const std::string what = "vertex " + std::to_string(file.vertices.size() + 1);
    const std::vector<double> values = numbers(rest, what);
    // x y z, x y z w, x y z r g b, x y z r g b a: the OBJ forms in use.
    if (values.size() < 3 || values.size() == 5 || values.size() > 7) {
      fail(name, line, what + " has " + std::to_string(values.size()) + " coordinates, must have 3");
    }
    if (values.size() == 4 && values[3] != 1.0) fail(name, line, what + " has a weight other than 1");
    file.vertices.push_back({values[0], values[1], values[2]});
  }

  void texture_vertex(std::string_view rest) {
    const std::string what = "vt " + std::to_string(file.texture.size() + 1);
    const std::vector<double> values = numbers(rest, what);
    if (values.size() != 2 && values.size() != 3) {
      fail(name, line, what + " has " + std::to_string(values.size()) + " coordinates, must have 2");
    }
    file.texture.push_back({values[0], values[1]});
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
    const std::string what = "face " + std::to_string(file.faces.size() + 1);
    ObjFile::Face face;
    face.line = line;
    for (std::string_view word = next_word(rest); !word.empty(); word = next_word(rest)) {
      ObjFile::Corner corner;
      const std::size_t slash = word.find('/');
      corner.vertex = index(word.substr(0, slash), file.vertices.size(), what, word);
      if (slash != std::string_view::npos) {
        const std::string_view tail = word.substr(slash + 1);
        const std::size_t second = tail.find('/');
        const std::string_view vt = tail.substr(0, second);
        if (!vt.empty()) corner.texture = index(vt, file.texture.size(), what + " (vt)", word);
        if (second != std::string_view::npos && !tail.substr(second + 1).empty()) {
          index(tail.substr(second + 1), std::numeric_limits<int>::max(), what + " (vn)", word);
        }
      }
      face.corners.push_back(corner);
    }
    const std::size_t count = face.corners.size();
    if (triangles_only && count == 4) {
      fail(name, line, what + " is a quad, must be a triangle (weft garment import triangulates meshes)");
    }
    if (count < 3 || (triangles_only && count != 3)) {
      fail(
          name, line,
          what + " has " + std::to_string(count) + " vertices, must be a " + (triangles_only ? "triangle" : "polygon"));
    }
    file.faces.push_back(std::move(face));
    if (file.faces.size() > static_cast<std::size_t>(std::numeric_limits<int>::max()) / 4) {
      fail(name, line, "too many faces");
    }
  }

  void statement(std::string_view text) {
    const std::size_t hash = text.find('#');
    if (hash != std::string_view::npos) {
      if (file.vertices.empty()) file.comments.emplace_back(text.substr(hash + 1));
      text = text.substr(0, hash);
    }
    std::string_view rest = text;
    const std::string_view keyword = next_word(rest);
    if (keyword.empty()) return;
    if (keyword == "v") return vertex(rest);
    if (keyword == "vt") return texture_vertex(rest);
    if (keyword == "f") return face(rest);
    if (!triangles_only && (keyword == "l" || keyword == "p")) {
      ++file.elements;
      return;
    }
    if (keyword == "l" || keyword == "p") {
      fail(name, line, "a " + std::string(keyword == "l" ? "line" : "point") + " element, must be triangles only");
    }
    for (const std::string_view ignored : kIgnored) {
      if (keyword == ignored) return;
    }
    fail(name, line, quote(keyword) + " is not a statement of a triangle mesh (v, vt, vn, f, g, o, s, usemtl, mtllib)");
  }

  /// Forward references, which can only be checked at the end.
  void check_indices() const {
    if (file.vertices.empty()) throw ConfigError(name + ": no vertices");
    if (file.faces.empty()) throw ConfigError(name + ": no faces");
    const auto check = [this](int index, std::size_t count, const char* kind, std::size_t f) {
      if (index < 0 || static_cast<std::size_t>(index) < count) return;
      fail(name, file.faces[f].line,
           "face " + std::to_string(f + 1) + " names " + kind + ' ' +
               std::to_string(static_cast<long long>(index) + 1) + ", but the file has only " + std::to_string(count));
    };
    for (std::size_t f = 0; f < file.faces.size(); ++f) {
      for (const ObjFile::Corner& corner : file.faces[f].corners) {
        check(corner.vertex, file.vertices.size(), "vertex", f);
        check(corner.texture, file.texture.size(), "vt", f);
      }
    }
  }
};

/// UTF-16 as bytes of Latin letters; all else, which only comments and names have, becomes '?'.
std::string narrow(const std::string& text, bool big_endian) {
  std::string out;
  for (std::size_t i = 2; i + 1 < text.size(); i += 2) {
    const char low = text[big_endian ? i + 1 : i];
    const char high = text[big_endian ? i : i + 1];
    out += high == 0 ? low : '?';
  }
  return out;
}

/// Removes from the text what editors add to it. Returns what that was.
std::vector<std::string> make_plain(std::string& text) {
  std::vector<std::string> skipped;
  const bool little = text.starts_with("\xff\xfe");
  if (little || text.starts_with("\xfe\xff")) {
    text = narrow(text, !little);
    skipped.emplace_back("the second bytes of UTF-16 text");
  } else if (text.starts_with("\xef\xbb\xbf")) {
    text.erase(0, 3);
    skipped.emplace_back("a byte-order mark");
  }
  const std::size_t end = text.find_last_not_of(" \r\n\x1a");
  const std::size_t stop = text.find('\x1a', end == std::string::npos ? 0 : end);
  if (stop != std::string::npos) {
    text.erase(stop);
    skipped.emplace_back("a Ctrl-Z at the end");
  }
  return skipped;
}

}  // namespace

ObjFile read_obj_file(const std::filesystem::path& path, bool triangles_only) {
  std::string text = read_whole(path);
  ObjReader reader;
  reader.triangles_only = triangles_only;
  reader.file.skipped = make_plain(text);
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
  reader.check_indices();
  return std::move(reader.file);
}

Mesh bare_mesh(const ObjFile& file, const std::string& source) {
  Mesh mesh;
  mesh.source = source;
  mesh.positions.resize(file.vertices.size(), 3);
  for (Index v = 0; v < mesh.positions.rows(); ++v)
    for (Index k = 0; k < 3; ++k) mesh.positions(v, k) = file.vertices[v][k];
  mesh.faces.resize(file.faces.size(), 3);
  for (Index f = 0; f < mesh.faces.rows(); ++f)
    for (Index k = 0; k < 3; ++k) mesh.faces(f, k) = file.faces[f].corners[k].vertex;
  return mesh;
}

}  // namespace weft
