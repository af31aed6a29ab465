#include "weft/simulator.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <utility>

namespace weft {
namespace {

std::string number(double value) {
  char text[32];
  std::snprintf(text, sizeof(text), "%.6g", value);
  return text;
}

/// A simulator with one stiffness for all directions refuses other fabrics. Their mean would be another fabric.
void check_isotropic(const std::string& plugin, const Fabric& fabric) {
  const std::string reason = ": this simulator has one stiffness for warp and weft (capability orthotropic)";
  if (fabric.tables)
    throw ConfigError(plugin + ": fabric " + fabric.name + " has tables of stiffness, must have constants" + reason);
  const auto require_equal = [&](const std::string& key, double warp, double weft) {
    if (warp == weft) return;
    throw ConfigError(plugin + ": fabric." + key + " = {warp: " + number(warp) + ", weft: " + number(weft) +
                      "} (fabric " + fabric.name + "), must be equal" + reason + "; set both to their mean, " +
                      number(0.5 * (warp + weft)) + ", or take another fabric or simulator");
  };
  require_equal("stretch_n_per_m", fabric.stretch_warp_n_per_m, fabric.stretch_weft_n_per_m);
  require_equal("bend_n_m", fabric.bend_warp_n_m, fabric.bend_weft_n_m);
}

/// The warning that a grasp stretched the cloth by more than the plugin's parameter grasp_strain_warning, or empty.
std::string grasp_strain_warning(double largest_strain, double limit) {
  if (!(largest_strain > limit)) return {};
  char text[120];
  std::snprintf(text, sizeof(text), "a grasp stretched the cloth by %.1f %%, more than grasp_strain_warning = %g %%",
                100.0 * largest_strain, 100.0 * limit);
  return text;
}

void check_obstacle(const std::string& plugin, const Obstacle& o, std::size_t place) {
  const auto refuse = [&](const std::string& what) {
    throw ConfigError(plugin + ": scene.obstacles." + std::to_string(place) + " (" + o.name + "): " + what);
  };
  if (!o.centre.allFinite() || !o.half_size.allFinite() || !o.axes.allFinite() || !std::isfinite(o.rounding))
    refuse("place or size is not finite");
  if (!(o.axes.transpose() * o.axes).isIdentity(1e-9)) refuse("axes are not orthonormal");
  if (o.friction && !(std::isfinite(*o.friction) && *o.friction >= 0.0))
    refuse("friction = " + number(*o.friction) + ", must be at least 0");
  if (o.kind == Obstacle::Kind::half_space) return;
  if (!(o.half_size.minCoeff() > 0.0)) refuse("a size is " + number(o.half_size.minCoeff()) + ", must be above 0");
  if (!(o.rounding >= 0.0 && o.rounding <= o.half_size.minCoeff()))
    refuse("the radius of its edges is " + number(o.rounding) + ", must be in [0, " + number(o.half_size.minCoeff()) +
           "], half of its smallest size");
}

bool contains(std::span<const Index> list, Index value) {
  return std::find(list.begin(), list.end(), value) != list.end();
}

}  // namespace

std::shared_ptr<const SimulatorSnapshot> Simulator::save() const {
  throw Unsupported("this simulator has no snapshots (capability snapshots)");
}
void Simulator::restore(const SimulatorSnapshot&) {
  throw Unsupported("this simulator has no snapshots (capability snapshots)");
}

void check_reset(const std::string& plugin, const Garment* garment, const Fabric& fabric, const Scene& scene,
                 const SimulatorCapabilities& capabilities) {
  if (!garment || garment->vertex_count() < 3 || garment->face_count() < 1)
    throw ConfigError(plugin + ": garment has no faces, must be a triangle mesh");
  const auto require = [&](bool good, const char* what, double got, const char* wanted) {
    if (!good) throw ConfigError(plugin + ": fabric." + what + " = " + number(got) + ", must be " + wanted);
  };
  const auto positive = [&](const char* what, double v) { require(std::isfinite(v) && v > 0.0, what, v, "above 0"); };
  const auto not_negative = [&](const char* what, double v) {
    require(std::isfinite(v) && v >= 0.0, what, v, "at least 0");
  };
  positive("density_kg_per_m2", fabric.density_kg_per_m2);
  if (!fabric.tables) {
    positive("stretch_n_per_m.warp", fabric.stretch_warp_n_per_m);
    positive("stretch_n_per_m.weft", fabric.stretch_weft_n_per_m);
    not_negative("stretch_n_per_m.shear", fabric.stretch_shear_n_per_m);
    not_negative("bend_n_m.warp", fabric.bend_warp_n_m);
    not_negative("bend_n_m.weft", fabric.bend_weft_n_m);
    not_negative("bend_n_m.bias", fabric.bend_bias_n_m);
  } else {
    positive("stretch_multiplier", fabric.stretch_multiplier);
    not_negative("bend_multiplier", fabric.bend_multiplier);
  }
  not_negative("friction", fabric.friction);
  not_negative("self_friction", fabric.self_friction);
  not_negative("thickness_m", fabric.thickness_m);
  if (capabilities.self_contact) positive("thickness_m", fabric.thickness_m);
  not_negative("damping.stretch_s", fabric.damping_stretch_s);
  not_negative("damping.bend_s", fabric.damping_bend_s);
  not_negative("damping.air_per_s", fabric.damping_air_per_s);
  if (!scene.gravity.allFinite()) throw ConfigError(plugin + ": scene.gravity is not finite");
  if (!scene.initial_velocity.allFinite()) throw ConfigError(plugin + ": scene.initial_velocity is not finite");
  if (scene.ground_height && !std::isfinite(*scene.ground_height))
    throw ConfigError(plugin + ": scene.ground_height is not finite");
  for (std::size_t k = 0; k < scene.obstacles.size(); ++k) check_obstacle(plugin, scene.obstacles[k], k);
  const Index n = garment->vertex_count();
  for (const Index pin : scene.pins)
    if (pin < 0 || pin >= n)
      throw ConfigError(plugin + ": scene.pins holds " + std::to_string(pin) + ", must be in [0, " +
                        std::to_string(n - 1) + "]");
  if (!capabilities.pins && !scene.pins.empty())
    throw ConfigError(plugin + ": scene.pins has vertices, must be empty: this simulator cannot pin (capability pins)");
  if (!capabilities.gravity_any_direction && (scene.gravity.x() != 0.0 || scene.gravity.y() != 0.0))
    throw ConfigError(plugin + ": scene.gravity is not vertical, must be: " +
                      "this simulator supports vertical gravity only (capability gravity_any_direction)");
  if (!capabilities.obstacles && !scene.obstacles.empty())
    throw ConfigError(plugin + ": scene.obstacles has a " + scene.obstacles[0].name +
                      ", must be empty: this simulator knows no obstacles (capability obstacles)");
  if (!capabilities.orthotropic) check_isotropic(plugin, fabric);
  if (!capabilities.rest_frames && (garment->has_frames() || garment->form.seams.rows() > 0))
    throw ConfigError(plugin + ": garment " + garment->name +
                      " has rest frames or seams: this simulator needs one place in the plane for each vertex "
                      "(capability rest_frames)");
}

Positions start_positions(const Garment& garment, const Scene& scene, double thickness) {
  if (scene.obstacles.empty())
    return scene.ground_height ? positions_on_ground(garment, *scene.ground_height, thickness) : garment.positions;
  const bool layers = !garment.form.layers.empty();
  const double floor = scene.ground_height.value_or(-std::numeric_limits<double>::infinity());
  Positions positions = positions_on_ground(garment, layers ? std::max(floor, 0.0) : floor, thickness);
  for (Index v = 0; v < positions.rows(); ++v) {
    if (contains(scene.pins, v)) continue;
    for (const Obstacle& obstacle : scene.obstacles) {
      const ObstacleDistance at = obstacle_distance(obstacle, positions.row(v).transpose());
      if (at.distance < -thickness)
        throw ConfigError("garment " + garment.name + ": vertex " + std::to_string(v) + " starts " +
                          number(-1e3 * at.distance) + " mm inside the obstacle " + obstacle.name +
                          ", must start outside");
      const double lack = (layers ? garment.layer(v) + 1.0 : 1.0) * thickness - at.distance;
      if (lack > 0.0) positions.row(v) += lack * at.normal.transpose();
    }
  }
  return positions;
}

// ---------------------------------------------------------------------------------------------------------------------

struct SimulatorBase::Snapshot final : SimulatorSnapshot {
  std::string simulator;
  std::uint64_t garment = 0;
  Positions positions, velocities;
  std::vector<Index> held;
  Index frame = 0;
  double max_grasp_strain = 0.0;
  std::any history;
};

SimulatorBase::SimulatorBase(std::string name, const Options& options) : name_(std::move(name)), options_(options) {}

void SimulatorBase::require_reset(const char* call) const {
  if (phase_ == Phase::not_reset) throw Error(name_ + ": " + call + "() before reset()");
}

void SimulatorBase::require_running(const char* call) const {
  require_reset(call);
  if (phase_ == Phase::diverged)
    throw Error(name_ + ": " + call + "() after divergence in frame " + std::to_string(frame_ + 1) + ", must be reset");
}

void SimulatorBase::require_free(Index vertex, const char* call) const {
  const Index n = garment_->vertex_count();
  const auto refuse = [&](const std::string& why) {
    throw ShapeError(name_ + ": " + call + ": vertex " + std::to_string(vertex) + " " + why);
  };
  if (vertex < 0 || vertex >= n) refuse("out of range, must be in [0, " + std::to_string(n - 1) + "]");
  if (pinned_[vertex]) refuse("is pinned, must be free");
}

void SimulatorBase::set_held(std::span<const Index> vertices) {
  held_.assign(vertices.begin(), vertices.end());
  std::fill(is_held_.begin(), is_held_.end(), std::uint8_t{0});
  for (const Index vertex : held_) is_held_[vertex] = 1;
  still_.resize(held_.size(), 3);
}

void SimulatorBase::reset(std::shared_ptr<const Garment> garment, const Fabric& fabric, const Scene& scene) {
  check_reset(name_, garment.get(), fabric, scene, capabilities());
  phase_ = Phase::not_reset;
  garment_ = std::move(garment);
  fabric_ = fabric;
  scene_ = scene;
  floor_ = scene.ground_height ? *scene.ground_height + fabric.thickness_m : -std::numeric_limits<double>::infinity();
  const Index n = garment_->vertex_count();
  pinned_.assign(n, 0);
  for (const Index pin : scene_.pins) pinned_[pin] = 1;
  is_held_.assign(n, 0);
  set_held({});
  positions_ = start_positions(*garment_, scene, fabric.thickness_m);
  velocities_ = scene_.initial_velocity.transpose().replicate(n, 1);
  for (Index i = 0; i < n; ++i) {
    if (!pinned_[i]) continue;
    velocities_.row(i).setZero();
    positions_.row(i) = garment_->positions.row(i);
  }
  next_positions_ = positions_;
  next_velocities_ = velocities_;
  frame_ = 0;
  max_grasp_strain_ = 0.0;
  start();
  phase_ = Phase::running;
}

void SimulatorBase::set_state(const Positions& positions, const Positions& velocities, std::span<const Index> grasped) {
  require_reset("set_state");
  const Index n = garment_->vertex_count();
  require_shape(name_ + ": set_state: rows of positions", positions.rows(), n);
  require_shape(name_ + ": set_state: rows of velocities", velocities.rows(), n);
  if (!positions.allFinite() || !velocities.allFinite())
    throw Error(name_ + ": set_state: positions or velocities are not finite");
  for (std::size_t k = 0; k < grasped.size(); ++k) {
    require_free(grasped[k], "set_state");
    if (contains(grasped.first(k), grasped[k]))
      throw ShapeError(name_ + ": set_state: vertex " + std::to_string(grasped[k]) + " is named twice");
  }
  positions_ = positions;
  velocities_ = velocities;
  set_held(grasped);
  for (Index i = 0; i < n; ++i)
    if (is_fixed(i)) velocities_.row(i).setZero();
  phase_ = Phase::running;
  state_changed();
}

void SimulatorBase::grasp(std::span<const Index> vertices) {
  require_running("grasp");
  for (std::size_t k = 0; k < vertices.size(); ++k) {
    require_free(vertices[k], "grasp");
    if (is_held_[vertices[k]] || contains(vertices.first(k), vertices[k]))
      throw ShapeError(name_ + ": grasp: vertex " + std::to_string(vertices[k]) + " is already held");
  }
  std::vector<Index> held = held_;
  held.insert(held.end(), vertices.begin(), vertices.end());
  set_held(held);
  for (const Index vertex : vertices) {
    velocities_.row(vertex).setZero();
    hold_changed(vertex, true);
  }
}

void SimulatorBase::release(std::span<const Index> vertices) {
  require_running("release");
  for (const Index vertex : vertices)
    if (!contains(held_, vertex))
      throw ShapeError(name_ + ": release: vertex " + std::to_string(vertex) + " is not held");
  std::vector<Index> left = held_;
  std::erase_if(left, [&](Index vertex) { return contains(vertices, vertex); });
  set_held(left);
  for (const Index vertex : vertices) {
    velocities_.row(vertex).setZero();
    hold_changed(vertex, false);
  }
}

void SimulatorBase::release() { release(std::vector<Index>(held_)); }

void SimulatorBase::step(const Positions& grasp_targets) {
  require_running("step");
  const Index held = held_.size();
  if (grasp_targets.rows() != held)  // avoids allocating the message in every frame
    require_shape(name_ + ": step: rows of grasp_targets", grasp_targets.rows(), held);
  if (!grasp_targets.allFinite()) throw Error(name_ + ": step: grasp_targets are not finite");
  advance(grasp_targets, 0.0);
}

SettleResult SimulatorBase::settle(const SettleCriterion& criterion) {
  require_running("settle");
  for (std::size_t k = 0; k < held_.size(); ++k) still_.row(k) = positions_.row(held_[k]);
  SettleResult result;
  for (Index calm = 0; result.frames < criterion.max_frames && !result.settled; ++result.frames) {
    advance(still_, options_.settle_drag_per_s);
    calm = max_speed() < criterion.speed ? calm + 1 : 0;
    result.settled = calm >= criterion.hold_frames;
  }
  result.max_speed = max_speed();
  return result;
}

void SimulatorBase::advance(const Positions& targets, double extra_drag) {
  next_positions_ = positions_;
  next_velocities_ = velocities_;
  const auto diverged = [&](const std::string& why) {
    throw Diverged(name_ + ": diverged in frame " + std::to_string(frame_ + 1) + ": " + why);
  };
  phase_ = Phase::diverged;  // reset below if the frame succeeds
  try {
    advance_frame(targets, fabric_.damping_air_per_s + extra_drag, next_positions_, next_velocities_);
  } catch (const Diverged& error) {
    diverged(error.what());
  }
  if (!next_positions_.allFinite() || !next_velocities_.allFinite()) diverged("positions or speeds are not finite");
  phase_ = Phase::running;
  positions_.swap(next_positions_);
  velocities_.swap(next_velocities_);
  ++frame_;
  if (held_.empty()) return;
  const Faces& faces = garment_->faces;
  for (Index f = 0; f < faces.rows(); ++f)
    if (is_held_[faces(f, 0)] | is_held_[faces(f, 1)] | is_held_[faces(f, 2)])
      max_grasp_strain_ = std::max(max_grasp_strain_, face_strain(f));
}

double SimulatorBase::face_strain(Index face) const {
  const auto x = [&](int k) { return positions_.row(garment_->faces(face, k)); };
  const auto r = [&](int k) { return garment_->rest.row(garment_->faces(face, k)); };
  Eigen::RowVector2d u, v;
  if (garment_->has_frames())
    u = garment_->form.frames.row(face).head<2>(), v = garment_->form.frames.row(face).tail<2>();
  else
    u = r(1) - r(0), v = r(2) - r(0);
  const double det = u.x() * v.y() - u.y() * v.x();
  const Eigen::RowVector3d a = x(1) - x(0), b = x(2) - x(0);
  const Eigen::RowVector3d du = (v.y() * a - u.y() * b) / det, dv = (u.x() * b - v.x() * a) / det;
  const double e = du.squaredNorm(), g = dv.squaredNorm(), f = du.dot(dv);
  const double mean = 0.5 * (e + g), part = std::sqrt(0.25 * (e - g) * (e - g) + f * f);
  return std::max(std::abs(std::sqrt(mean + part) - 1.0), std::abs(std::sqrt(std::max(0.0, mean - part)) - 1.0));
}

double SimulatorBase::max_speed() const {
  double square = 0.0;
  for (Index i = 0; i < velocities_.rows(); ++i) {
    const double* v = velocities_.row(i).data();
    square = std::max(square, v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
  }
  return std::sqrt(square);
}

SimulatorDiagnostics SimulatorBase::diagnostics() const {
  require_running("diagnostics");
  SimulatorDiagnostics d;
  d.max_speed = max_speed();
  for (Index f = 0; f < garment_->face_count(); ++f) d.max_strain = std::max(d.max_strain, face_strain(f));
  d.max_grasp_strain = max_grasp_strain_;
  add_diagnostics(d);
  if (const auto warning = grasp_strain_warning(max_grasp_strain_, options_.grasp_strain_warning); !warning.empty())
    d.warning += (d.warning.empty() ? "" : "; ") + warning;
  return d;
}

std::shared_ptr<const SimulatorSnapshot> SimulatorBase::save() const {
  if (!capabilities().snapshots) return Simulator::save();
  require_running("save");
  auto snapshot = std::make_shared<Snapshot>();
  snapshot->simulator = name_;
  snapshot->garment = garment_->hash;
  snapshot->positions = positions_;
  snapshot->velocities = velocities_;
  snapshot->held = held_;
  snapshot->frame = frame_;
  snapshot->max_grasp_strain = max_grasp_strain_;
  snapshot->history = save_history();
  return snapshot;
}

void SimulatorBase::restore(const SimulatorSnapshot& snapshot) {
  if (!capabilities().snapshots) return Simulator::restore(snapshot);
  require_reset("restore");
  const auto* mine = dynamic_cast<const Snapshot*>(&snapshot);
  if (!mine || mine->simulator != name_)
    throw Error(name_ + ": restore: the snapshot was made by another simulator, must be made by " + name_);
  if (mine->garment != garment_->hash || mine->positions.rows() != garment_->vertex_count())
    throw Error(name_ + ": restore: the snapshot is of another garment");
  positions_ = mine->positions;
  velocities_ = mine->velocities;
  set_held(mine->held);
  frame_ = mine->frame;
  max_grasp_strain_ = mine->max_grasp_strain;
  phase_ = Phase::running;
  restore_history(mine->history);
}

}  // namespace weft
