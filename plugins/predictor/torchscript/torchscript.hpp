#pragma once
#include <memory>
#include <string>
#include <vector>

#include "weft/host.hpp"
#include "weft/params.hpp"
#include "weft/predictor.hpp"

namespace weft::torchscript {

struct Params {
  std::filesystem::path module;
  std::filesystem::path metadata;
  std::string other_fabric = "refuse";
  bool batch = true;
  std::int64_t threads = 0;
  template <class Visitor>
  void visit(Visitor& v) {
    v("module", module, "TorchScript file (torch.jit.save).");
    v("metadata", metadata,
      "YAML file of the task that the module was made for; default: the module's name with .yaml.");
    v("other_fabric", other_fabric, choice({"refuse", "warn"}),
      "What to do when the task's material space is not the one of the training data.");
    v("batch", batch,
      "Run cases of one length together, to the end of their controls. False: run them one by one, so that a case "
      "never depends on its batch.");
    v("threads", threads, range(0, 1024), "Threads of libtorch; 0: as many as the program has.");
  }
};

/// The metadata file: the task that the module was made for. It is read like any config.
struct Metadata {
  std::string garment_hash;
  std::vector<std::string> controls, states;
  std::vector<double> grasp_vertices, displacement_m;
  double drop_height_m = 0.05;
  ConfigNode material;
  std::vector<double> control_low, control_high;
  std::int64_t max_segments = 200;
  bool previous = false;
  double length_unit_m = 1.0;
  std::vector<double> control_mean, control_sd, state_mean, state_sd;
  template <class Visitor>
  void visit(Visitor& v) {
    v("garment_hash", garment_hash, "Hash of the garment.");
    v("controls", controls, "Names of the trajectory's controls.");
    v("states", states, "Names of the trajectory's state variables.");
    v("grasp_vertices", grasp_vertices, range(0, 1e9), "Vertices that the hands hold.");
    v("displacement_m", displacement_m, range(-10, 10, "m"), "d, [x, y].");
    v("drop_height_m", drop_height_m, range(0, 1, "m"), "h.");
    v("material", material, "Material space of the training data; without it nothing is compared, and weft warns.");
    v("control_low", control_low, range(-1e9, 1e9),
      "Least value of each control in the training data; plans stay above.");
    v("control_high", control_high, range(-1e9, 1e9), "Largest value of each control in the training data.");
    v("max_segments", max_segments, range(1, 1000, "segments"), "Largest number of segments that the module takes.");
    v("previous", previous, "forward() takes the shape one segment earlier as fifth argument.");
    v("length_unit_m", length_unit_m, range(1e-6, 1e6, "m"), "Unit of all lengths that the module takes and returns.");
    v("control_mean", control_mean, range(-1e9, 1e9), "The module takes (control - control_mean) / control_sd.");
    v("control_sd", control_sd, range(1e-9, 1e9), "One number per control; with control_mean or not at all.");
    v("state_mean", state_mean, range(-1e9, 1e9), "The module takes (state - state_mean) / state_sd.");
    v("state_sd", state_sd, range(1e-9, 1e9), "One number per state variable; with state_mean or not at all.");
  }
};

/// Any exported PyTorch module as predictor:
///     forward(shape [B, V, 3] m, states [B, k + 1, S], controls [B, k, C], knowledge [B, 8][, previous [B, V, 3] m])
///         -> (mean [B, k, V, 3] m, sigma [B, k, V, 3] m), float32; knowledge = centre, width
/// in the metadata's normalisation, if it has one. Derivatives by autograd. Loading a module runs its author's code.
class TorchScriptPredictor final : public Predictor {
 public:
  TorchScriptPredictor(const Params& params, Host& host);
  ~TorchScriptPredictor() override;
  PredictorCapabilities capabilities() const override;
  /// @throws ConfigError when module or metadata do not fit the task, or each other.
  void bind(const Task& task) override;
  std::unique_ptr<Prediction> predict(const std::vector<PredictionCase>& cases,
                                      const PredictionRequest& request) const override;
  std::optional<Box> control_range() const override;
  std::optional<Index> max_segments() const override;
  struct Bound;

 private:
  const Bound& require_bound(const char* call) const;
  /// @throws ConfigError, or warns, when the module's material space is not known to be the task's.
  void check_material(const Metadata& metadata, const std::string& file, const Task& task) const;
  Params params_;
  Host& host_;
  std::shared_ptr<const Bound> bound_;
};

}  // namespace weft::torchscript
