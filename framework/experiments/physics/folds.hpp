#pragma once
#include <memory>
#include <vector>

#include "experiments/physics/physics.hpp"

/// Tests of folded cloth. Each function adds its cases. Without a task, cases that need one are left out.
namespace weft::physics {

/// crease: height of a heavy folded strip; garment crease: that of the task's default fold.
void add_crease(std::vector<PhysicsCase>& cases, const PhysicsParams& params, const std::shared_ptr<const Task>& task);
/// folds, paired folds: random folds of the task; properties: effect of its material properties on the default fold.
void add_folds(std::vector<PhysicsCase>& cases, const PhysicsParams& params, const std::shared_ptr<const Task>& task);

}  // namespace weft::physics
