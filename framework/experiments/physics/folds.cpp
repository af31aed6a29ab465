#include "experiments/physics/folds.hpp"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "experiments/physics/sheets.hpp"
#include "meshes/intersections.hpp"
#include "sdk/cpu_time.hpp"
#include "simulation/fold.hpp"
#include "weft/error.hpp"
#include "weft/random.hpp"

namespace weft::physics {
namespace {

/// Height of a heavy folded strip's loop over its lower layer's mid-surface. At both ends of the loop the layers touch
/// down without curvature; the loop pushes the layers apart, so they must stick (friction 1, layers long enough), and
/// it finds its length by rolling on and off them. The strip starts as two layers and a lower, tighter half circle.
double crease(Simulator& simulator, double edge, double bend, Pattern pattern, const PhysicsParams& p) {
  Fabric fabric = test_fabric(p);
  set_bend(fabric, bend);
  fabric.friction = fabric.self_friction = 1.0;
  fabric.thickness_m = 0.0005;
  const double l = std::cbrt(bend / (p.density_kg_per_m2 * kGravity));
  const double layer = std::max(6.0 * l, 6.0 * edge), radius = 0.35 * l, arc = std::numbers::pi * radius;
  const double cells = std::round((2.0 * layer + arc) / edge);
  Sheet sheet = strip(cells * edge, 4 * edge, edge, pattern);
  const double bottom = 0.5 * (sheet.length - arc);
  for (Index i = 0; i < sheet.positions.rows(); ++i) {
    const double s = sheet.flat(i, 0);
    double x = s, z = 0.0;
    if (s > bottom) {
      const double a = std::min((s - bottom) / radius, std::numbers::pi);
      x = bottom + radius * std::sin(a) - std::max(0.0, s - bottom - arc);
      z = radius * (1.0 - std::cos(a));
    }
    sheet.positions.row(i) << x, sheet.flat(i, 1), z + fabric.thickness_m;
  }
  fabric.damping_air_per_s = 6.0;
  simulator.reset(sheet.garment("crease"), fabric, Scene());
  rest(simulator, 1e-3, 600);
  return simulator.positions().col(2).maxCoeff() - fabric.thickness_m;
}

}  // namespace

void add_crease(std::vector<PhysicsCase>& cases, const PhysicsParams& p, const std::shared_ptr<const Task>& task) {
  struct Level {
    double edge, edges_per_length;  // (B / w)^(1/3) in edges
  };
  for (const Level level : {Level{p.fine_edge_m, 3.0},
                            {p.fine_edge_m, 5.0},
                            {p.fine_edge_m, 10.0},
                            {2 * p.fine_edge_m, 3.0},
                            {2 * p.fine_edge_m, 5.0},
                            {p.garment_edge_m, 3.0}})
    for (const Pattern pattern : {Pattern::regular, Pattern::rotated, Pattern::irregular}) {
      const std::string name =
          mm(level.edge) + " " + name_of(pattern) + text(" (B/w)^1/3 = %g edges", level.edges_per_length);
      cases.push_back({"crease", name, [=](const std::vector<SimulatorVariant>& variants) {
                         const double l = level.edge * level.edges_per_length;
                         const double bend = std::pow(l, 3) * p.density_kg_per_m2 * kGravity;
                         const auto simulator = variants[0].make();
                         return std::vector<PhysicsRow>{relative("crease", variants[0], name, "height m", 0.907 * l,
                                                                 crease(*simulator, level.edge, bend, pattern, p),
                                                                 0.10)};
                       }});
    }
  if (task) {
    cases.push_back(
        {"garment crease", "default fold", [=](const std::vector<SimulatorVariant>& variants) {
           const Task& t = *task;
           const auto simulator = variants[0].make();
           const MaterialProperties q = MaterialProperties::Constant(0.5);
           const FoldResult fold = simulate_fold(*simulator, t, q, t.trajectory->default_controls(25));
           const Fabric fabric = t.material.at(q);
           // The fold line is normal to d; bending runs along d.
           const Vec2 d = t.manipulation.displacement / t.manipulation.displacement.norm();
           const double c2 = d.x() * d.x(), s2 = d.y() * d.y();
           const double bend = fabric.bend_warp_n_m * c2 * c2 + fabric.bend_weft_n_m * s2 * s2 +
                               (4 * fabric.bend_bias_n_m - fabric.bend_warp_n_m - fabric.bend_weft_n_m) * c2 * s2;
           const double wanted = 0.907 * std::cbrt(bend / (fabric.density_kg_per_m2 * kGravity));
           // In bands across the fold line: the highest point within 1.5 loops of the outermost one.
           const Positions& x = fold.shapes.back();
           const Vector along = x.leftCols<2>() * d, across = x.leftCols<2>() * Vec2(-d.y(), d.x());
           const double low = across.minCoeff(), high = across.maxCoeff();
           std::vector<double> heights;
           constexpr int kBands = 12;
           for (int band = 2; band < kBands - 3; ++band) {
             const double from = low + (high - low) * band / kBands, to = low + (high - low) * (band + 1) / kBands;
             double outermost = 1e300, highest = 0.0;
             for (Index i = 0; i < x.rows(); ++i)
               if (across[i] >= from && across[i] < to) outermost = std::min(outermost, along[i]);
             for (Index i = 0; i < x.rows(); ++i)
               if (across[i] >= from && across[i] < to && along[i] < outermost + 1.5 * wanted)
                 highest = std::max(highest, x(i, 2));
             heights.push_back(highest - fabric.thickness_m);
           }
           std::sort(heights.begin(), heights.end());
           return std::vector<PhysicsRow>{relative(
               "garment crease", variants[0], t.garment->name + text(", %.0f vertices", static_cast<double>(x.rows())),
               "median height m", wanted, heights[heights.size() / 2], 0.25,
               text("from %.4f", heights.front()) + text(" to %.4f", heights.back()))};
         }});
  }
}

namespace {

/// Largest |principal stretch - 1| over the faces that are no closer than `radius` (m, at rest) to a grasped vertex.
class StrainAwayFromGrasps {
 public:
  StrainAwayFromGrasps(const Task& task, double radius) : garment_(*task.garment) {
    for (Index f = 0; f < garment_.face_count(); ++f) {
      bool near = false;
      for (int k = 0; k < 3; ++k)
        for (const Index grasp : task.manipulation.grasp_vertices)
          near |= (garment_.rest.row(garment_.faces(f, k)) - garment_.rest.row(grasp)).norm() <= radius;
      if (!near) faces_.push_back(f);
    }
  }
  double operator()(const Positions& x) const {
    double worst = 0.0;
    for (const Index f : faces_) {
      Eigen::Matrix2d rest;
      Eigen::Matrix<double, 3, 2> now;
      for (int k = 0; k < 2; ++k) {
        const int i = garment_.faces(f, 0), j = garment_.faces(f, k + 1);
        rest.col(k) = (garment_.rest.row(j) - garment_.rest.row(i)).transpose();
        now.col(k) = (x.row(j) - x.row(i)).transpose();
      }
      const Eigen::Matrix<double, 3, 2> deformation = now * rest.inverse();
      const Eigen::Matrix2d c = deformation.transpose() * deformation;
      const double mean = 0.5 * (c(0, 0) + c(1, 1)), apart = std::hypot(0.5 * (c(0, 0) - c(1, 1)), c(0, 1));
      for (const double square : {mean + apart, mean - apart})
        worst = std::max(worst, std::abs(std::sqrt(std::max(0.0, square)) - 1.0));
    }
    return worst;
  }

