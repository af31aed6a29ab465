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
  bool batch = true;
  std::int64_t threads = 0;
  template <class Visitor>
  void visit(Visitor& v) {
    v("module", module, "TorchScript file (torch.jit.save).");
    v("metadata", metadata, "What it was trained for, YAML; default: the module's name with .yaml.");
    v("batch", batch,
      "Run cases of one length together, to the end of their controls. False: one by one, so that a case never depends "
      "on its batch.");
    v("threads", threads, range(0, 1024), "Threads of libtorch; 0: those of the program.");
  }
};

/// The metadata file: for which task the module is, read like any config.
struct Metadata {
  std::string garment_hash;
  std::vector<std::string> controls, states;
  std::vector<double> grasp_vertices, displacement_m;
  double drop_height_m = 0.05;
  bool previous = false;
  std::int64_t max_segments = 200;
  template <class Visitor>
  void visit(Visitor& v) {
    v("garment_hash", garment_hash, "Hash of the garment.");
    v("controls", controls, "Names of the trajectory's controls.");
    v("states", states, "Names of the trajectory's state variables.");
    v("grasp_vertices", grasp_vertices, range(0, 1e9), "Vertices that the hands hold.");
    v("displacement_m", displacement_m, range(-10, 10, "m"), "d, [x, y].");
    v("drop_height_m", drop_height_m, range(0, 1, "m"), "h.");
    v("previous", previous, "forward() takes the shape one segment earlier as fifth argument.");
    v("max_segments", max_segments, range(1, 1000, "segments"), "Longest controls that the module takes.");
  }
};

/// Any exported PyTorch module as predictor:
///     forward(shape [B, V, 3] m, states [B, k + 1, S], controls [B, k, C], knowledge [B, 8][, previous [B, V, 3] m])
///         -> (mean [B, k, V, 3] m, sigma [B, k, V, 3] m), float32; knowledge = centre, width
/// Derivatives by autograd. Loading a module runs code of whoever made it.
class TorchScriptPredictor final : public Predictor {
 public:
  TorchScriptPredictor(const Params& params, Host& host);
  ~TorchScriptPredictor() override;
  PredictorCapabilities capabilities() const override;
  void bind(const Task& task) override;
  std::unique_ptr<Prediction> predict(const std::vector<PredictionCase>& cases,
                                      const PredictionRequest& request) const override;
  struct Bound;

 private:
  Params params_;
  Host& host_;
  std::shared_ptr<const Bound> bound_;
};

}  // namespace weft::torchscript
