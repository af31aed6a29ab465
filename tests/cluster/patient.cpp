// The optimiser rprop after a pause, so that the cells of a test last for seconds however fast the machine is.
#include <chrono>
#include <thread>

#include "weft/config.hpp"
#include "weft/host.hpp"
#include "weft/optimiser.hpp"
#include "weft/plugin.hpp"

namespace weft {
namespace {

struct PatientParams {
  double pause_s = 0.5;
  void visit(auto& v) { v("pause_s", pause_s, range(0.0, 60.0, "s"), "Pause before each search."); }
};

class Patient final : public Optimiser {
 public:
  Patient(const PatientParams& params, Host& host)
      : params_(params), inner_(host.create<Optimiser>(ConfigNode::parse("{plugin: rprop}", "patient"))) {}
  OptimiserCapabilities capabilities() const override { return inner_->capabilities(); }
  std::vector<OptimiserResult> minimise(Objective& objective, ConstMatrix starts, const Box& bounds, ConstVec scale,
                                        const OptimiserOptions& options,
                                        const OptimiserObserver& observer) const override {
    std::this_thread::sleep_for(std::chrono::duration<double>(params_.pause_s));
    return inner_->minimise(objective, starts, bounds, scale, options, observer);
  }

 private:
  PatientParams params_;
  std::shared_ptr<const Optimiser> inner_;
};

}  // namespace
}  // namespace weft

WEFT_PLUGIN(weft::Optimiser, weft::Patient, weft::PatientParams, "patient", "1.0.0")
