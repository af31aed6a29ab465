#pragma once
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "weft/host.hpp"
#include "weft/params.hpp"
#include "weft/predictor.hpp"

namespace weft::rollout {

struct Params {
  ConfigNode simulator;
  double sigma_m = 0.003;
  std::int64_t samples = 1;
  double step = 0.25;
  std::string difference = "forward";
  double knowledge_step = 0.05;
  std::int64_t difference_settle_frames = 12;
  bool carry_velocity = true;

  template <class Visitor>
  void visit(Visitor& v) {
    v("simulator", simulator, PluginSlot{"simulator"}, "Simulator used as the forward model; default: the task's.");
    v("sigma_m", sigma_m, range(1e-6, 1, "m"), "Declared noise level: least standard deviation of a prediction.");
    v("samples", samples, range(1, 1024),
      "Materials drawn from the knowledge interval; 1: only its middle, and sigma is the noise level.");
    v("step", step, range(1e-4, 10), "Finite-difference step of controls, in units of each control's scale.");
    v("difference", difference, choice({"forward", "central"}),
      "Scheme of the finite differences of controls and knowledge.");
    v("knowledge_step", knowledge_step, range(1e-4, 0.5), "Finite-difference step of centre and width.");
    v("difference_settle_frames", difference_settle_frames, range(0, 100000, "frames"),
      "Frames after the release at which a perturbed run ends and is compared; 0: it settles like the others.");
    v("carry_velocity", carry_velocity, "Start with the mean velocity since the previous shape, if there is one.");
  }
};

/// The simulator itself as forward model, with one simulation per case and material sample, in parallel. Gradients come
/// from finite differences. Perturbed runs keep the material samples (common random numbers). They start from snapshots of the
/// unperturbed run at the start of each segment, so that segments before the perturbation are not simulated again. A perturbed
/// run releases, and opens single hands, in the same segments as the unperturbed one, as in eq. 5, where u is fixed for the
/// gradient. Settling takes longer than the fold itself. So perturbed runs end soon after the release and are compared
/// with the unperturbed run at that moment: shapes are exact, derivatives are those of the shape before it has settled.
class RolloutPredictor final : public Predictor {
 public:
  RolloutPredictor(const Params& params, Host& host);
  PredictorCapabilities capabilities() const override;
  void bind(const Task& task) override;
  std::unique_ptr<Prediction> predict(const std::vector<PredictionCase>& cases,
                                      const PredictionRequest& request) const override;

 private:
  friend class RolloutPrediction;
  struct Run;

  /// Borrows a simulator from the pool for one job.
  class Lease;
  /// Material of one sample of a knowledge interval: c for a single sample, else a fixed low-discrepancy set.
  MaterialProperties material(const MaterialKnowledge& knowledge, Index sample) const;
  /// Puts a simulator at the start of the case, holding the grasp vertices.
  void start(Simulator& simulator, const PredictionCase& one, const MaterialProperties& material) const;

  Params params_;
  Host& host_;
  Task task_;  ///< empty before bind()
  ConfigNode simulator_slot_;
  bool has_snapshots_ = false;
  mutable std::mutex pool_mutex_;
  mutable std::vector<std::shared_ptr<Simulator>> pool_;
};

}  // namespace weft::rollout
