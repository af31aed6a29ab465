#include "weft/plugin.hpp"
#include "weft/predictor.hpp"

using namespace weft;

struct Params {
  double radius_m = 0.2, noise_m = 0.01, spread_m = 0.02;
  template <class Visitor>
  void visit(Visitor& v) {
    v("radius_m", radius_m, range(0.01, 10.0, "m"), "How far a hand takes the cloth along, at medium bending.");
    v("noise_m", noise_m, range(1e-6, 1.0, "m"), "Standard deviation when the fabric is known.");
    v("spread_m", spread_m, range(0.0, 1.0, "m"), "What knowing nothing of the fabric adds to it.");
  }
};

/// Cloth near a hand follows it, the less the farther it is in the rest shape; stiffer cloth follows from farther away.
///     mean_v = x_v + sum_i exp(-r_vi^2 / (2 rho^2)) (g_i(after) - g_i(start)),   rho = radius (1/2 + bend centre),
///     sigma_v = noise + spread * mean(width)
/// It knows no gravity and no contact: a baseline, not a model of cloth.
class Follow final : public Predictor {
 public:
  explicit Follow(const Params& params) : p_(params) {}
  PredictorCapabilities capabilities() const override { return {}; }  // shapes and no gradients
  void bind(const Task& task) override {
    const auto& held = task.manipulation.grasp_vertices;
    const RestPositions& rest = task.garment->rest;
    squares_.resize(rest.rows(), held.size());
    for (std::size_t i = 0; i < held.size(); ++i)
      squares_.col(i) = (rest.rowwise() - rest.row(held[i])).rowwise().squaredNorm();
    task_ = task;
  }
  std::unique_ptr<Prediction> predict(const std::vector<PredictionCase>& cases,
                                      const PredictionRequest& request) const override {
    check_cases("follow", task_, cases);
    std::vector<std::vector<ShapeDistribution>> shapes;
    for (const PredictionCase& c : cases) {
      auto& wanted = shapes.emplace_back();
      const double rho = p_.radius_m * (0.5 + c.knowledge.centre[1]);
      const Matrix weights = (-squares_ / (2.0 * rho * rho)).array().exp();
      const RowMatrix states = task_.trajectory->segment_states(task_.manipulation, c.state, c.controls);
      for (const Index segment : c.segments) {
        auto& [mean, sigma] = wanted.emplace_back();
        mean = *c.shape + weights * (hands(states.row(segment - 1).transpose()) - hands(c.state));
        if (request.moments == Moments::mean_and_sigma)
          sigma.setConstant(mean.rows(), 3, p_.noise_m + p_.spread_m * c.knowledge.width.mean());
      }
    }
    return std::make_unique<PlainPrediction>(std::move(shapes));
  }

 private:
  Positions hands(ConstVec state) const { return task_.trajectory->targets(task_.manipulation, state); }
  Params p_;
  Task task_;
  Matrix squares_;  // [V, hands] m^2: distances in the rest shape
};

WEFT_PLUGIN(weft::Predictor, Follow, Params, "follow", "1.0.0")
