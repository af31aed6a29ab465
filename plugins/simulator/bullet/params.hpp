#pragma once
#include "weft/params.hpp"

namespace weft::bullet {

struct Params {
  std::int64_t min_substeps = 16;
  std::int64_t max_substeps = 1000;
  double link_step = 0.5;
  double settle_damping_per_s = 6.0;
  double grasp_strain_warning = 0.15;
  std::int64_t contact_passes = 2;
  bool self_contact = true;

  template <class Visitor>
  void visit(Visitor& v) {
    v("min_substeps", min_substeps, range(1, 4000), "Fewest substeps per 1/60 s frame; `link_step` may ask for more.");
    v("max_substeps", max_substeps, range(1, 20000),
      "Most substeps per frame. A fabric that needs more at `link_step` is softened to what they can carry, and "
      "diagnostics() says so.");
    v("link_step", link_step, range(0.05, 2.0),
      "Largest k dt^2 / m of a link; it sets the substep. With a smaller one the link solver comes closer to the "
      "given stiffness. Struts, which bend the cloth, may have 0.3 of it.");
    v("settle_damping_per_s", settle_damping_per_s, range(0.0, 100.0, "1/s"),
      "Air drag added during settle() only, so that a dropped sheet comes to rest in about a second.");
    v("grasp_strain_warning", grasp_strain_warning, range(0.0, 10.0),
      "In-plane strain at a held vertex above which diagnostics() warns.");
    v("contact_passes", contact_passes, range(1, 50), "Passes over all contacts in a substep.");
    v("self_contact", self_contact, "Whether layers of cloth keep their thickness apart.");
  }
};

}  // namespace weft::bullet
