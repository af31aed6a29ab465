#pragma once
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <string>
#include <vector>

#include "params.hpp"
#include "weft/dataset.hpp"
#include "weft/task.hpp"

namespace weft::emd {

/// Unit of all lengths inside the network, m.
inline constexpr float kLength = 0.1f;
/// Scales the velocity input, a change of shape per segment, to the size of the shape input.
inline constexpr float kVelocityGain = 3.0f;
/// Largest exponent of sigma's logarithm inside the network: e^3 kLength = 2 m.
inline constexpr float kLargestLogSigma = 3.0f;

struct Dimensions {
  Index vertices = 0, controls = 0, states = 0, hands = 0;
  Index coordinates() const { return 3 * vertices; }
  /// Control and knowledge inputs of one segment: controls, state before and after it, grasp targets before and after
  /// it, whether the cloth is released at its end, centre, width.
  Index inputs() const { return controls + 2 * states + 6 * hands + 1 + 8; }
  Index released_input() const { return controls + 2 * states + 6 * hands; }
  Index centre_input() const { return released_input() + 1; }
  Index width_input() const { return centre_input() + 4; }
};

/// One matrix [rows, columns], row-major, or a vector (rows = 1), within the flat array of weights. Products are x W.
struct Weight {
  std::string name;
  Index rows = 0, columns = 0;
  std::size_t offset = 0;
  std::size_t size() const { return rows * columns; }
};

/// Places of the weights within the flat array. y: start shape; v: change since the previous shape; u: inputs of a
/// segment; z: latent state, latent + memory long; f: activation; N: normalisation of the latent state.
///   encoder   e   = f(y Wy + v Wv + b)
///             z_0 = N([PCA of y, 0] + e W + b)
///   module    h_1 = f(z Wz + u Wu + b)
///             h_l = f(h_{l-1} Wh + u Wu + b) + h_{l-skip}
///             z  <- N(z + h_last W + u Wu + b)
///   decoder   g     = f(z W + b)
///             mean  = y + PCA^T (z - z_0) + (g - g_0) Wm      differential_decoding; else PCA^T z + g Wm + bm
///             sigma = floor + exp(g Ws + bs)
struct Layout {
  struct Layer {
    int h = -1, u = -1, b = -1;  ///< indices into `weights`; u = -1: this layer sees no inputs
  };
  std::vector<Weight> weights;
  int encoder_shape, encoder_velocity = -1, encoder_bias, encoder_out, encoder_out_bias;
  std::vector<Layer> layers;
  Layer out;
  int decoder_in, decoder_bias, mean, mean_bias, sigma, sigma_bias;
  std::size_t size = 0;  ///< of the flat array

  Layout(const Architecture& architecture, const Dimensions& dimensions);
};

/// Everything a model file holds.
struct Model {
  Architecture architecture;
  Dimensions dimensions;
  std::vector<float> weights;               ///< Layout::size
  std::vector<float> mean;                  ///< [coordinates], units of kLength
  std::vector<float> basis;                 ///< [coordinates, latent], orthonormal columns; empty unless needs_basis()
  std::vector<float> scale;                 ///< [latent]: latent = (PCA coefficient) / scale
  std::vector<float> input_mean, input_sd;  ///< [inputs]
  /// [2, 2, steps]: factors on sigma, from the start of a session or from within one, with exact knowledge or with
  /// none, after j segments. The last factor also serves all longer predictions.
  std::vector<float> calibration;
  /// The same shape, or empty for none: lengths in units of kLength, added to sigma in quadrature before the factor.
  std::vector<float> calibration_added;

  // What it was trained for.
  std::string garment_name;
  std::uint64_t garment_hash = 0;
  std::vector<std::string> control_names, state_names;
  std::vector<double> control_low, control_high;  ///< seen in training, [controls]
  std::vector<std::int64_t> grasp_vertices;
  std::vector<double> initial_state, initial_targets;  ///< [states], [3 hands]
  double drop_height = 0.0, contact_height = 0.0;
  std::vector<double> displacement;           ///< [2]
  std::vector<double> opens_at;               ///< [hands], or empty: all hands open at the release
  std::string material;                       ///< material space, YAML
  std::string dataset, provenance, training;  ///< identity of the data; versions and commit; training.json
  std::vector<DatasetOrigin> datasets;        ///< training data; empty: the file is older than this record
  std::vector<DatasetOrigin> calibrated;      ///< data of the last calibrate(); empty: the calibration is the fit's own

  bool needs_basis() const { return architecture.pca_skip || architecture.previous_shape; }
  Index latent_size() const { return architecture.latent + architecture.memory; }
  /// Calibration of sigma, all in m:  sigma' = factor sqrt(sigma^2 + added^2).
  struct SigmaCalibration {
    double factor = 1.0, factor_slope = 0.0;  ///< d log(factor) / d (mean width)
    double added = 0.0, added_slope = 0.0;    ///< m, d added / d (mean width)

    double operator()(double sigma) const { return factor * std::sqrt(sigma * sigma + added * added); }
    /// d sigma' / d sigma, from sigma'.
    double by_sigma(double widened) const {
      const double r = widened / factor;
      return factor * std::sqrt(std::max(0.0, r * r - added * added)) / r;
    }
    /// d sigma' / d (mean width), from sigma'.
    double by_width(double widened) const {
      return factor_slope * widened + factor * factor * added * added_slope / widened;
    }
  };
  /// Calibration after `steps` segments. Between exact knowledge and none, log(factor) and `added` are linear in the
  /// mean width.
  SigmaCalibration sigma_calibration(Index steps, bool from_start, double mean_width) const;
  /// Takes names and geometry from a task.
  void describe_task(const Task& task);
  /// @throws ConfigError saying which of garment, trajectory, manipulation or material space differs, and both sides.
  /// @return a warning, or empty.
  std::string require_task(const Task& task, bool allow_other_fabric) const;
};

/// Initial weights of a fit: normal, scaled to the number of inputs.
void draw_weights(const Layout& layout, std::uint64_t seed, std::vector<float>& weights);
/// A model of random weights for any task. The latent size is at most what the task's garment allows.
Model untrained_model(Architecture architecture, const Task& task, std::uint64_t seed);
/// Joins the words with single spaces.
std::string join(const std::vector<std::string>& words);

}  // namespace weft::emd
