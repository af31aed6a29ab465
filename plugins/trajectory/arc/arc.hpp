#pragma once
#include <cstdint>
#include <vector>

#include "weft/params.hpp"
#include "weft/trajectory.hpp"

namespace weft::arc {

/// Bounds and typical sizes of the per-frame deltas. The reasons for the defaults stand in README.md.
struct Params {
  std::int64_t hands = 2;
  double dtheta_min_deg = 0.5;
  double dtheta_max_deg = 4.0;
  double dr_max_m = 0.0025;
  double dphi_max_deg = 1.0;
  double da_max_m = 0.0025;
  double dtheta_scale_deg = 0.5;
  double dr_scale_m = 0.0005;
  double dphi_scale_deg = 0.2;
  double da_scale_m = 0.0005;
  double r_min_m = 0.01;

  template <class Visitor>
  void visit(Visitor& v) {
    v("hands", hands, range(1, 2), "Hands that move along it.");
    v("dtheta_min_deg", dtheta_min_deg, range(0.0, 2.0, "deg/frame"), "Least turn per frame; above 0 every path ends.");
    v("dtheta_max_deg", dtheta_max_deg, range(2.0, 45.0, "deg/frame"), "Largest turn per frame.");
    v("dr_max_m", dr_max_m, range(0.0, 0.1, "m/frame"), "Largest change of the radius per frame, either way.");
    v("dphi_max_deg", dphi_max_deg, range(0.0, 45.0, "deg/frame"),
      "Largest change of the heading per frame, either way.");
    v("da_max_m", da_max_m, range(0.0, 0.1, "m/frame"),
      "Largest change of the axis point per frame, each axis, either way.");
    v("dtheta_scale_deg", dtheta_scale_deg, range(1e-6, 45.0, "deg/frame"), "Typical change of dtheta.");
    v("dr_scale_m", dr_scale_m, range(1e-9, 0.1, "m/frame"), "Typical change of dr.");
    v("dphi_scale_deg", dphi_scale_deg, range(1e-6, 45.0, "deg/frame"), "Typical change of dphi.");
    v("da_scale_m", da_scale_m, range(1e-9, 0.1, "m/frame"), "Typical change of dax and day.");
    v("r_min_m", r_min_m, range(1e-6, 1.0, "m"), "The radius never falls below it.");
  }
};

/// The paper's trajectory (section 2.1, fig. 2): a turn of the grasp points about a horizontal axis T at the surface,
/// plus a lift that grows to the drop height h. One hand moves as
/// the midpoint of two would.
///
/// State: theta deg (not clamped), r m (>= r_min), phi deg, ax m, ay m (absolute, XY). Control: their deltas per frame.
///     c_0 = midpoint of the grasp points in XY;  a_0 = c_0 + d/2;  r_0 = |d|/2;  theta_0 = phi_0 = 0
///     d' = d/|d| turned by phi about z;  T = z x d';  u_i = delta_i - r;  t = clamp(theta, 0, 180 deg)
///     g_i = (a, 0) + cos(t) u_i d' + eps_i T + [-sin(t) u_i + (h/2)(1 - cos(t))] z,  z >= contact height
/// c_0: the midpoint of the grasp points. delta_i, eps_i: offsets of grasp point i from c_0 along d and z x d at the start.
/// At theta = 180 deg the grasp points are mirrored across the line through a along T, at height h.
/// Derivatives are exact. Beyond a clamp they are 0; on it they are those of the inside.
class Arc final : public Trajectory {
 public:
  explicit Arc(const Params& params) : p_(params) {}

  std::vector<Variable> controls() const override;
  std::vector<Variable> state() const override;
  Index hands() const override { return p_.hands; }
  Vector initial_state(const Manipulation& manipulation) const override;
  Vector advance(const Manipulation& manipulation, ConstVec state, ConstVec control) const override;
  Positions targets(const Manipulation& manipulation, ConstVec state) const override;
  void advance_pullback(const Manipulation& manipulation, ConstVec state, ConstVec control, ConstVec d_next,
                        Vector& d_state, Vector& d_control) const override;
  Vector targets_pullback(const Manipulation& manipulation, ConstVec state, const Positions& d_targets) const override;
  double progress(ConstVec state) const override;

 private:
  Params p_;
};

}  // namespace weft::arc
