#include <filesystem>
#include <memory>

#include "unit/toy_trajectory.hpp"

namespace {

struct Params {
  weft::ConfigNode inner = weft::ConfigNode::mapping({{"plugin", weft::ConfigNode::quoted("toy")}});
  std::filesystem::path table;
  template <class Visitor>
  void visit(Visitor& v) {
    v("inner", inner, weft::PluginSlot{"trajectory"}, "What is wrapped.");
    v("table", table, "Unused.");
  }
};

/// A plugin that uses another plugin.
class Wrapper final : public weft::test::ToyTrajectory {
 public:
  Wrapper(const Params& params, weft::Host& host) : inner_(host.create<weft::Trajectory>(params.inner)) {}
  double progress(weft::ConstVec state) const override { return 100.0 + inner_->progress(state); }

 private:
  std::shared_ptr<weft::Trajectory> inner_;
};

}  // namespace

WEFT_PLUGIN(weft::Trajectory, Wrapper, Params, "wrapper", "1.0.0")
