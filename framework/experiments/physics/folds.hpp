#pragma once
#include <memory>
#include <vector>

#include "experiments/physics/physics.hpp"

/// Tests of folded cloth. Each adds its cases; those that need a task are left out without one.
namespace weft::physics {

/// crease: height of a heavy folded strip; garment crease: that of the task's default fold.
void add_crease(std::vector<PhysicsCase>& cases, const PhysicsParams& params, const std::shared_ptr<const Task>& task);
/// folds, paired folds: random folds of the task; properties: what its material properties do to the default fold.
void add_folds(std::vector<PhysicsCase>& cases, const PhysicsParams& params, const std::shared_ptr<const Task>& task);

}  // namespace weft::physics
