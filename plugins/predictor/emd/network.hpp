#pragma once
#include <numeric>
#include <vector>

#include "kernels/kernels.hpp"
#include "model.hpp"

namespace weft::emd {

/// A few cases that run through the network side by side, row by row. Rows are ordered by descending `steps`.
struct Block {
  struct Wanted {
    Index row = 0;
    Index step = 0;  ///< shape after that many segments, in [1, steps[row]]
  };
  Index rows = 0;
  std::vector<Index> steps;    ///< [rows], descending
  std::vector<float> shape;    ///< [rows, coordinates]: start shapes, normalised
  std::vector<float> change;   ///< [rows, coordinates]: since the previous shape; zeros when there is none
  std::vector<float> inputs;   ///< [total, inputs]: standardised, segment by segment, the rows that still run
  std::vector<Wanted> wanted;  ///< shapes to decode

  /// Rows that have a segment `step` (from 0).
  Index running(Index step) const {
    Index count = 0;
    while (count < rows && steps[count] > step) ++count;
    return count;
  }
  Index total() const { return std::accumulate(steps.begin(), steps.end(), Index{0}); }
};

/// Prediction without a graph: the forward pass keeps a tape, and the pullback and the jvp are written out by hand.
/// Immutable and thread-safe. A row's results do not depend on the other rows.
class Network {
 public:
  explicit Network(const Model& model, const Kernels& kernels);

  struct Tape {
    std::vector<Index> running, offset;         // per segment
    std::vector<std::vector<float>> pre, post;  // per layer: [total, hidden] before and after nonlinearity (and skip)
    std::vector<std::vector<float>> z;          // per segment boundary: [rows, latent_size], normalised
    std::vector<std::vector<float>> norm;       // per segment boundary: [rows], factor of the normalisation
    std::vector<float> encoder_pre;             // [rows, encoder_hidden]
    std::vector<float> decoder_pre;             // [wanted, decoder_hidden]
    std::vector<float> start_pre;               // [rows, decoder_hidden], differential decoding
    std::vector<float> sigma_exp;               // [wanted, coordinates]: e^s, 0 where s is at its upper end
  };

  /// @param mean, sigma [wanted, coordinates], normalised; sigma may be null.
  void forward(const Block& block, Tape& tape, float* mean, float* sigma) const;
  /// @param d_mean, d_sigma [wanted, coordinates], either may be null.
  /// @param d_inputs [total, inputs], overwritten.
  /// @param d_shape, d_change [rows, coordinates], overwritten; if both are null, the encoder's pullback is skipped.
  void pullback(const Block& block, const Tape& tape, const float* d_mean, const float* d_sigma, float* d_inputs,
                float* d_shape, float* d_change) const;
  /// Derivatives of mean and sigma along directions in the inputs. Direction t belongs to row `rows[t]`, ascending.
  /// @param d_inputs [sum of steps of the directions, inputs], segment by segment as Block::inputs.
  /// @param d_mean, d_sigma [directions' wanted shapes, coordinates]: for each direction in turn, the wanted shapes of
  /// its row in order; d_sigma may be null.
  void jvp(const Block& block, const Tape& tape, const std::vector<Index>& rows, const float* d_inputs, float* d_mean,
           float* d_sigma) const;

 private:
  // forward(), in three steps: shapes to latent states, segment by segment, latent states to the wanted shapes.
  void encode(const Block& block, Tape& tape) const;
  void advance(const Block& block, Tape& tape) const;
  void decode(const Block& block, Tape& tape, float* mean, float* sigma) const;
  // The pullbacks of these steps. dz: cotangents of tape.z; dz[0] is that of the encoder's output.
  /// Adds to dz and d_shape. If d_shape is null, the part that reaches the encoder is skipped.
  void decode_pullback(const Block& block, const Tape& tape, const float* d_mean, const float* d_sigma,
                       std::vector<std::vector<float>>& dz, float* d_shape) const;
  /// @param to_start whether dz[0] is wanted.
  void advance_pullback(const Block& block, const Tape& tape, std::vector<std::vector<float>>& dz, float* d_inputs,
                        bool to_start) const;
  /// @param g dz[0]; overwritten. Adds to d_shape, overwrites d_change.
  void encode_pullback(const Block& block, const Tape& tape, float* g, float* d_shape, float* d_change) const;

  /// A matrix B, packed for the products A B and A B^T.
  struct Packed {
    Index k = 0, n = 0;
    std::vector<float> forward, backward;
  };
  Packed pack(const float* data, Index k, Index n) const;
  Packed pack(int weight) const;
  const float* bias(int weight) const { return weights_.data() + layout_.weights[weight].offset; }
  /// C [m, n] (+)= A [m, k] B.
  void times(const Packed& b, Index m, const float* a, Index lda, float* c, Index ldc, const float* start,
             bool accumulate) const;
  /// C [m, k] (+)= A [m, n] B^T.
  void times_transposed(const Packed& b, Index m, const float* a, Index lda, float* c, Index ldc,
                        bool accumulate) const;
  /// First column and number of columns that the normalisation acts on.
  Index norm_begin() const { return norm_all_ ? 0 : arch_.latent; }
  void normalise(Index rows, float* z, std::vector<float>& factor) const;
  /// g <- s (g - b (b . g)), b the normalised state: the pullback and, being symmetric, also the jvp.
  void normalise_derivative(float* g, const float* b, float factor) const;
  Index skip_of(Index layer) const;  ///< layer whose output is added; -1: none
  bool tanh() const { return arch_.activation == "tanh"; }

  const Kernels& kernels_;
  Architecture arch_;
  Dimensions dim_;
  Layout layout_;
  std::vector<float> weights_;
  Index z_ = 0;
  bool norm_all_ = false, norm_ = false;
  float floor_ = 0.0f;
  Packed encoder_shape_, encoder_velocity_, encoder_out_, out_h_, out_u_, decoder_in_, mean_, sigma_;
  std::vector<Packed> layer_h_, layer_u_;
  Packed project_;  // [coordinates, latent]: basis / scale
  Packed expand_;   // [latent, coordinates]: (basis scale)^T
};

}  // namespace weft::emd
