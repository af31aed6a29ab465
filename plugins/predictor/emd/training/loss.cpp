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

LossGradient loss_gradient(const Passes& passes, const Graph::Output& out, const Batch& batch, double total,
                           double beta) {
  const at::NoGradGuard guard;
  const Residuals residuals(passes, out, batch);
  const auto& [e, sigma] = residuals.sigma;
  LossGradient gradient;
  gradient.sum = residuals.loss_sum();
  gradient.d_mean = residuals.r / sigma;
  gradient.d_log_sigma = (1.0 - residuals.square) / sigma * e * (out.log_sigma.detach() < kLargestLogSigma);
  const auto scale = static_cast<float>(1.0 / (total * out.mean.size(1)));
  if (beta > 0) {
    const Tensor weight = at::pow(sigma, 2.0 * beta) * scale;
    gradient.d_mean *= weight;
    gradient.d_log_sigma *= weight;
  } else {
    gradient.d_mean *= scale;
    gradient.d_log_sigma *= scale;
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
