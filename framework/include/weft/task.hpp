#pragma once
#include <limits>
#include <memory>
#include <optional>

#include "weft/config.hpp"
#include "weft/garment.hpp"
#include "weft/hands.hpp"
#include "weft/material.hpp"
#include "weft/simulator.hpp"
#include "weft/trajectory.hpp"
#include "weft/types.hpp"

namespace weft {

/// What the hands can do. It holds for the grasp targets of every executed frame; the hands start at rest.
struct HandLimits {
  static constexpr double kNone = std::numeric_limits<double>::infinity();
  double speed = kNone;                 ///< m/s: the way of a frame divided by its time
  double acceleration = kNone;          ///< m/s^2: the change of that velocity from frame to frame, divided by its time
  double distance = 0.0;                ///< m: least distance of two hands
  Vec3 lower = Vec3::Constant(-kNone);  ///< m: corners of the box that the hands stay in
  Vec3 upper = Vec3::Constant(kNone);
  bool bounds_place() const { return distance > 0.0 || lower.maxCoeff() > -kNone || upper.minCoeff() < kNone; }
  bool any() const { return speed < kNone || acceleration < kNone || bounds_place(); }
};

/// Where the cloth lies at the beginning of a fold that follows another one, at rest. [V, 3] m.
struct StartShape {
  Positions shape;  ///< as planner, predictor and estimator know it
  Positions world;  ///< as it is; world_task() puts it in the place of `shape`
  /// Of the material, from an estimate during the fold before; nullopt: there was none.
  std::optional<MaterialKnowledge> knowledge;
};

/// All that is fixed during a manipulation session. Every predictor knows it.
struct Task {
  std::shared_ptr<const Garment> garment;
  MaterialSpace material;
  Manipulation manipulation;
  std::shared_ptr<const Trajectory> trajectory;
  HandLimits hands;
  std::shared_ptr<const StartShape> start;  ///< null: the flat garment
  Scene scene;
  SettleCriterion settle;
  ConfigNode simulator;  ///< {plugin, params} of the session's simulator, for predictors that simulate

  /// The vertices that are held in a segment that starts at this state [S] of the hands.
  std::vector<Index> held_at(ConstVec state) const {
    return vertices_of(manipulation, trajectory->holding(manipulation, state));
  }
};

}  // namespace weft
