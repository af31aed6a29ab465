#pragma once
#include <memory>
#include <string>
#include <vector>

#include "metadata.hpp"
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