 private:
  const Garment& garment_;
  std::vector<Index> faces_;
};

struct RandomFold {
  MaterialProperties material;
  Controls controls;
};
RandomFold random_fold(const Task& task, const PhysicsParams::Folds& p, std::uint64_t seed) {
  RandomStream random(seed, 0x666f6c64);
  RandomFold fold;
  for (Index k = 0; k < fold.material.size(); ++k) fold.material[k] = random.uniform();
  fold.controls = random_controls(*task.trajectory, p.horizon, p.controls, random);
  return fold;
}

/// Worst of a group of folds, with the seeds that are out of bounds.
class Worst {
 public:
  Worst(std::string quantity, double bound) : quantity_(std::move(quantity)), bound_(bound) {}
  void add(std::uint64_t seed, double value) {
    if (by_seed_.empty() || by_seed_.back().first != seed) by_seed_.emplace_back(seed, value);
    by_seed_.back().second = std::max(by_seed_.back().second, value);
    if (value > worst_) worst_ = value, worst_seed_ = seed;
    if (!(value <= bound_) && last_failed_ != seed) {
      failed_ += " " + std::to_string(seed);
      last_failed_ = seed;
    }
  }
  PhysicsRow row_of(const SimulatorVariant& variant, const std::string& name) const {
    std::string note;
    if (!failed_.empty())
      note = "failing seeds:" + failed_;
    else if (worst_ > 0.0)
      note = "largest at seed " + std::to_string(worst_seed_);
    PhysicsRow result = row("folds", variant, name, quantity_, 0.0, worst_, worst_, bound_, note);
    result.by_seed = by_seed_;
    return result;
  }

