#include "weft/simulator.hpp"

#include <cmath>
#include <cstdio>

namespace weft {

std::shared_ptr<const SimulatorSnapshot> Simulator::save() const {
  throw Unsupported("this simulator has no snapshots (capability snapshots)");
}
void Simulator::restore(const SimulatorSnapshot&) {
  throw Unsupported("this simulator has no snapshots (capability snapshots)");
}

void check_reset(const std::string& plugin, const Garment* garment, const Fabric& fabric, const Scene& scene,
                 bool self_contact) {
  if (!garment || garment->vertex_count() < 3 || garment->face_count() < 1)
    throw ConfigError(plugin + ": garment has no faces, must be a triangle mesh");
  const auto require = [&](bool good, const char* what, double got, const char* wanted) {
    if (!good) throw ConfigError(plugin + ": fabric." + what + " = " + std::to_string(got) + ", must be " + wanted);
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
  if (self_contact) positive("thickness_m", fabric.thickness_m);
  not_negative("damping.stretch_s", fabric.damping_stretch_s);
  not_negative("damping.bend_s", fabric.damping_bend_s);
  not_negative("damping.air_per_s", fabric.damping_air_per_s);
  if (!scene.gravity.allFinite()) throw ConfigError(plugin + ": scene.gravity is not finite");
  if (!scene.initial_velocity.allFinite()) throw ConfigError(plugin + ": scene.initial_velocity is not finite");
  if (scene.ground_height && !std::isfinite(*scene.ground_height))
    throw ConfigError(plugin + ": scene.ground_height is not finite");
  const Index n = garment->vertex_count();
  for (const Index pin : scene.pins)
    if (pin < 0 || pin >= n)
      throw ConfigError(plugin + ": scene.pins holds " + std::to_string(pin) + ", must be in [0, " +
                        std::to_string(n - 1) + "]");
}

std::string grasp_strain_warning(double largest_strain, double limit) {
  if (!(largest_strain > limit)) return {};
  char text[120];
  std::snprintf(text, sizeof(text), "a grasp stretched the cloth by %.1f %%, more than grasp_strain_warning = %g %%",
                100.0 * largest_strain, 100.0 * limit);
  return text;
}

}  // namespace weft
