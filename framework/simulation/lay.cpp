#include "simulation/lay.hpp"

#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "meshes/intersections.hpp"
#include "weft/rest_shape.hpp"

namespace weft {
namespace {

const Positions kNoHands(0, 3);

/// Open boundaries of the mesh: edges of one face, joined at their vertices.
Index boundary_loops(const Faces& faces, Index vertices) {
  std::vector<std::pair<int, int>> sides;
  for (Index f = 0; f < faces.rows(); ++f)
    for (int k = 0; k < 3; ++k) sides.emplace_back(std::minmax(faces(f, k), faces(f, (k + 1) % 3)));
  std::sort(sides.begin(), sides.end());
  std::vector<int> parent(static_cast<std::size_t>(vertices), -1);
  const auto root = [&](int v) {
    while (parent[static_cast<std::size_t>(v)] != v) v = parent[static_cast<std::size_t>(v)];
    return v;
  };
  for (std::size_t i = 0; i < sides.size(); ++i) {
    const bool twice = (i + 1 < sides.size() && sides[i + 1] == sides[i]) || (i > 0 && sides[i - 1] == sides[i]);
    if (twice) continue;
    auto [a, b] = sides[i];
    for (const int v : {a, b})
      if (parent[static_cast<std::size_t>(v)] < 0) parent[static_cast<std::size_t>(v)] = v;
    a = root(a), b = root(b);
    parent[static_cast<std::size_t>(std::max(a, b))] = std::min(a, b);
  }
  Index loops = 0;
  for (int v = 0; v < vertices; ++v) loops += parent[static_cast<std::size_t>(v)] == v;
  return loops;
}

}  // namespace

Positions lying_pose(const Garment& garment) {
  const Positions& x = garment.positions;
  const Eigen::RowVector3d centre = x.colwise().mean();
  const Positions from_centre = x.rowwise() - centre;
  const Eigen::Matrix3d spread = from_centre.transpose() * from_centre;
  Eigen::Matrix3d turn = Eigen::Matrix3d::Identity();  // rows: the new axes
  if (boundary_loops(garment.faces, x.rows()) == 1) {
    // A sheet: the direction in which it is least extended becomes the vertical.
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> axes(spread);
    Eigen::Vector3d normal = axes.eigenvectors().col(0);
    if (normal.z() < 0.0) normal = -normal;
    turn = Eigen::Quaterniond::FromTwoVectors(normal, Eigen::Vector3d::UnitZ()).toRotationMatrix();
  } else {
    // A garment that stands: its thinner horizontal direction becomes the vertical, up becomes y.
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d> axes(Eigen::Matrix2d(spread.topLeftCorner<2, 2>()));
    Eigen::Vector2d wide = axes.eigenvectors().col(1);
    if (wide.x() < 0.0 || (wide.x() == 0.0 && wide.y() < 0.0)) wide = -wide;
    turn.row(0) << wide.x(), wide.y(), 0.0;
    turn.row(1) << 0.0, 0.0, 1.0;
    turn.row(2) << wide.y(), -wide.x(), 0.0;
  }
  return from_centre * turn.transpose();
}

LaidGarment lay_garment(const Garment& garment, Simulator& simulator, const LayParams& params) {
  LaidGarment result;
  result.crossings_before = count_intersections(garment.positions, garment.faces);
  Fabric fabric;
  fabric.name = "laid";
  fabric.density_kg_per_m2 = params.density_kg_per_m2;
  fabric.stretch_warp_n_per_m = fabric.stretch_weft_n_per_m = params.stretch_n_per_m;
  fabric.stretch_shear_n_per_m = 0.5 * params.stretch_n_per_m;
  fabric.poisson = 0.0;
  fabric.bend_warp_n_m = fabric.bend_weft_n_m = fabric.bend_bias_n_m = params.bend_n_m;
  fabric.friction = fabric.self_friction = 0.0;  // wrinkles slide out
  fabric.thickness_m = params.thickness_m;
  fabric.damping_bend_s = 0.015;
  fabric.damping_air_per_s = params.air_per_s;

  auto start = std::make_shared<Garment>(garment);
  start->positions = lying_pose(garment);
  start->positions.col(2).array() += params.thickness_m - start->positions.col(2).minCoeff();
  start->form.layers.clear();
  Positions x = start->positions, v = Positions::Zero(x.rows(), 3);
  const auto frames = [](double seconds) { return static_cast<Index>(std::ceil(seconds / kFrameSeconds)); };
  const auto run = [&](double gravity, Index most, bool until_calm) {
    Scene scene;
    scene.gravity *= gravity;
    simulator.reset(start, fabric, scene);
    simulator.set_state(x, v, {});
    Index calm = 0;
    for (Index k = 0; k < most && calm < 12; ++k) {
      simulator.step(kNoHands);
      ++result.frames;
      calm = until_calm && simulator.velocities().rowwise().norm().maxCoeff() < 0.01 ? calm + 1 : 0;
    }
    x = simulator.positions();
    v = simulator.velocities();
  };
  run(1.0, frames(params.fall_s), true);
  run(params.press, frames(params.press_s), false);
  Scene scene;
  simulator.reset(start, fabric, scene);
  simulator.set_state(x, Positions::Zero(x.rows(), 3), {});
  SettleCriterion criterion;
  criterion.max_frames = frames(params.fall_s);
  const SettleResult rest = simulator.settle(criterion);
  result.frames += rest.frames;
  result.settled = rest.settled;
  x = simulator.positions();
  result.largest_strain = simulator.diagnostics().max_strain;

  const Eigen::RowVector2d low = x.leftCols<2>().colwise().minCoeff(), high = x.leftCols<2>().colwise().maxCoeff();
  x.leftCols<2>().rowwise() -= 0.5 * (low + high);
  // Whole micrometres and thousandths of a thickness keep the files short; a layer within a thousandth is on the table.
  result.positions = (x.array() * 1e6).round() / 1e6;
  for (Index i = 0; i < x.rows(); ++i) {
    const double layer = std::max(0.0, std::round((x(i, 2) / params.thickness_m - 1.0) * 1e3) / 1e3);
    result.layers.push_back(layer <= 0.01 ? 0.0 : layer);
    result.positions(i, 2) = std::round((1.0 + result.layers.back()) * params.thickness_m * 1e7) / 1e7;
  }
  result.height = result.positions.col(2).maxCoeff();
  result.crossings = count_intersections(result.positions, garment.faces);
  start->positions = result.positions;
  result.median_strain = median_strain(*start);
  return result;
}

}  // namespace weft
