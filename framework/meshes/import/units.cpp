#include "meshes/import/units.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "weft/config.hpp"
#include "weft/error.hpp"

namespace weft {
namespace {

constexpr double kSmallestGarment = 0.3, kLargestGarment = 2.5;  // m, largest extent

struct Unit {
  const char* name;
  const char* text;
  double metres;
};
constexpr Unit kUnits[] = {
    {"m", "metres", 1.0}, {"cm", "centimetres", 0.01}, {"mm", "millimetres", 0.001}, {"in", "inches", 0.0254}};

/// How far a size is from that of a garment, as the logarithm of a factor.
double strangeness(double metres) {
  return std::max({0.0, std::log(kSmallestGarment / metres), std::log(metres / kLargestGarment)});
}

const Unit& guess_unit(double extent, const std::string& source, Finding& finding) {
  const Unit* best = &kUnits[0];
  for (const Unit& unit : kUnits) {
    if (strangeness(extent * unit.metres) < strangeness(extent * best->metres)) best = &unit;
  }
  const double size = extent * best->metres;
  if (strangeness(size) > std::log(4.0)) {
    throw ConfigError(source + ": the mesh is " + ConfigNode::number(extent).as_string() +
                      " units large, which no unit makes a garment: give --units m, cm, mm or in");
  }
  finding.text = "guessed " + std::string(best->text) + ": the largest extent of " +
                 ConfigNode::number(std::round(extent * 1e4) / 1e4).as_string() + " is then " + length_text(size);
  std::string others;
  for (const Unit& unit : kUnits) {
    if (&unit != best && strangeness(extent * unit.metres) == 0.0) {
      others += (others.empty() ? "" : ", ") + std::string(unit.text) + " (" + length_text(extent * unit.metres) + ")";
    }
  }
  if (!others.empty()) {
    finding.kind = FindingKind::warning;
    finding.text += "; it may also be " + others + ": give --units";
  } else if (strangeness(size) > 0.0) {
    finding.kind = FindingKind::warning;
    finding.text += ", a strange size for a garment: give --units if it is wrong";
  }
  return *best;
}

/// Sums over the open edges p x q: twice the area that the openings enclose, seen along each axis. Interior edges
/// cancel, so no loop needs to be followed; inconsistent faces only blur the guess. Slits and missing faces do not
/// count.
Vec3 area_of_openings(const ImportMesh& mesh, std::vector<Vec3>& loops) {
  const auto sides = mesh_sides(mesh.faces);
  DisjointSets sets(mesh.positions.size());
  std::vector<std::pair<int, int>> open;
  for_each_edge(sides, [&](const MeshSide* begin, const MeshSide* end) {
    if (end - begin != 1) return;
    open.emplace_back(begin->upwards ? begin->first : begin->second, begin->upwards ? begin->second : begin->first);
    sets.unite(begin->first, begin->second);
  });
  std::vector<Vec3> area(mesh.positions.size(), Vec3::Zero());
  for (const auto& [a, b] : open) {
    const Vec3& origin = mesh.at(sets.root(a));
    area[static_cast<std::size_t>(sets.root(a))] += (mesh.at(a) - origin).cross(mesh.at(b) - origin);
  }
  double largest = 0.0;
  for (const Vec3& loop : area) largest = std::max(largest, loop.norm());
  Vec3 sum = Vec3::Zero();
  for (const Vec3& loop : area) {
    if (loop.norm() <= 0.02 * largest) continue;
    loops.push_back(loop);
    sum += loop.cwiseAbs();
  }
  return sum;
}

/// The axis (0, 1, 2) that a mesh stands along.
int guess_up(const ImportMesh& mesh, Finding& finding) {
  Vec3 low = mesh.positions.front(), high = low;
  for (const Vec3& p : mesh.positions) {
    low = low.cwiseMin(p);
    high = high.cwiseMax(p);
  }
  const Vec3 extent = high - low;
  const char* const names = "xyz";
  Index thin = 0;
  extent.minCoeff(&thin);
  if (extent(thin) < 1e-3 * extent.maxCoeff()) {
    finding.text = std::string("guessed up axis ") + names[thin] + ": the mesh is flat across it";
    return static_cast<int>(thin);
  }
  std::vector<Vec3> loops;
  const Vec3 openings = area_of_openings(mesh, loops);
  Index along = 0;
  const double most = openings.maxCoeff(&along);
  if (loops.size() > 1 && most > 0.6 * openings.sum()) {
    finding.text = std::string("guessed up axis ") + names[along] + ": its " + std::to_string(loops.size()) +
                   " openings look along it (" +
                   std::to_string(static_cast<int>(std::lround(100.0 * most / openings.sum()))) + " % of their area)";
    return static_cast<int>(along);
  }
  finding.kind = FindingKind::warning;
  finding.text = "guessed up axis y, as most programs write it: the shape does not tell; give --up";
  return 1;
}

}  // namespace

void to_metres_z_up(ImportMesh& mesh, const FileFrame& known, Findings& findings) {
  const double extent = mesh.largest_extent();
  if (!(extent > 0.0)) throw ConfigError(mesh.source + ": all vertices lie at one point");
  Finding unit_finding{"units", FindingKind::fact, 1, ""};
  const Unit* unit = nullptr;
  if (known.units) {
    for (const Unit& one : kUnits) {
      if (*known.units == one.name) unit = &one;
    }
    if (unit == nullptr) throw ConfigError("--units = " + *known.units + ", must be one of m, cm, mm, in");
    const double size = extent * unit->metres;
    unit_finding.text = std::string(unit->text) + " (" + known.reason + "): the largest extent is " + length_text(size);
    if (strangeness(size) > 0.0) {
      unit_finding.kind = FindingKind::warning;
      unit_finding.text += ", a strange size for a garment";
    }
  } else {
    unit = &guess_unit(extent, mesh.source, unit_finding);
  }
  if (unit->metres != 1.0) {
    for (Vec3& p : mesh.positions) p *= unit->metres;
    if (unit_finding.kind == FindingKind::fact) unit_finding.kind = FindingKind::mended;
  }
  findings.push_back(unit_finding);

  Finding up_finding{"up", FindingKind::fact, 1, ""};
  int axis = 0;
  bool down = false;
  if (known.up) {
    const std::string name = known.up->starts_with("-") ? known.up->substr(1) : *known.up;
    down = name.size() != known.up->size();
    if (name.size() != 1 || name[0] < 'x' || name[0] > 'z') {
      throw ConfigError("--up = " + *known.up + ", must be one of x, y, z, -x, -y, -z");
    }
    axis = name[0] - 'x';
    up_finding.text = *known.up + " is up (" + known.reason + ")";
  } else {
    axis = guess_up(mesh, up_finding);
  }
  // Rotations, so that no mesh is mirrored: about x from y, about y from x, by half a turn about x from -z.
  for (Vec3& p : mesh.positions) {
    if (axis == 1) p = Vec3(p.x(), -p.z(), p.y());
    if (axis == 0) p = Vec3(-p.z(), p.y(), p.x());
    if (down) p = Vec3(p.x(), -p.y(), -p.z());
    for (Index k = 0; k < 3; ++k) p(k) += 0.0;  // no -0
  }
  if (axis != 2 || down) {
    up_finding.text += "; turned so that z is up";
    if (up_finding.kind == FindingKind::fact) up_finding.kind = FindingKind::mended;
  }
  findings.push_back(up_finding);
}

}  // namespace weft
