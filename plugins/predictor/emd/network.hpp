#pragma once
#include <cstdint>
#include <numeric>
#include <vector>

#include "kernels/kernels.hpp"
#include "model.hpp"
#include "weft/host.hpp"

namespace weft::emd {

/// Entries of a matrix.
inline std::size_t size_of(Index rows, Index columns) { return rows * columns; }

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

/// The network without a graph: the forward pass keeps a tape, and the pullback, the jvp and the gradient of the weights are
/// written out by hand. Thread-safe but for set_weights(). A row's results do not depend on the other rows.
class Network {
 public:
  /// With the model's weights.
  explicit Network(const Model& model, const Kernels& kernels);

  /// For training: takes other weights, for forward() and weight_gradient() alone.
  /// @param weights [Layout::size], not kept. @param columns coordinates that the decoder gives, ascending; empty: all.
  void set_weights(const float* weights, const std::vector<std::int64_t>& columns, Host& host);
  /// Coordinates that the decoder gives.
  Index decoded() const { return columns_.empty() ? dim_.coordinates() : std::ssize(columns_); }

  struct Tape {
    std::vector<Index> running, offset;         // per segment
    std::vector<std::vector<float>> pre, post;  // per layer: [total, hidden] before and after nonlinearity (and skip)
    std::vector<std::vector<float>> z;          // per segment boundary: [rows, latent_size], normalised
    std::vector<std::vector<float>> norm;       // per segment boundary: [rows], factor of the normalisation
    std::vector<float> encoder_pre;             // [rows, encoder_hidden]
    std::vector<float> decoder_pre;             // [wanted, decoder_hidden]
    std::vector<float> start_pre;               // [rows, decoder_hidden], differential decoding
    std::vector<float> sigma_exp;               // [wanted, decoded()]: e^s, 0 where s is at its upper end
  };

  /// @param mean, sigma [wanted, decoded()], normalised; sigma may be null.
  void forward(const Block& block, Tape& tape, float* mean, float* sigma) const;
  /// @param d_mean, d_sigma [wanted, coordinates], either may be null.
  /// @param d_inputs [total, inputs], overwritten.
  /// @param d_shape, d_change [rows, coordinates], overwritten; if both are null, the encoder's pullback is skipped.
  void pullback(const Block& block, const Tape& tape, const float* d_mean, const float* d_sigma, float* d_inputs,
                float* d_shape, float* d_change) const;
  /// The gradient of <d_mean, mean> + <d_sigma, sigma> with respect to the weights.
  /// @param d_mean, d_sigma [wanted, decoded()]. @param gradient [Layout::size], overwritten.
  void weight_gradient(const Block& block, const Tape& tape, const float* d_mean, const float* d_sigma,
                       std::vector<float>& gradient) const;
  /// Derivatives of mean and sigma along directions in the inputs. Direction t belongs to row `rows[t]`, ascending.
  /// @param d_inputs [sum of steps of the directions, inputs], segment by segment as Block::inputs.
  /// @param d_mean, d_sigma [directions' wanted shapes, coordinates]: for each direction in turn, the wanted shapes of
  /// its row in order; d_sigma may be null.
  void jvp(const Block& block, const Tape& tape, const std::vector<Index>& rows, const float* d_inputs, float* d_mean,
           float* d_sigma) const;

 private:
  // forward(), in three steps: shapes to latent states, segment by segment, latent states to the wanted shapes.
  void encode(const Block& block, Tape& tape) const;
  std::vector<float> wanted_states(const Block& block, const Tape& tape) const;  ///< [wanted, latent_size]
  std::vector<float> velocities(const Block& block) const;  ///< [rows, latent]: the encoder's second input
  void advance(const Block& block, Tape& tape) const;
  void decode(const Block& block, Tape& tape, float* mean, float* sigma) const;
  /// Cotangents of what forward() computes, from the end to the start. A product's are those of its result.
  struct Cotangents {
    std::vector<std::vector<float>> z;    // of Tape::z; z[0] is that of the encoder's output
    std::vector<float> log_sigma;         // [wanted, decoded()]
    std::vector<float> decoder, start;    // of Tape::decoder_pre and start_pre
    std::vector<std::vector<float>> pre;  // of Tape::pre
    std::vector<float> update;            // [total, latent_size]: of the module's read-out
    std::vector<float> encoder;           // of Tape::encoder_pre
  };
  // The pullbacks of these steps.
  /// Adds to Cotangents::z. @param to_start whether z[0] is wanted. @param d_shape added to; may be null.
  void decode_pullback(const Block& block, const Tape& tape, const float* d_mean, const float* d_sigma, Cotangents& d,
                       bool to_start, float* d_shape) const;
  /// @param d_inputs may be null.
  void advance_pullback(const Block& block, const Tape& tape, Cotangents& d, bool to_start, float* d_inputs) const;
  /// Cotangents::encoder from z[0], which becomes that of the encoder's output before its normalisation.
  void encode_pullback(const Block& block, const Tape& tape, Cotangents& d) const;
  /// @param d_shape added to. @param d_change overwritten.
  void shape_pullback(const Block& block, const Cotangents& d, float* d_shape, float* d_change) const;

  // The parts of weight_gradient().
  void decoder_gradient(const Block& block, const Tape& tape, const float* d_mean, const Cotangents& d,
                        float* gradient) const;
  void module_gradient(const Block& block, const Tape& tape, const Cotangents& d, float* gradient) const;
  void encoder_gradient(const Block& block, const Tape& tape, const Cotangents& d, float* gradient) const;
  /// The gradient of a matrix, A^T D. @param a [m, rows of the weight]. @param d [m, its columns, or those decoded].
  /// @param adds to what is there already.
  void put_product(int weight, Index m, const float* a, const float* d, float* gradient, bool adds = false) const;
  /// The gradient of a vector, the sum of D's rows.
  void put_rows(int weight, Index m, const float* d, float* gradient, bool adds = false) const;
  bool is_decoded(int weight) const;  ///< whether its columns are coordinates of the decoder's

  /// A matrix B, packed for the products A B and A B^T.
  struct Packed {
    /// Vectors of them begin where a cache line does.
    struct alignas(64) Line {
      float values[16];
    };
    Index k = 0, n = 0;
    std::vector<Line> forward, backward;
  };
  /// @param data [k, n]. @param products whether A B alone is wanted.
  Packed pack(const float* data, Index k, Index n, bool products) const;
  /// Packs all weights. @param weights [Layout::size].
  void pack_all(const float* weights, bool for_training, Host* host);
  const float* bias(int weight) const { return biases_[weight].data(); }
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
  std::vector<std::vector<float>> biases_;  // by weight; empty for matrices
  std::vector<std::int64_t> columns_;       // of the decoder; empty: all
  Index z_ = 0;
  bool norm_all_ = false, norm_ = false;
  float floor_ = 0.0f;
  Packed encoder_shape_, encoder_velocity_, encoder_out_, out_h_, out_u_, decoder_in_, mean_, sigma_;
  std::vector<Packed> layer_h_, layer_u_;
  std::vector<float> expansion_;  // [latent, coordinates]: (basis scale)^T
  Packed project_;                // [coordinates, latent]: basis / scale
  Packed expand_;                 // [latent, decoded()]: expansion_
};

}  // namespace weft::emd
