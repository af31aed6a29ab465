#pragma once
#include <cstddef>

namespace weft::emd {

/// The inner loops of prediction, in one version per instruction set; the best that the processor has is chosen once.
///
/// Every element of a product is the same sequence of fused multiply-adds over k, whatever row it stands in and however
/// many rows there are. That is what makes a batched prediction equal, bit for bit, to the same case alone; a general
/// BLAS does not promise it, and packs the weights again in every call, which for 16 rows costs more than the product.
struct Kernels {
  const char* name;
  std::size_t panel;  ///< columns of a packed panel

  /// Floats that pack() writes for a [k, n] matrix.
  std::size_t packed_size(std::size_t k, std::size_t n) const { return (n + panel - 1) / panel * panel * k; }
  /// B [k, n] with the given row and column stride into panels of `panel` columns, padded with zeros.
  void pack(std::size_t k, std::size_t n, const float* b, std::size_t row_stride, std::size_t column_stride,
            float* packed) const;

  /// C [m, n] = start + A [m, k] B, start = C itself when `accumulate`, else the bias [n], or 0 when it is null.
  void (*gemm)(std::size_t m, std::size_t k, std::size_t n, const float* a, std::size_t lda, const float* packed,
               float* c, std::size_t ldc, const float* bias, bool accumulate);
  /// y = f(x), elementwise; x and y may be the same. tanh instead of silu by flag.
  void (*activate)(std::size_t count, const float* x, float* y, bool use_tanh);
  /// g *= f'(x).
  void (*activate_pullback)(std::size_t count, const float* x, float* g, bool use_tanh);
  void (*exponential)(std::size_t count, const float* x, float* y);
};

/// The best version for this processor. WEFT_EMD_ISA=v2|v3|v4 asks for another one (tests).
const Kernels& kernels();
/// A version by name ("v2", "v3", "v4"); null if this processor lacks it.
const Kernels* find_kernels(const char* name);

}  // namespace weft::emd
