#include "unit/toy_trajectory.hpp"

namespace {

struct Params {
  std::string code = "auto";
  template <class Visitor>
  void visit(Visitor& v) {
    v("code", code, weft::choice({"auto", "narrow", "wide", "widest"}), "Numeric variant.",
      weft::NumericVariant{{"narrow", "wide"}});
  }
};

/// A trajectory with numeric variants, of which this machine has two.
class Varied final : public weft::test::ToyTrajectory {
 public:
  explicit Varied(const Params&) {}
};

}  // namespace

WEFT_PLUGIN(weft::Trajectory, Varied, Params, "varied", "1.0.0")
