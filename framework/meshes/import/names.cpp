#include "meshes/import/names.hpp"

#include <algorithm>
#include <cctype>
#include <charconv>
#include <cmath>

#include "meshes/import/pieces.hpp"
#include "weft/error.hpp"

namespace weft {

VertexSpec parse_vertex_spec(const std::string& option, const std::string& text) {
  const auto fail = [&] {
    throw ConfigError(option + " = " + text +
                      ", must be a vertex number from 1, nearest(x,y) or nearest(x,y,z) in metres");
  };
  VertexSpec spec;
  spec.text = text;
  const char* const end = text.data() + text.size();
  if (const auto [stop, code] = std::from_chars(text.data(), end, spec.number); code == std::errc() && stop == end) {
    if (spec.number < 1) fail();
    return spec;
  }
  spec.number = 0;
  const std::string begin = "nearest(";
  if (!text.starts_with(begin) || !text.ends_with(")")) fail();
  std::vector<double> values;
  const char* at = text.data() + begin.size();
  for (;;) {
    while (*at == ' ' || *at == '+') ++at;
    double value = 0.0;
    const auto [stop, code] = std::from_chars(at, end - 1, value);
    if (code != std::errc() || !std::isfinite(value)) fail();
    values.push_back(value);
    at = stop;
    while (at < end - 1 && *at == ' ') ++at;
    if (at == end - 1) break;
    if (*at != ',') fail();
    ++at;
  }
  if (values.size() != 2 && values.size() != 3) fail();
  spec.in_plane = values.size() == 2;
  for (std::size_t k = 0; k < values.size(); ++k) spec.at(static_cast<Index>(k)) = values[k];
  return spec;
}

std::pair<std::string, VertexSpec> parse_vertex_name(const std::string& option, const std::string& text) {
  const std::size_t equal = text.find('=');
  const std::string name = text.substr(0, equal);
  const bool plain = !name.empty() && !std::isdigit(static_cast<unsigned char>(name[0])) &&
                     std::all_of(name.begin(), name.end(),
                                 [](char c) { return std::isalnum(static_cast<unsigned char>(c)) || c == '_'; });
  if (equal == std::string::npos || !plain) {
    throw ConfigError(
        option + " = " + text +
        ", must be NAME=VERTEX, with a name of letters, digits and _, such as left_sleeve=nearest(-0.3,0.6)");
  }
  return {name, parse_vertex_spec(option + ' ' + name, text.substr(equal + 1))};
}

Index nearest_vertex(const Positions& positions, const VertexSpec& spec) {
  Index best = 0;
  const Index axes = spec.in_plane ? 2 : 3;
  const auto distance = [&](Index v) { return (positions.row(v).transpose() - spec.at).head(axes).norm(); };
  for (Index v = 1; v < positions.rows(); ++v) {
    if (distance(v) < distance(best)) best = v;
  }
  return best;
}

int find_vertex(const ImportMesh& mesh, const std::string& option, const VertexSpec& spec) {
  if (spec.number == 0) {
    Positions positions(static_cast<Index>(mesh.positions.size()), 3);
    for (Index v = 0; v < positions.rows(); ++v) positions.row(v) = mesh.at(static_cast<int>(v)).transpose();
    return static_cast<int>(nearest_vertex(positions, spec));
  }
  if (spec.number > static_cast<int>(mesh.vertex_of.size())) {
    throw ConfigError(option + " = " + spec.text + ", but " + mesh.source + " has only " +
                      std::to_string(mesh.vertex_of.size()) + " vertices");
  }
  const int v = mesh.vertex_of[static_cast<std::size_t>(spec.number - 1)];
  if (v < 0) {
    throw ConfigError(option + " = " + spec.text + ": this vertex of " + mesh.source +
                      " is not in the imported garment (in no face, or in a piece that was left out)");
  }
  return v;
}

std::map<std::string, int> outermost_vertices(const ImportMesh& mesh) {
  const MeshPiece piece = pieces_of(mesh).front();
  std::vector<bool> used(mesh.positions.size(), false);
  for (const int f : piece.faces) {
    for (const int v : mesh.faces[static_cast<std::size_t>(f)]) used[static_cast<std::size_t>(v)] = true;
  }
  // Below this difference two vertices are equally far out, and the first one is taken.
  const double tie = 1e-6 * mesh.largest_extent();
  std::map<std::string, int> outermost;
  for (const double x : {-1.0, 1.0}) {
    for (const double y : {-1.0, 1.0}) {
      int best = -1;
      double most = 0.0;
      for (int v = 0; v < mesh.vertex_count(); ++v) {
        if (!used[static_cast<std::size_t>(v)]) continue;
        const double out = x * mesh.at(v).x() + y * mesh.at(v).y();
        if (best < 0 || out > most + tie) {
          best = v;
          most = out;
        }
      }
      outermost[std::string(x < 0.0 ? "left_" : "right_") + (y < 0.0 ? "bottom" : "top")] = best;
    }
  }
  return outermost;
}

}  // namespace weft
