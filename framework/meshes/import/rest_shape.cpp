#include "meshes/import/rest_shape.hpp"

#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <map>

#include "meshes/import/orientation.hpp"
#include "meshes/import/pieces.hpp"
#include "meshes/plane.hpp"

namespace weft {
namespace {

constexpr double kFlatness = 1e-4;      // of the largest extent: noise of exports, and less than any fold
constexpr double kMetricStrain = 1e-3;  // vt in metres repeat the mesh's lengths to this

const Vec2& vt(const ImportMesh& mesh, std::size_t f, std::size_t k) {
  return mesh.texture[static_cast<std::size_t>(mesh.face_texture[f][k])];
}
bool textured(const ImportMesh& mesh, std::size_t f) {
  const auto& t = mesh.face_texture[f];
  return t[0] >= 0 && t[1] >= 0 && t[2] >= 0;
}
double texture_area(const ImportMesh& mesh, std::size_t f) {
  return cross(vt(mesh, f, 1) - vt(mesh, f, 0), vt(mesh, f, 2) - vt(mesh, f, 0));
}

std::string percent(double share) {
  char text[32];
  std::snprintf(text, sizeof text, "%.2g %%", 100.0 * share);
  return text;
}

double median_of(std::vector<double> values) {
  if (values.empty()) return 0.0;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

/// Lays a flat mesh at z = 0. @return the thickness it had; negative: it is not flat, and was not changed.
double lay_flat(ImportMesh& mesh, Findings& findings) {
  const double bound = kFlatness * mesh.largest_extent();
  const auto thickness = [](const std::vector<Vec3>& positions) {
    double low = positions.front().z(), high = low;
    for (const Vec3& p : positions) {
      low = std::min(low, p.z());
      high = std::max(high, p.z());
    }
    return high - low;
  };
  double thick = thickness(mesh.positions);
  std::string tilt;
  bool moved = false;
  if (thick > bound) {
    // The plane of the least squared distances.
    Vec3 centre = Vec3::Zero();
    for (const Vec3& p : mesh.positions) centre += p / static_cast<double>(mesh.positions.size());
    Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
    for (const Vec3& p : mesh.positions) covariance += (p - centre) * (p - centre).transpose();
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(covariance);
    Eigen::Vector3d normal = solver.eigenvectors().col(0);
    if (normal.z() < 0.0) normal = -normal;
    const auto turn = Eigen::Quaterniond::FromTwoVectors(normal, Eigen::Vector3d::UnitZ());
    std::vector<Vec3> turned;
    for (const Vec3& p : mesh.positions) turned.push_back(turn * Eigen::Vector3d(p));
    thick = thickness(turned);
    if (thick > bound) return -1.0;
    mesh.positions = std::move(turned);
    tilt = ", turned by " + std::to_string(std::lround(std::acos(std::min(1.0, normal.z())) / kDegree)) + " degrees";
    moved = true;
  }
  for (Vec3& p : mesh.positions) {
    moved = moved || p.z() != 0.0;
    p.z() = 0.0;
  }
  findings.push_back({"flat", moved ? FindingKind::mended : FindingKind::fact, 1,
                      "flat within " + length_text(thick) + (moved ? ": laid at z = 0" + tilt : "")});
  return thick;
}

/// Pieces that are seen from below are turned around. @return faces that look down even so.
std::int64_t turn_up(ImportMesh& mesh, Findings& findings) {
  std::int64_t turned = 0, down = 0;
  for (const MeshPiece& piece : pieces_of(mesh)) {
    double area = 0.0, all = 0.0;
    for (const int f : piece.faces) {
      area += mesh.area_vector(f).z();
      all += mesh.area_vector(f).norm();
    }
    // Front and back of a closed garment have the same area: which of them is larger is rounding.
    for (const int f : piece.faces) {
      if (area < -1e-6 * all) {
        auto &face = mesh.faces[static_cast<std::size_t>(f)], &texture = mesh.face_texture[static_cast<std::size_t>(f)];
        std::swap(face[1], face[2]);
        std::swap(texture[1], texture[2]);
        ++turned;
      }
      if (mesh.area_vector(f).z() <= 0.0) ++down;
    }
  }
  if (turned > 0) {
    findings.push_back({"orientation", FindingKind::mended, turned,
                        counted(turned, "face") + " turned to be counter-clockwise seen from above"});
  }
  return down;
}

RestPositions rest_of_texture(const ImportMesh& mesh, double scale, bool mirrored) {
  RestPositions rest = RestPositions::Zero(static_cast<Index>(mesh.positions.size()), 2);
  for (std::size_t f = 0; f < mesh.faces.size(); ++f) {
    if (!textured(mesh, f)) continue;
    for (std::size_t k = 0; k < 3; ++k) {
      const Vec2 at = scale * vt(mesh, f, k);
      rest.row(mesh.faces[f][k]) << (mirrored ? -at.x() : at.x()) + 0.0, at.y() + 0.0;
    }
  }
  return rest;
}

/// What is said of a texture that is not the rest shape.
std::string texture_text(const TextureFit& fit) {
  if (!fit.everywhere) return "only some faces have texture coordinates: ignored";
  if (fit.one_point) return "all texture coordinates are one point: ignored";
  std::string text = "the texture has " + counted(fit.islands, "island") + " and " +
                     counted(fit.seam_edges, "seam edge") + "; at the one scale that fits best (" +
                     length_text(fit.scale) + " per unit) it differs from the mesh's edges by " +
                     percent(fit.median_strain) + " in the median";
  if (!fit.has_size()) text += ": it has nothing to do with size and is ignored";
  return text;
}

/// Whether the boxes of two pieces overlap, seen from above.
bool pieces_meet(const ImportMesh& mesh, const MeshPiece& one, const MeshPiece& other) {
  const auto box = [&](const MeshPiece& piece) {
    Vec2 low = mesh.at(mesh.faces[static_cast<std::size_t>(piece.faces.front())][0]).head<2>(), high = low;
    for (const int f : piece.faces) {
      for (const int v : mesh.faces[static_cast<std::size_t>(f)]) {
        low = low.cwiseMin(mesh.at(v).head<2>());
        high = high.cwiseMax(mesh.at(v).head<2>());
      }
    }
    return std::pair(low, high);
  };
  const auto a = box(one), b = box(other);
  return (a.second.cwiseMin(b.second) - a.first.cwiseMax(b.first)).minCoeff() > 0.0;
}

}  // namespace

TextureFit fit_texture(const ImportMesh& mesh) {
  TextureFit fit;
  if (mesh.texture.empty()) return fit;
  fit.everywhere = true;
  Vec2 low = Vec2::Constant(1e300), high = -low;
  std::vector<double> ratios;
  // Equal coordinates under several numbers are one place.
  std::map<std::pair<double, double>, int> places;
  std::vector<int> place_of(mesh.texture.size());
  for (std::size_t i = 0; i < mesh.texture.size(); ++i) {
    const Vec2& at = mesh.texture[i];
    place_of[i] = places.emplace(std::pair(at.x(), at.y()), static_cast<int>(places.size())).first->second;
  }
  for (std::size_t f = 0; f < mesh.faces.size(); ++f) {
    if (!textured(mesh, f)) {
      if (mesh.face_number[f] > 0) fit.everywhere = false;
      continue;
    }
    if (texture_area(mesh, f) < 0.0) ++fit.mirrored;
    for (std::size_t k = 0; k < 3; ++k) {
      low = low.cwiseMin(vt(mesh, f, k));
      high = high.cwiseMax(vt(mesh, f, k));
      const double drawn = (mesh.at(mesh.faces[f][(k + 1) % 3]) - mesh.at(mesh.faces[f][k])).norm();
      const double flat = (vt(mesh, f, (k + 1) % 3) - vt(mesh, f, k)).norm();
      if (flat > 0.0) ratios.push_back(drawn / flat);
    }
  }
  fit.one_point = !((high - low).maxCoeff() > 0.0) || ratios.empty();
  if (fit.one_point) return fit;
  fit.scale = median_of(ratios);
  for (double& ratio : ratios) ratio = std::abs(fit.scale / ratio - 1.0);
  fit.median_strain = median_of(ratios);
  DisjointSets islands(mesh.faces.size());
  for_each_edge(mesh_sides(mesh.faces), [&](const MeshSide* begin, const MeshSide* end) {
    if (end - begin != 2) return;
    const auto f = static_cast<std::size_t>(begin[0].face), g = static_cast<std::size_t>(begin[1].face);
    if (!textured(mesh, f) || !textured(mesh, g)) return;
    const auto place = [&](const MeshSide& side, int v) {
      std::size_t k = 0;
      while (mesh.faces[static_cast<std::size_t>(side.face)][k] != v) ++k;
      return place_of[static_cast<std::size_t>(mesh.face_texture[static_cast<std::size_t>(side.face)][k])];
    };
    if (place(begin[0], begin->first) == place(begin[1], begin->first) &&
        place(begin[0], begin->second) == place(begin[1], begin->second)) {
      islands.unite(begin[0].face, begin[1].face);
    } else {
      ++fit.seam_edges;
    }
  });
  for (std::size_t f = 0; f < mesh.faces.size(); ++f) {
    if (textured(mesh, f) && islands.root(static_cast<int>(f)) == static_cast<int>(f)) ++fit.islands;
  }
  return fit;
}

FoundRest find_rest_shape(ImportMesh& mesh, Findings& findings) {
  const TextureFit fit = fit_texture(mesh);
  const auto faces = static_cast<std::int64_t>(mesh.faces.size());
  const bool mirrored = fit.mirrored == faces;
  const double thick = lay_flat(mesh, findings);
  if (thick >= 0.0) {
    const std::int64_t down = turn_up(mesh, findings);
    if (down > 0) {
      findings.push_back({"rest shape", FindingKind::fact, down,
                          counted(down, "face") +
                              " of the flat mesh look down: a front and a back that are joined. Each "
                              "face keeps its own lengths, the weft runs along y"});
      return {RestForm::two_sides, RestPositions(0, 2)};
    }
    const bool metric = fit.has_size() && fit.one_chart() && fit.median_strain <= kMetricStrain &&
                        std::abs(fit.scale - 1.0) <= kMetricStrain && fit_texture(mesh).mirrored == 0;
    if (metric) {
      findings.push_back({"rest shape", FindingKind::fact, 1,
                          "the texture coordinates (vt) are a rest shape in metres: kept, their x is the warp"});
      return {RestForm::chart, rest_of_texture(mesh, 1.0, false)};
    }
    Finding finding{"rest shape", FindingKind::fact, 1, "the mesh itself, its x is the warp"};
    if (!mesh.texture.empty()) {
      finding.kind = FindingKind::mended;
      finding.text +=
          "; " + (fit.has_size() && fit.one_chart() ? "the texture repeats the mesh at another scale (" +
                                                          length_text(fit.scale) + " per unit) and is dropped"
                                                    : texture_text(fit));
    }
    findings.push_back(finding);
    RestPositions rest(static_cast<Index>(mesh.positions.size()), 2);
    for (Index v = 0; v < rest.rows(); ++v) rest.row(v) = mesh.at(static_cast<int>(v)).head<2>().transpose();
    return {RestForm::chart, rest};
  }

  double z_low = mesh.positions.front().z(), z_high = z_low;
  for (const Vec3& p : mesh.positions) {
    z_low = std::min(z_low, p.z());
    z_high = std::max(z_high, p.z());
  }
  const bool turns_both_ways = fit.mirrored > 0 && !mirrored;
  if (fit.has_size() && fit.one_chart() && !turns_both_ways) {
    const RestPositions rest = rest_of_texture(mesh, fit.scale, mirrored);
    for (Index v = 0; v < rest.rows(); ++v) {
      mesh.positions[static_cast<std::size_t>(v)] = Vec3(rest(v, 0), rest(v, 1), 0.0);
    }
    findings.push_back({"rest shape", FindingKind::mended, 1,
                        "from the texture, at " + length_text(fit.scale) + " per unit" +
                            (mirrored ? ", mirrored" : "") + ": it repeats the mesh's edges within " +
                            percent(fit.median_strain) + " in the median; the cloth was laid flat by it (it was " +
                            length_text(z_high - z_low) + " high)"});
    turn_up(mesh, findings);
    return {RestForm::chart, rest};
  }
  if (!mesh.texture.empty()) {
    findings.push_back({"texture", FindingKind::fact, fit.seam_edges, texture_text(fit)});
  }
  const MeshPiece piece = pieces_of(mesh).front();
  std::string shape = "an open sheet";
  if (piece.loops.size() > 1 || piece.handles() > 0) {
    shape = "a surface with " +
            counted(static_cast<std::int64_t>(piece.loops.size()), "open boundary", "open boundaries") +
            ", such as a tube";
  } else if (piece.loops.empty()) {
    shape = "a closed surface without an opening";
  }
  findings.push_back({"rest shape", FindingKind::fact, 1,
                      "not flat (" + length_text(z_high - z_low) + " high, " + shape +
                          "): each face keeps the lengths that it is drawn with; the garment is laid on the table by "
                          "simulation"});
  return {RestForm::worn, RestPositions(0, 2)};
}

std::vector<double> flat_layers(const ImportMesh& mesh, Findings& findings) {
  std::vector<double> layers(mesh.positions.size(), 0.0);
  const auto pieces = pieces_of(mesh);
  std::vector<double> base(pieces.size(), 0.0);
  double most = 0.0;
  for (std::size_t i = 0; i < pieces.size(); ++i) {
    const auto is_down = [&](int f) { return mesh.area_vector(f).z() <= 0.0; };
    const bool has_back = std::any_of(pieces[i].faces.begin(), pieces[i].faces.end(), is_down);
    for (std::size_t j = 0; j < i; ++j)
      if (pieces_meet(mesh, pieces[i], pieces[j])) base[i] = std::max(base[i], base[j] + 2.0);
    std::vector<bool> below(mesh.positions.size(), false);
    for (const int f : pieces[i].faces)
      if (is_down(f))
        for (const int v : mesh.faces[f]) below[v] = true;
    for (const int f : pieces[i].faces)
      for (const int v : mesh.faces[f]) {
        const auto at = static_cast<std::size_t>(v);
        layers[at] = base[i] + (has_back && !below[at] ? 1.0 : 0.0);
        most = std::max(most, layers[at]);
      }
  }
  if (most == 0.0) return {};
  findings.push_back({"layers", FindingKind::fact, static_cast<std::int64_t>(most) + 1,
                      "the cloth lies in layers 0 to " + std::to_string(static_cast<int>(most)) +
                          "; each lies a thickness above the one below"});
  return layers;
}

}  // namespace weft
