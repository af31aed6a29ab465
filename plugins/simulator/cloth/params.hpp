#pragma once
#include "weft/params.hpp"

namespace weft::cloth {

struct Params {
  std::int64_t min_substeps = 1;
  std::int64_t max_substeps = 4000;
  double step_safety = 0.8;
  double damping_least_step = 0.9;
  double table_bend_damping_s = 0.01;
  double inertia_length_m = 0.0;
  double fine_inertia_length_m = 0.017;
  double fine_stretch_damping_s = 1e-4;
  double fine_bend_damping_s = 1e-3;
  double settle_damping_per_s = 6.0;
  double grasp_strain_warning = 0.15;
  bool self_contact = true;

  template <class Visitor>
  void visit(Visitor& v) {
    v("min_substeps", min_substeps, range(1, 4000),
      "Fewest substeps per 1/60 s frame; the stability bound of mesh and fabric may ask for more.");
    v("max_substeps", max_substeps, range(1, 20000),
      "Most substeps per frame; a fabric that needs more at `step_safety` ends as diverged instead of running "
      "forever.");
    v("step_safety", step_safety, range(0.1, 0.95), "Substep as a part of the explicit stability limit.");
    v("damping_least_step", damping_least_step, range(0.0, 0.95),
      "Stiffness-proportional damping may shorten the substep to this part of the undamped one; stronger damping is "
      "reduced. 0: the fabric's damping in full, however short the substep.");
    v("table_bend_damping_s", table_bend_damping_s, range(0.0, 1.0, "s"),
      "Least stiffness-proportional damping of bending for fabrics with tables, whose files say nothing of it, so that "
      "they come to rest. Meshes that count as fine have fine_bend_damping_s instead.");
    v("inertia_length_m", inertia_length_m, range(0.0, 0.1, "m"),
      "Waves shorter than about four times this length get more inertia, so that finer meshes need no more substeps "
      "(selective mass scaling). Shapes at rest do not depend on it. 0: no added inertia.");
    v("fine_inertia_length_m", fine_inertia_length_m, range(0.0, 0.1, "m"),
      "Replaces inertia_length_m, where it is larger, on meshes with a mean edge below 12 mm, and on those that would need "
      "more than max_substeps. Membranes with waves faster than 60 m/s have more of it, up to twice as much.");
    v("fine_stretch_damping_s", fine_stretch_damping_s, range(0.0, 1.0, "s"),
      "Least stiffness-proportional damping of strain on these meshes, so that waves as short as an edge die out.");
    v("fine_bend_damping_s", fine_bend_damping_s, range(0.0, 1.0, "s"),
      "The same for bending. Both are reduced where damping_least_step asks for it.");
    v("settle_damping_per_s", settle_damping_per_s, range(0.0, 100.0, "1/s"),
      "Air drag added during settle() only, so that a dropped sheet comes to rest in about a second.");
    v("grasp_strain_warning", grasp_strain_warning, range(0.0, 10.0),
      "In-plane strain at a held vertex above which diagnostics() warns.");
    v("self_contact", self_contact, "Whether layers of cloth keep their thickness apart.");
  }
};

}  // namespace weft::cloth
