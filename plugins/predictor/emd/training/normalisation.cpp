#include "normalisation.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "../model_file.hpp"
#include "passes.hpp"

namespace weft::emd {
namespace {

/// What one pass over the shapes gives, in the order of the examples. It holds few of them.
struct ShapesSeen {
  std::size_t count = 0;
  std::vector<double> sum;  ///< [width]
  /// At most some 24000, evenly spread over all; of them principal components are made. [rows, width] m.
  std::vector<float> rows;
};

/// @param width coordinates of a shape.
ShapesSeen see_shapes(const Passes& passes, const std::vector<std::size_t>& train, std::size_t width, bool keeps_rows) {
  ShapesSeen seen;
  seen.sum.assign(width, 0.0);
  for (const auto i : train) seen.count += static_cast<std::size_t>(passes.example(i).segments()) + 1;
  const std::size_t stride = std::max<std::size_t>(1, seen.count / 12000);
  if (keeps_rows) seen.rows.reserve((seen.count / stride + 1) * width);
  std::size_t number = 0;
  for (const auto i : train) {
    const auto shapes = passes.shapes(i);
    for (std::size_t s = 0; s + width <= shapes->size(); s += width, ++number) {
      const float* shape = shapes->data() + s;
      for (std::size_t c = 0; c < width; ++c) seen.sum[c] += shape[c];
      if (keeps_rows && number % stride == 0) seen.rows.insert(seen.rows.end(), shape, shape + width);
    }
  }
  return seen;
}

/// @param rows shapes, [m, coordinates] m.
void find_principal_components(std::vector<float> rows, Model& model) {
  const Index n = model.dimensions.coordinates(), latent = model.architecture.latent;
  const std::size_t width = n;
  for (std::size_t k = 0; k < rows.size(); ++k) rows[k] = rows[k] / kLength - model.mean[k % width];
  const Index m = rows.size() / width;
  const Tensor x = view(rows.data(), m, n);
  const Tensor covariance = at::mm(x.t(), x).to(at::kDouble) / static_cast<double>(m);
  rows = {};  // they take more memory than all else here
  const auto [values, vectors] = at::linalg_eigh(covariance);
  model.basis.resize(n * latent);
  model.scale.resize(latent);
  const Tensor columns = vectors.contiguous();
  const auto* v = columns.data_ptr<double>();
  const auto* e = values.data_ptr<double>();  // ascending
  const double largest = std::sqrt(std::max(e[n - 1], 1e-12));
  for (Index j = 0; j < latent; ++j) {
    const Index column = n - 1 - j;
    double peak = 0.0;  // its sign makes the component's sign definite
    for (Index c = 0; c < n; ++c) {
      if (std::abs(v[c * n + column]) > std::abs(peak)) peak = v[c * n + column];
    }
    const double sign = peak < 0 ? -1.0 : 1.0;
    for (Index c = 0; c < n; ++c) model.basis[c * latent + j] = static_cast<float>(sign * v[c * n + column]);
    const double sd = std::max(std::sqrt(std::max(e[column], 0.0)), 1e-3 * largest);
    const double p = model.architecture.whitening;
    model.scale[j] = static_cast<float>(std::pow(largest, 1.0 - p) * std::pow(sd, p));
  }
}

/// Standardises the inputs, and notes the range of the controls.
void find_input_statistics(const Passes& passes, const std::vector<std::size_t>& train, Model& model) {
  const auto& d = model.dimensions;
  const std::size_t u = d.inputs();
  std::vector<double> sum(u, 0.0), squares(u, 0.0), raw(u);
  model.control_low.assign(d.controls, std::numeric_limits<double>::infinity());
  model.control_high.assign(d.controls, -std::numeric_limits<double>::infinity());
  double count = 0;
  for (const auto i : train) {
    const auto& e = passes.example(i);
    for (Index j = 0; j < e.segments(); ++j, ++count) {
      passes.raw_inputs(e, j, {}, raw.data());
      for (std::size_t k = 0; k < u; ++k) {
        sum[k] += raw[k];
        squares[k] += raw[k] * raw[k];
      }
      for (Index k = 0; k < d.controls; ++k) {
        model.control_low[k] = std::min(model.control_low[k], raw[k]);
        model.control_high[k] = std::max(model.control_high[k], raw[k]);
      }
    }
  }
  model.input_mean.resize(u);
  model.input_sd.resize(u);
  for (std::size_t k = 0; k < u; ++k) {
    const double mean = sum[k] / count;
    const double variance = squares[k] / count - mean * mean;
    model.input_mean[k] = static_cast<float>(mean);
    // A variable that never changed gets a huge deviation, so that later changes hardly move the input.
    model.input_sd[k] = variance > 1e-12 * (1e-6 + mean * mean) ? static_cast<float>(std::sqrt(variance)) : 1e3f;
  }
  // Release and knowledge are standardised alike for all data.
  const auto fix = [&](Index at, float mean, float sd) {
    model.input_mean[at] = mean;
    model.input_sd[at] = sd;
  };
  fix(d.released_input(), 0.0f, 0.5f);
  for (Index p = 0; p < 4; ++p) {
    fix(d.centre_input() + p, 0.5f, 0.29f);
    fix(d.width_input() + p, 0.33f, 0.3f);
  }
}

}  // namespace

void find_normalisation(const Passes& passes, const std::vector<std::size_t>& train, bool half_precision,
                        Model& model) {
  const std::size_t width = model.dimensions.coordinates();
  ShapesSeen seen = see_shapes(passes, train, width, model.needs_basis());
  model.mean.resize(width);
  for (std::size_t c = 0; c < width; ++c) model.mean[c] = static_cast<float>(seen.sum[c] / seen.count) / kLength;
  if (model.needs_basis()) {
    find_principal_components(std::move(seen.rows), model);
    if (half_precision) {
      for (float& b : model.basis) b = round_to_half(b);
    }
  }
  find_input_statistics(passes, train, model);
}

}  // namespace weft::emd