 private:
  std::vector<std::pair<std::uint64_t, double>> by_seed_;
  std::string quantity_, failed_;
  double bound_ = 0.0, worst_ = 0.0;
  std::uint64_t worst_seed_ = 0, last_failed_ = std::numeric_limits<std::uint64_t>::max();
};

std::vector<PhysicsRow> random_folds(const SimulatorVariant& variant, const std::string& name, const Task& task,
                                     const PhysicsParams::Folds& p, std::uint64_t first, std::uint64_t end) {
  const StrainAwayFromGrasps strain(task, p.grasp_radius_m);
  const double ground = task.scene.ground_height.value_or(-1e300);
  Worst diverged("diverged", 0.0), crossings("edge/triangle crossings", 0.0), below("below ground m", 0.0);
  Worst speed("settled speed m/s", task.settle.speed), stretched("strain of the stiff half", 0.05);
  for (std::uint64_t seed = first; seed < end; ++seed) {
    const RandomFold fold = random_fold(task, p, seed);
    const auto simulator = variant.make();
    FoldResult result;
    try {
      result = simulate_fold(*simulator, task, fold.material, fold.controls);
    } catch (const Diverged&) {
      diverged.add(seed, 1.0);
      continue;
    }
    diverged.add(seed, 0.0);
    if (!result.released) {  // the horizon ended the path, so release the cloth at its end
      simulator->release();
      result.settle = simulator->settle(task.settle);
      result.shapes.back() = simulator->positions();
    }
    const Positions& x = result.shapes.back();
    crossings.add(seed, static_cast<double>(count_intersections(x, task.garment->faces)));
    below.add(seed, std::max(0.0, ground - x.col(2).minCoeff()));
    speed.add(seed, result.settle.max_speed);
    if (fold.material[2] < 0.5) continue;
    for (const Positions& shape : result.shapes) stretched.add(seed, strain(shape));
  }
  std::vector<PhysicsRow> rows;
  for (const Worst* one : {&diverged, &crossings, &below, &speed, &stretched})
    rows.push_back(one->row_of(variant, name));
  return rows;
}

/// Runs the same fold with the same fabric and hands in one or two simulators. Returns the figures of each, and the
/// distance between the settled shapes.
std::vector<PhysicsRow> paired_fold(const std::vector<SimulatorVariant>& variants, const std::string& name,
                                    const Task& task, const PhysicsParams::Folds& p, std::uint64_t seed) {
  const RandomFold fold = random_fold(task, p, seed);
  std::vector<Positions> shapes;
  std::vector<PhysicsRow> rows;
  const auto add = [&](const SimulatorVariant& variant, const char* quantity, double measured, double bound) {
    rows.push_back(row("paired folds", variant, name, quantity, 0.0, measured, measured, bound));
    rows.back().by_seed = {{seed, measured}};
  };
  for (const SimulatorVariant& variant : variants) {
    const auto simulator = variant.make();
    const double before = thread_cpu_seconds();
    FoldResult result = simulate_fold(*simulator, task, fold.material, fold.controls);
    if (!result.released) {
      simulator->release();
      result.settle = simulator->settle(task.settle);
    }
    const double ms = 1e3 * (thread_cpu_seconds() - before) / static_cast<double>(simulator->frame());
    shapes.push_back(simulator->positions());
    const double ground = task.scene.ground_height.value_or(-1e300);
    add(variant, "edge/triangle crossings",
        static_cast<double>(count_intersections(shapes.back(), task.garment->faces)), 0.0);
    add(variant, "below ground m", std::max(0.0, ground - shapes.back().col(2).minCoeff()), 0.0);
    add(variant, "settled speed m/s", result.settle.max_speed, task.settle.speed);
    rows.back().cpu_ms_per_frame = ms;
    rows.back().note = text("CPU %.1f ms/frame", ms);
  }
  // The models differ, so neither gives a bound. A fold that went another way would differ by decimetres.
  if (variants.size() > 1) {
    add(variants[0], "mean vertex distance mm", mean_distance_mm(shapes[0], shapes[1]), 100.0);
    rows.back().note = "from " + variants[1].name;
  }
  return rows;
}

}  // namespace

void add_folds(std::vector<PhysicsCase>& cases, const PhysicsParams& p, const std::shared_ptr<const Task>& task) {
  if (!task) return;
  constexpr std::uint64_t kGroup = 10;
  const auto first = static_cast<std::uint64_t>(p.folds.first_seed);
  const auto end = first + static_cast<std::uint64_t>(p.folds.count);
  for (std::uint64_t from = first; from < end; from += kGroup) {
    const std::uint64_t to = std::min(end, from + kGroup);
    const std::string name = "seeds " + std::to_string(from) + " to " + std::to_string(to - 1);
    cases.push_back({"folds", name, [=](const std::vector<SimulatorVariant>& variants) {
                       return random_folds(variants[0], name, *task, p.folds, from, to);
                     }});
  }
  for (std::uint64_t seed = first; seed < first + static_cast<std::uint64_t>(p.folds.paired); ++seed) {
    const std::string name = "seed " + std::to_string(seed);
    cases.push_back({"paired folds", name, [=](const std::vector<SimulatorVariant>& variants) {
                       return paired_fold(variants, name, *task, p.folds, seed);
                     }});
  }
  // The settled shape of the default fold.
  const auto settled = [task, horizon = p.folds.horizon](const SimulatorVariant& variant, const MaterialProperties& q) {
    const auto simulator = variant.make();
    return simulate_fold(*simulator, *task, q, task->trajectory->default_controls(horizon)).shapes.back();
  };
  for (Index k = 0; k < static_cast<Index>(kPropertyNames.size()); ++k) {
    const std::string name = std::string(kPropertyNames[static_cast<std::size_t>(k)]) + " from 0 to 1";
    cases.push_back({"properties", name, [=](const std::vector<SimulatorVariant>& variants) {
                       MaterialProperties low = MaterialProperties::Constant(0.5), high = low;
                       low[k] = 0.0, high[k] = 1.0;
                       const double moved = mean_distance_mm(settled(variants[0], low), settled(variants[0], high));
                       return std::vector<PhysicsRow>{row("properties", variants[0], name, "settled shape moves mm",
                                                          1.0, moved, 1.0 / moved, 1.0, "at least the reference")};
                     }});
  }
  // A chaotic fold would move by millimetres.
  const std::string name = "friction + 0.001";
  cases.push_back({"properties", name, [=](const std::vector<SimulatorVariant>& variants) {
                     const PropertyRange& friction = task->material.ranges[0];
                     MaterialProperties a = MaterialProperties::Constant(0.5), b = a;
                     b[0] = friction.inverse(friction.at(0.5) + 0.001);
                     const double moved = mean_distance_mm(settled(variants[0], a), settled(variants[0], b));
                     return std::vector<PhysicsRow>{
                         row("properties", variants[0], name, "settled shape moves mm", 0.0, moved, moved, 0.2)};
                   }});
}

}  // namespace weft::physics
