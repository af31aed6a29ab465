#pragma once
#include <cstddef>
#include <string>
#include <vector>

namespace weft::emd {

/// One step of Adam (Kingma & Ba 2015) with decoupled weight decay (Loshchilov & Hutter 2019), with g = clip gradient:
///     m <- b1 m + (1 - b1) g,   v <- b2 v + (1 - b2) g^2,
///     w <- w - rate c1 m / (sqrt(c2 v) + 1e-8) - decay w,   average <- keep average + (1 - keep) w
struct AdamStep {
  float clip, b1, b2, c1, c2, rate, decay, keep;
};

/// The inner loops of prediction and training, in one version per instruction set. The program chooses the processor's best version
/// once.
///
/// Every element of a product is the same sequence of sums over k, in any row and for any number of rows. So a batched
/// prediction equals, bit for bit, the prediction of the same case alone. A general BLAS does not promise that. It also
/// packs the weights again in every call, which costs more than the product for 16 rows.
struct Kernels {
  const char* name;
  std::size_t panel;  ///< columns of a packed panel
  std::size_t depth;  ///< its rows are a multiple of this

  /// Floats that pack() writes for a [k, n] matrix.
  std::size_t packed_size(std::size_t k, std::size_t n) const {
    return (n + panel - 1) / panel * panel * ((k + depth - 1) / depth * depth);
  }
  /// Packs B [k, n], with the given row and column stride, into panels of `panel` columns, padded with zeros. Panels that
  /// begin at a multiple of 64 bytes are read faster.
  void (*pack)(std::size_t k, std::size_t n, const float* b, std::size_t row_stride, std::size_t column_stride,
               float* packed);
  /// C [m, n] = start + A [m, k] B, start = C itself when `accumulate`, else the bias [n], or 0 when it is null.
  void (*gemm)(std::size_t m, std::size_t k, std::size_t n, const float* a, std::size_t lda, const float* packed,
               float* c, std::size_t ldc, const float* bias, bool accumulate);
  /// y = f(x), elementwise, with f = tanh if the flag is set, else silu. x and y may be the same.
  void (*activate)(std::size_t count, const float* x, float* y, bool use_tanh);
  /// g *= f'(x).
  void (*activate_pullback)(std::size_t count, const float* x, float* g, bool use_tanh);
  void (*exponential)(std::size_t count, const float* x, float* y);
  /// @param m, v, weights, average [count], none of which overlap; average may be null.
  void (*adam)(std::size_t count, const AdamStep& step, const float* gradient, float* m, float* v, float* weights,
               float* average);
};

/// The names of the versions that this processor can run, the best one last.
std::vector<std::string> kernels_here();
/// A version by name; "auto": the best one for this processor. @throws Unsupported if this processor lacks it.
const Kernels& kernels(const std::string& name = "auto");
/// A version by name ("v2", "v3", "v4", "amx"); null if this processor lacks it.
const Kernels* find_kernels(const char* name);

}  // namespace weft::emd
