#include "simulation/lay.hpp"

#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>

#include "sdk/disjoint_sets.hpp"
#include "weft/mesh.hpp"
#include "weft/rest_shape.hpp"

namespace weft {
namespace {

const Positions kNoHands(0, 3);

/// Open boundaries of the mesh: open edges, joined at their vertices.
Index boundary_loops(const Faces& faces, Index vertices) {
  DisjointSets joined(vertices);
  std::vector<bool> is_open(vertices, false);
  const Edges open = open_edges(faces);
  for (Index e = 0; e < open.rows(); ++e) {
    joined.unite(open(e, 0), open(e, 1));
    is_open[open(e, 0)] = is_open[open(e, 1)] = true;
  }
  Index loops = 0;
  for (int v = 0; v < vertices; ++v) loops += is_open[v] && joined.root(v) == v;
  return loops;
}

/// Sheets of cloth below each vertex: faces without it that a line down from it meets.
std::vector<double> layers_below(const Positions& x, const Faces& faces) {
  std::vector<double> layers(x.rows(), 0.0);
  // Faces by cell of a grid over the table, so that each vertex looks at few.
  const Eigen::RowVector2d low = x.leftCols<2>().colwise().minCoeff();
  const double size = (x.leftCols<2>().colwise().maxCoeff() - low).maxCoeff();
  constexpr int kCells = 64;
  const auto cell = [&](double at, int axis) {
    return std::clamp(static_cast<int>((at - low[axis]) / size * kCells), 0, kCells - 1);
  };
  std::vector<std::vector<int>> cells(kCells * kCells);
  for (Index f = 0; f < faces.rows(); ++f) {
    Eigen::RowVector2d least = x.row(faces(f, 0)).head<2>(), most = least;
    for (int k = 1; k < 3; ++k) {
      least = least.cwiseMin(x.row(faces(f, k)).head<2>());
      most = most.cwiseMax(x.row(faces(f, k)).head<2>());
    }
    for (int j = cell(least.y(), 1); j <= cell(most.y(), 1); ++j)
      for (int i = cell(least.x(), 0); i <= cell(most.x(), 0); ++i)
        cells[j * kCells + i].push_back(static_cast<int>(f));
  }
  for (Index v = 0; v < x.rows(); ++v) {
    for (const int f : cells[cell(x(v, 1), 1) * kCells + cell(x(v, 0), 0)]) {
      if (faces(f, 0) == v || faces(f, 1) == v || faces(f, 2) == v) continue;
      const Eigen::RowVector3d a = x.row(faces(f, 0)), u = x.row(faces(f, 1)) - a, w = x.row(faces(f, 2)) - a,
                               p = x.row(v) - a;
      const double det = u.x() * w.y() - u.y() * w.x();
      if (det == 0.0) continue;
      const double s = (p.x() * w.y() - p.y() * w.x()) / det, t = (u.x() * p.y() - u.y() * p.x()) / det;
      if (s >= 0.0 && t >= 0.0 && s + t < 1.0 && s * u.z() + t * w.z() < p.z()) layers[v] += 1.0;
    }
  }
  return layers;
}

}  // namespace

Positions lying_pose(const Garment& garment) {
  const Positions& x = garment.positions;
  const Eigen::RowVector3d centre = x.colwise().mean();
  const Positions from_centre = x.rowwise() - centre;
  const Eigen::Matrix3d spread = from_centre.transpose() * from_centre;
  Eigen::Matrix3d turn = Eigen::Matrix3d::Identity();  // rows: the new axes
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> axes(spread);
  // A sheet with holes, and sheets over each other, have as many boundaries as a tube. But they are thin.
  constexpr double kThin = 0.2;
  const bool thin = axes.eigenvalues()(0) < kThin * kThin * axes.eigenvalues()(1);
  if (thin || boundary_loops(garment.faces, x.rows()) == 1) {
    // A sheet: the direction in which it is least extended becomes the vertical.
    Eigen::Vector3d normal = axes.eigenvectors().col(0);
    if (normal.z() < 0.0) normal = -normal;
    turn = Eigen::Quaterniond::FromTwoVectors(normal, Eigen::Vector3d::UnitZ()).toRotationMatrix();
  } else {
    // A garment that stands: its thinner horizontal direction becomes the vertical, up becomes y.
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d> across(Eigen::Matrix2d(spread.topLeftCorner<2, 2>()));
    Eigen::Vector2d wide = across.eigenvectors().col(1);
    if (wide.x() < 0.0 || (wide.x() == 0.0 && wide.y() < 0.0)) wide = -wide;
    turn.row(0) << wide.x(), wide.y(), 0.0;
    turn.row(1) << 0.0, 0.0, 1.0;
    turn.row(2) << wide.y(), -wide.x(), 0.0;
  }
  return from_centre * turn.transpose();
}

LaidGarment lay_garment(const Garment& garment, Simulator& simulator, const LayParams& params,
                        const Cancelled& cancelled) {
  LaidGarment result;
  const auto drawn = find_intersections(garment.positions, garment.faces, std::numeric_limits<std::size_t>::max());
  result.crossings_before = static_cast<Index>(drawn.size());
  if (!drawn.empty())
    result.crossing_before = *std::max_element(drawn.begin(), drawn.end(), [](const auto& one, const auto& other) {
      return !one.between_pieces && other.between_pieces;
    });
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
      require_not_cancelled(cancelled);
      simulator.step(kNoHands);
      ++result.frames;
      calm = until_calm && simulator.velocities().rowwise().norm().maxCoeff() < 0.01 ? calm + 1 : 0;
    }
    x = simulator.positions();
    v = simulator.velocities();
  };
  run(1.0, frames(params.fall_s), true);
  run(params.load, frames(params.press_s), false);
  Scene scene;
  simulator.reset(start, fabric, scene);
  simulator.set_state(x, Positions::Zero(x.rows(), 3), {});
  SettleCriterion criterion;
  criterion.max_frames = frames(params.fall_s);
  const SettleResult rest = settle(simulator, criterion, cancelled);
  result.frames += rest.frames;
  result.settled = rest.settled;
  x = simulator.positions();
  result.largest_strain = simulator.diagnostics().max_strain;

  const Eigen::RowVector2d low = x.leftCols<2>().colwise().minCoeff(), high = x.leftCols<2>().colwise().maxCoeff();
  x.leftCols<2>().rowwise() -= 0.5 * (low + high);
  // Whole micrometres keep the files short. Heights are those above each vertex's layer, so that any thickness fits.
  result.positions = (x.array() * 1e6).round() / 1e6;
  result.layers = layers_below(result.positions, garment.faces);
  for (Index i = 0; i < x.rows(); ++i) {
    const double above = x(i, 2) - (1.0 + result.layers[i]) * params.thickness_m;
    result.positions(i, 2) = std::max(0.0, std::round(above * 1e6) / 1e6);
  }
  start->positions = result.positions;
  start->form.layers = result.layers;
  result.median_strain = median_strain(*start);
  // As thin and as thick cloths lie.
  for (const double thickness : {0.5 * params.thickness_m, params.thickness_m, 4.0 * params.thickness_m}) {
    const Positions lying = positions_on_ground(*start, 0.0, thickness);
    result.crossings = std::max(result.crossings, count_intersections(lying, garment.faces));
    if (thickness == params.thickness_m) result.height = lying.col(2).maxCoeff();
  }
  return result;
}

}  // namespace weft
