#include "experiments/physics/textiles.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "experiments/physics/sheets.hpp"
#include "meshes/mesher.hpp"
#include "session/shape_errors.hpp"

namespace weft::physics {
namespace {

// Cusick's discs: the cloth, and the support in its middle.
constexpr double kDiscRadius = 0.15, kSupportRadius = 0.09;

Fabric fabric_of(const PhysicsParams& p) { return p.fabric.is_null() ? test_fabric(p) : read_fabric(p.fabric); }

GeneratedMesh disc(double edge) {
  Outline outline;
  constexpr int kPoints = 240;
  for (int i = 0; i < kPoints; ++i) {
    const double angle = 2.0 * std::numbers::pi * i / kPoints;
    outline.points.push_back({kDiscRadius * Vec2(std::cos(angle), std::sin(angle)), "", i % (kPoints / 4) == 0});
  }
  MeshSize size;
  size.edge_m = edge;
  return generate_mesh(outline, size);
}

/// The folds of a draped disc: maxima of the radius along its rim that stand out by 3 mm.
int lobes(const Garment& disc, const Positions& shape) {
  std::vector<std::pair<double, double>> rim;  // angle in the rest shape, radius in the draped one
  for (Index v = 0; v < disc.vertex_count(); ++v) {
    const Vec2 rest = disc.rest.row(v).transpose();
    if (rest.norm() > kDiscRadius - 1e-4)
      rim.emplace_back(std::atan2(rest.y(), rest.x()), shape.row(v).head<2>().norm());
  }
  std::sort(rim.begin(), rim.end());
  // From the lowest point on, each rise by 3 mm above the last valley that is followed by a fall of 3 mm is a lobe.
  const auto lowest = std::min_element(rim.begin(), rim.end(), [](auto a, auto b) { return a.second < b.second; });
  std::rotate(rim.begin(), lowest, rim.end());
  rim.push_back(rim.front());
  constexpr double kStandsOut = 0.003;
  int count = 0;
  bool rises = true;
  double extreme = rim.front().second;
  for (const auto& [angle, radius] : rim) {
    if (rises ? radius < extreme : radius > extreme) extreme = radius;
    if (rises && radius > extreme + kStandsOut) rises = false, extreme = radius;
    if (!rises && radius < extreme - kStandsOut) rises = true, extreme = radius, ++count;
  }
  return count;
}

/// Whether a disc comes to rest on its support, and the drape coefficient: the part of the ring around the support that the
/// cloth's shadow covers, %. It is compared where the fabric has a band.
std::vector<PhysicsRow> drape(const PhysicsParams& p, const SimulatorVariant& variant, const std::string& name) {
  constexpr double kAtRest = 0.002;  // m/s
  // Cotton of 5 mm edges drapes to 60 %, of 3.6 and 2.5 mm to 64 %.
  const double edge = std::min(p.fine_edge_m, (kDiscRadius - kSupportRadius) / 16.0);
  const auto garment = std::make_shared<const Garment>(make_garment(disc(edge).mesh, "disc"));
  Fabric fabric = fabric_of(p);
  // Brings it to rest. The shape at rest has no drag.
  fabric.damping_air_per_s = std::max(fabric.damping_air_per_s, 5.0);
  Scene scene = no_ground();
  // The last held vertices lie half an edge within the support on average, and hold the cloth half an edge further.
  for (Index v = 0; v < garment->vertex_count(); ++v)
    if (garment->rest.row(v).norm() <= kSupportRadius) scene.pins.push_back(v);
  const auto simulator = variant.make();
  simulator->reset(garment, fabric, scene);
  rest(*simulator, kAtRest, 1200);
  const double ring = std::numbers::pi * (kDiscRadius * kDiscRadius - kSupportRadius * kSupportRadius);
  const double shadow = silhouette_area(simulator->positions(), garment->faces, 0.0005);
  const double percent = 100.0 * (shadow - std::numbers::pi * kSupportRadius * kSupportRadius) / ring;
  const double speed = simulator->velocities().rowwise().norm().maxCoeff();
  const std::string seen =
      text("drapes to %.1f %%, ", percent) + std::to_string(lobes(*garment, simulator->positions())) + " lobes";
  std::vector<PhysicsRow> rows{row("drape", variant, name, "settled speed m/s", 0.0, speed, speed, kAtRest, seen)};
  const std::optional<DrapeBand> band = p.fabric.is_null() ? std::nullopt : read_drape_band(p.fabric);
  if (band) {
    const double middle = 0.5 * (band->low + band->high);
    rows.push_back(row("drape", variant, name, "drape coefficient %", middle, percent, std::abs(percent - middle),
                       0.5 * (band->high - band->low), band->source));
  }
  return rows;
}

enum class Direction { warp, bias, weft };
constexpr Direction kDirections[] = {Direction::warp, Direction::bias, Direction::weft};
const char* name_of(Direction direction) {
  return direction == Direction::warp ? "warp" : direction == Direction::bias ? "bias" : "weft";
}
double turn_of(Direction direction) { return 0.25 * std::numbers::pi * static_cast<double>(direction); }

/// The length at which a strip of 25 mm hangs down to 41.5 degrees. Half of it is the bending length c = (B / w)^(1/3):
/// the heavy elastica has that angle at w L^3 / B = 8. Along warp and weft, as a strip on the bias also twists.
PhysicsRow bending_length(const PhysicsParams& p, const SimulatorVariant& variant, const std::string& name,
                          Direction direction) {
  constexpr double kAngle = 41.5, kWidth = 0.025, kFreeEdges = 12.5;
  const Fabric fabric = fabric_of(p);
  const double bend = direction == Direction::warp ? fabric.bend_warp_n_m : fabric.bend_weft_n_m;
  const double wanted = std::cbrt(bend / (fabric.density_kg_per_m2 * kGravity));
  const auto simulator = variant.make();
  double length = 2.0 * wanted, angle = 0.0;
  for (int i = 0; i < 6 && std::abs(angle - kAngle) > 0.2; ++i) {
    const double edge = length / kFreeEdges;
    const Sheet sheet = strip(length + 0.5 * edge, std::max(2.0, std::round(kWidth / edge)) * edge, edge,
                              Pattern::regular, turn_of(direction));
    const Vec2 tip = cantilever(*simulator, sheet, fabric, bend);
    angle = std::atan2(tip.y(), tip.x()) * 180.0 / std::numbers::pi;
    length *= std::exp((kAngle - angle) / 72.0);  // by the elastica's slope there, degrees per ratio
  }
  return relative("bending length", variant, name, "bending length m", wanted, 0.5 * length, 0.03,
                  text("overhang %.1f mm", 1e3 * length));
}

/// Stiffness of a strip of 800 x 20 mm that its weight stretches by 0.2 % at the tip: so narrow that the clamp, where its width
/// stays, hardly counts. Along the bias it is that of an orthotropic sheet: 1/E = (1/K_warp + 1/K_weft - 2 nu / K_warp +
/// 1/K_shear) / 4.
PhysicsRow tensile(const PhysicsParams& p, const SimulatorVariant& variant, const std::string& name,
                   Direction direction) {
  constexpr double kLength = 0.8, kWidth = 0.02, kEdge = 0.005, kExtension = 0.002;
  Fabric fabric = fabric_of(p);
  const double warp = fabric.stretch_warp_n_per_m, weft = fabric.stretch_weft_n_per_m;
  const double bias =
      4.0 / (1.0 / warp + 1.0 / weft - 2.0 * fabric.poisson / warp + 1.0 / fabric.stretch_shear_n_per_m);
  const double wanted = direction == Direction::warp ? warp : direction == Direction::bias ? bias : weft;
  const double gravity = 2.0 * kExtension * wanted / (fabric.density_kg_per_m2 * kLength);
  const Sheet sheet = strip(kLength, kWidth, kEdge, Pattern::regular, turn_of(direction));
  const auto simulator = variant.make();
  const double extension = hang(*simulator, sheet, fabric, wanted, gravity);
  return relative("tensile", variant, name, "stiffness N/m", wanted,
                  fabric.density_kg_per_m2 * gravity * kLength * kLength / (2.0 * extension), 0.03,
                  text("strained by %.2f %%", 100.0 * extension / kLength));
}

}  // namespace

std::optional<DrapeBand> read_drape_band(const ConfigNode& fabric) {
  const ConfigNode node = fabric.is_scalar() ? ConfigNode::load(fabric.as_path()) : fabric;
  const auto drape = node.find("drape");
  if (!drape) {
    const auto file = node.find("file");
    return file ? read_drape_band(*file) : std::nullopt;
  }
  const ConfigNode percent = drape->at("percent");
  DrapeBand band;
  if (!percent.is_sequence() || percent.size() != 2) percent.fail("must be [LOW, HIGH], in percent");
  band.low = percent[0].as_double();
  band.high = percent[1].as_double();
  if (!(0.0 <= band.low && band.low < band.high && band.high <= 100.0))
    percent.fail("= " + shown(percent) + ", must be rising, in [0, 100]");
  band.source = drape->at("source").as_string();
  return band;
}

void add_textiles(std::vector<PhysicsCase>& cases, const PhysicsParams& p) {
  if (!p.fabric.is_null()) {  // what is wrong with it is said before any work
    read_fabric(p.fabric);
    read_drape_band(p.fabric);
  }
  cases.push_back({"drape", "disc of 300 mm on 180 mm", [=](const std::vector<SimulatorVariant>& variants) {
                     return drape(p, variants[0], "disc of 300 mm on 180 mm");
                   }});
  for (const Direction direction : kDirections) {
    const std::string name = std::string("along ") + name_of(direction);
    cases.push_back({"tensile", name, [=](const std::vector<SimulatorVariant>& variants) {
                       return std::vector<PhysicsRow>{tensile(p, variants[0], name, direction)};
                     }});
    if (direction == Direction::bias) continue;
    cases.push_back({"bending length", name, [=](const std::vector<SimulatorVariant>& variants) {
                       return std::vector<PhysicsRow>{bending_length(p, variants[0], name, direction)};
                     }});
  }
}

}  // namespace weft::physics
