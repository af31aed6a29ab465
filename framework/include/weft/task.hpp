#pragma once
#include <memory>

#include "weft/config.hpp"
#include "weft/garment.hpp"
#include "weft/material.hpp"
#include "weft/simulator.hpp"
#include "weft/trajectory.hpp"
#include "weft/types.hpp"

namespace weft {

/// All that is fixed during a manipulation session. Every predictor knows it.
struct Task {
  std::shared_ptr<const Garment> garment;
  MaterialSpace material;
  Manipulation manipulation;
  std::shared_ptr<const Trajectory> trajectory;
  Scene scene;
  SettleCriterion settle;
  ConfigNode simulator;  ///< {plugin, params} of the session's simulator, for predictors that simulate
};

}  // namespace weft
