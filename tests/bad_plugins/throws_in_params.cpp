#include <stdexcept>

#include "bad_plugins/bad_plugin.hpp"

namespace {

struct Params {
  template <class Visitor>
  void visit(Visitor&) {
    throw std::logic_error("no list of parameters today");
  }
};

class Toy final : public weft::test::ToyTrajectory {
 public:
  explicit Toy(const Params&) {}
};

}  // namespace

WEFT_PLUGIN(weft::Trajectory, Toy, Params, "throws_in_params", "1.0.0")
