#include "loss.hpp"

#include <cmath>

namespace weft::emd {
namespace {

/// Terms that the loss and its gradient share, all [wanted, coordinates].
struct Residuals {
  Sigma sigma;
  Tensor difference;  ///< mu - x
  Tensor r, square;   ///< difference / sigma, and its square

  Residuals(const Passes& passes, const Graph::Output& out, const Batch& batch)
      : sigma(sigma_of(passes.model(), out.log_sigma.detach())),
        difference(out.mean.detach() - passes.target(batch)),
        r(difference / sigma.value),
        square(r * r) {}
  double loss_sum() const {
    const Tensor terms = at::mean(square * 0.5 + at::log(sigma.value), 1).contiguous();
    const auto* values = terms.data_ptr<float>();
    double sum = 0.0;
    for (Index w = 0; w < terms.size(0); ++w) sum += values[w];
    return sum;
  }
};

}  // namespace

LossGradient loss_gradient(const std::vector<float>& mean, const std::vector<float>& sigma, const Batch& batch,
                           Index coordinates, double total, double beta) {
  const std::size_t shapes = batch.wanted.size(), n = mean.size() / shapes;
  const auto scale = static_cast<float>(1.0 / (total * static_cast<double>(n)));
  LossGradient gradient;
  gradient.d_mean.resize(mean.size());
  gradient.d_sigma.resize(mean.size());
  for (std::size_t w = 0; w < shapes; ++w) {
    const float* target = batch.target.data() + w * coordinates;
    double sum = 0.0;
    for (std::size_t c = 0; c < n; ++c) {
      const std::size_t i = w * n + c;
      const float x = target[batch.columns.empty() ? c : batch.columns[c]];
      const float s = sigma[i], r = (mean[i] - x) / s;
      sum += static_cast<double>(0.5f * r * r + std::log(s));
      const float weight = (beta > 0 ? scale * std::pow(s, 2.0f * static_cast<float>(beta)) : scale) / s;
      gradient.d_mean[i] = r * weight;
      gradient.d_sigma[i] = (1.0f - r * r) * weight;
    }
    gradient.sum += sum / static_cast<double>(n);
  }
  return gradient;
}

ShapeErrors shape_errors(const Passes& passes, const Graph::Output& out, const Batch& batch) {
  const at::NoGradGuard guard;
  const Residuals residuals(passes, out, batch);
  ShapeErrors errors;
  errors.loss_sum = residuals.loss_sum();
  const Index shapes = out.mean.size(0), n = out.mean.size(1);
  const Tensor distance =
      at::mean(at::sqrt(at::sum(at::square(residuals.difference.reshape({shapes, n / 3, 3})), 2)), 1).contiguous();
  const auto* values = distance.data_ptr<float>();
  for (Index w = 0; w < shapes; ++w) errors.distance_mm.push_back(static_cast<double>(values[w]) * kLength * 1e3);
  return errors;
}

}  // namespace weft::emd
