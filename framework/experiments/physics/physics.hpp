#pragma once
#include <functional>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "session/session.hpp"
#include "simulation/random_controls.hpp"
#include "simulation/task_config.hpp"
#include "weft/params.hpp"
#include "weft/simulator.hpp"

/// Parameters, cases and rows of the physics suite.
namespace weft {

/// A simulator with certain settings. The suite makes any number of them, on any thread.
struct SimulatorVariant {
  std::string name;
  std::function<std::shared_ptr<Simulator>()> make;
};

/// One comparison. Lengths in m unless the quantity says otherwise.
struct PhysicsRow {
  std::string test;      ///< "elastica"
  std::string variant;   ///< of the simulator
  std::string name;      ///< the case: mesh, load, ...
  std::string quantity;  ///< of reference and measured
  double reference = 0.0;
  double measured = 0.0;
  double error = 0.0;  ///< as the bound counts it
  double bound = 0.0;
  bool passed = false;  ///< error <= bound
  std::string note;
  /// For random folds: the seed and the measured value of each; `measured` is the worst.
  std::vector<std::pair<std::uint64_t, double>> by_seed;
  double cpu_ms_per_frame = 0.0;  ///< of a paired fold's simulator, in the row of its settled speed; else 0
};

struct PhysicsParams {
  double fine_edge_m = 0.005;
  double garment_edge_m = 0.02;
  double density_kg_per_m2 = 0.15;
  double stretch_n_per_m = 100.0;
  double bend_n_m = 2.0e-5;
  ConfigNode fabric;
  std::vector<std::string> tests;
  /// Random folds of the task. Fold s draws material and controls from seed s alone, so each fold can be replayed.
  struct Folds {
    std::int64_t first_seed = 1;
    std::int64_t count = 200;
    std::int64_t paired = 0;
    std::int64_t horizon = 25;
    double grasp_radius_m = 0.05;
    RandomControlsParams controls;
    template <class Visitor>
    void visit(Visitor& v) {
      v("first_seed", first_seed, range(0, 1000000000), "Seed of the first random fold; the others count up.");
      v("count", count, range(0, 1000000), "Number of random folds.");
      v("paired", paired, range(0, 1000000),
        "Number of random folds, from the same first seed, that two simulators both run (test `paired folds`).");
      v("horizon", horizon, range(1, 1000, "segments"), "Longest path; a path ends at the release.");
      v("grasp_radius_m", grasp_radius_m, range(0, 1, "m"),
        "Faces with a vertex this close to a grasped one, in the rest shape, do not count in the strain, because the "
        "strain under a point load has no limit.");
      v.group("controls", controls, "The distribution of the random paths.");
    }
  } folds;

  template <class Visitor>
  void visit(Visitor& v) {
    v("fine_edge_m", fine_edge_m, range(0.001, 0.1, "m"), "Edge length of the fine meshes.");
    v("garment_edge_m", garment_edge_m, range(0.001, 0.1, "m"),
      "Edge length of the coarse meshes: that of the garments.");
    v("density_kg_per_m2", density_kg_per_m2, range(0.001, 10, "kg/m^2"), "Density of the test fabric.");
    v("stretch_n_per_m", stretch_n_per_m, range(0.1, 1e6, "N/m"), "Membrane stiffness of the test fabric, both ways.");
    v("bend_n_m", bend_n_m, range(1e-9, 1, "N m"), "Bending stiffness of the test fabric, unless the test sets it.");
    v("fabric", fabric, "The fabric of the tests drape, bending length and tensile; default: the test fabric.",
      FileOrMapping{});
    v("tests", tests, "Names of the tests to run; empty: all.");
    v.group("folds", folds, "Random folds over the whole material and control range.");
  }
};

/// configs/experiments/physics.yaml: a task, the same simulator at finer steps, the suite's sizes.
struct PhysicsExperimentParams : SessionParams {
  ConfigNode finer, other;
  PhysicsParams physics;

  template <class Visitor>
  void visit(Visitor& v) {
    SessionParams::visit(v);
    v("finer", finer, PluginSlot{"simulator"}, "The simulator at finer steps, to show the effect of the step.");
    v("other", other, PluginSlot{"simulator"}, "Another simulator, for `paired folds`.");
    v.group("physics", physics, "The physics suite.");
  }
};

/// One case of the suite, independent of the others.
struct PhysicsCase {
  std::string test, name;
  /// @param variants the first is under test. The others have finer steps, for results that must not depend on them.
  std::function<std::vector<PhysicsRow>(const std::vector<SimulatorVariant>& variants)> run;
};
/// "test  case  quantity  reference  measured  error  bound  ok"
std::string format_physics_row(const PhysicsRow& row);

namespace physics {

/// A row that passes if error <= bound.
PhysicsRow row(std::string test, const SimulatorVariant& variant, std::string name, std::string quantity,
               double reference, double measured, double error, double bound, std::string note = "");
/// The same with error = |measured / reference - 1|.
PhysicsRow relative(std::string test, const SimulatorVariant& variant, std::string name, std::string quantity,
                    double reference, double measured, double bound, std::string note = "");
/// printf of one number.
std::string text(const char* format, double value);
/// "20 mm". @param edge m.
std::string mm(double edge);

}  // namespace physics
}  // namespace weft
