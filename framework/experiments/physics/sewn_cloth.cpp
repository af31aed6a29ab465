#include "experiments/physics/sewn_cloth.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "experiments/physics/sheets.hpp"
#include "meshes/sewing.hpp"
#include "weft/rest_shape.hpp"

namespace weft::physics {
namespace {

/// Mean extension along gravity of `tip`, m, of a garment that hangs by `pins`, damped near the critical drag.
double hang_garment(Simulator& simulator, const std::shared_ptr<const Garment>& garment, Fabric fabric,
                    const std::vector<Index>& pins, const std::vector<Index>& tip, double length, double stiffness) {
  fabric.damping_air_per_s = 1.5 * std::numbers::pi / length * std::sqrt(stiffness / fabric.density_kg_per_m2);
  Scene scene = no_ground();
  scene.pins = pins;
  simulator.reset(garment, fabric, scene);
  rest(simulator, 1e-6, 600);
  double fall = 0.0;
  for (const Index v : tip) fall += garment->positions(v, 2) - simulator.positions()(v, 2);
  return fall / static_cast<double>(tip.size());
}

/// A tube that hangs by its upper rim stretches like the sheet it is made of: density g L^2 / 2 K.
PhysicsRow hanging_tube(const PhysicsParams& p, const SimulatorVariant& variant, double edge) {
  const double radius = 0.08, height = 0.4;
  const auto around = static_cast<Index>(std::lround(2.0 * std::numbers::pi * radius / edge)),
             along = static_cast<Index>(std::lround(height / edge));
  const Mesh mesh = tube(around, along, radius, height);
  GarmentForm form;
  form.frames = frames_of_shape(mesh.positions, mesh.faces, usual_grain(mesh.positions));
  const auto garment = std::make_shared<const Garment>(make_garment(mesh, "tube", {}, std::move(form)));
  std::vector<Index> top, bottom;
  for (Index i = 0; i < around; ++i) bottom.push_back(i), top.push_back(around * along + i);
  Fabric fabric = test_fabric(p);
  fabric.stretch_weft_n_per_m = 2.0 * fabric.stretch_warp_n_per_m;  // the weft runs up a tube
  const double wanted = p.density_kg_per_m2 * kGravity * height * height / (2.0 * fabric.stretch_weft_n_per_m);
  const auto simulator = variant.make();
  const double got = hang_garment(*simulator, garment, fabric, top, bottom, height, fabric.stretch_weft_n_per_m);
  return relative("closed tube", variant, mm(edge) + " hanging", "extension m", wanted, got, 0.02);
}

/// A front and a back over each other, sewn along the column x = 0, the back a thickness below.
struct TwoSheets {
  SewnMesh sewn;
  Sheet front;
  TwoSheets(double length, double width, double edge, double thickness)
      : front(strip(length, width, edge, Pattern::regular)) {
    sewn = sew_front_and_back({front.positions, front.faces, RestPositions(0, 2), "two layers"},
                              [&](const Vec2& a, const Vec2& b) { return a.x() < 1e-9 && b.x() < 1e-9; });
    for (std::size_t v = 0; v < sewn.back.size(); ++v)
      if (sewn.back[v] != static_cast<int>(v)) sewn.mesh.positions(sewn.back[v], 2) = -thickness;
    sewn.form.layers.clear();  // it hangs in the air
  }
  std::vector<Index> columns(double x) const {
    std::vector<Index> both_layers = front.column(x);
    for (const Index v : front.column(x)) both_layers.push_back(sewn.back[v]);
    std::sort(both_layers.begin(), both_layers.end());
    both_layers.erase(std::unique(both_layers.begin(), both_layers.end()), both_layers.end());
    return both_layers;
  }
};

/// Two sheets that are sewn at one edge hang from it, each like the single one.
PhysicsRow hanging_layers(const PhysicsParams& p, const SimulatorVariant& variant, double edge) {
  const double length = 0.4;
  TwoSheets two(length, 0.4, edge, 0.001);
  // Hung up: x becomes -z, so that the layers hang side by side.
  const Positions flat = two.sewn.mesh.positions;
  two.sewn.mesh.positions.col(0) = flat.col(2);
  two.sewn.mesh.positions.col(2) = -flat.col(0);
  const auto garment =
      std::make_shared<const Garment>(make_garment(two.sewn.mesh, "two layers", {}, std::move(two.sewn.form)));
  const Fabric fabric = test_fabric(p);
  const double wanted = p.density_kg_per_m2 * kGravity * length * length / (2.0 * p.stretch_n_per_m);
  const auto simulator = variant.make();
  const double got =
      hang_garment(*simulator, garment, fabric, two.columns(0.0), two.columns(length), length, p.stretch_n_per_m);
  return relative("two layers", variant, mm(edge) + " square hanging", "extension m", wanted, got, 0.02);
}

/// Without friction, two layers that bend together have twice the stiffness and twice the weight: the single sheet's tip.
PhysicsRow bending_layers(const PhysicsParams& p, const SimulatorVariant& variant) {
  const double edge = p.fine_edge_m, g = 2.0, drop = 0.23851, x = 0.96689;  // heavy elastica, w L^3 / B = 2
  const TwoSheets two(21 * edge, 6 * edge, edge, 0.0005);
  const double length = two.front.length - 0.5 * edge;
  Fabric fabric = test_fabric(p);
  fabric.thickness_m = 0.0005;
  fabric.self_friction = 0.0;
  const double bend = p.density_kg_per_m2 * kGravity * std::pow(length, 3) / g;
  set_bend(fabric, bend);
  fabric.damping_air_per_s =
      1.4 * std::sqrt(12.4 * bend / (fabric.density_kg_per_m2 * std::pow(length, 4)) + 1.5 * kGravity / length);
  Scene scene = no_ground();
  for (const double at : {0.0, two.front.edge})
    for (const Index v : two.columns(at)) scene.pins.push_back(v);
  const auto garment = std::make_shared<const Garment>(make_garment(two.sewn.mesh, "two layers", {}, two.sewn.form));
  const auto simulator = variant.make();
  simulator->reset(garment, fabric, scene);
  rest(*simulator, 2e-4, 900);
  Vec3 tip = Vec3::Zero();
  const auto last = two.front.column(two.front.length);  // of the front, which carries no one
  for (const Index v : last) tip += simulator->positions().row(v).transpose() / static_cast<double>(last.size());
  const double got_x = (tip.x() - 0.5 * edge) / length, got_drop = -tip.z() / length;
  return row("two layers", variant, mm(edge) + " bending G=2", "drop/L", drop, got_drop,
             std::hypot(got_x - x, got_drop - drop), 0.03, text("x/L %.4f", got_x) + text(" for %.4f", x));
}

}  // namespace

void add_sewn_cloth(std::vector<PhysicsCase>& cases, const PhysicsParams& p) {
  for (const double edge : {p.garment_edge_m, 0.5 * p.garment_edge_m}) {
    cases.push_back({"closed tube", mm(edge) + " hanging", [=](const std::vector<SimulatorVariant>& variants) {
                       return std::vector<PhysicsRow>{hanging_tube(p, variants[0], edge)};
                     }});
    cases.push_back({"two layers", mm(edge) + " square hanging", [=](const std::vector<SimulatorVariant>& variants) {
                       return std::vector<PhysicsRow>{hanging_layers(p, variants[0], edge)};
                     }});
  }
  cases.push_back(
      {"two layers", mm(p.fine_edge_m) + " bending G=2", [=](const std::vector<SimulatorVariant>& variants) {
         return std::vector<PhysicsRow>{bending_layers(p, variants[0])};
       }});
}

}  // namespace weft::physics
