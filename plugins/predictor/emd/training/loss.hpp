#pragma once
// The loss of training and validation: the negative log-likelihood per coordinate, without its constant,
//   (x - mu)^2 / (2 sigma^2) + log sigma,
// as a mean over coordinates.
#include <vector>

#include "passes.hpp"

namespace weft::emd {

struct LossGradient {
  double sum = 0.0;                    ///< loss, summed over the shapes
  std::vector<float> d_mean, d_sigma;  ///< [wanted, columns]: gradients of the mean over `total` shapes
};
/// @param mean, sigma [wanted, columns]: as Network gives them for the batch's columns.
/// @param total shapes that the gradient is the mean over: those of all parts of a batch.
/// @param beta beta-NLL (Seitzer et al. 2022): each term's gradient is weighted by sigma^(2 beta); 0: the likelihood.
LossGradient loss_gradient(const std::vector<float>& mean, const std::vector<float>& sigma, const Batch& batch,
                           Index coordinates, double total, double beta);

struct ShapeErrors {
  double loss_sum = 0.0;            ///< loss, summed over the shapes
  std::vector<double> distance_mm;  ///< [wanted]: mean distance of vertices
};
ShapeErrors shape_errors(const Passes& passes, const Graph::Output& out, const Batch& batch);

}  // namespace weft::emd
