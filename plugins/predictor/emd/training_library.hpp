#pragma once
#include "model.hpp"
#include "weft/host.hpp"
#include "weft/trainable.hpp"

namespace weft::emd {

/// One fit for the training library (libweft_emd_training.so). The library keeps no reference to any of it.
struct FitJob {
  const Dataset& dataset;
  const Task& task;
  const Architecture& architecture;
  const Training& training;
  const FitOptions& options;
  const FitObserver& observer;
  Host& host;
  const std::string& kernels;  ///< numeric variant of the gradients
  Model model;                 ///< out: the best model
  FitReport report;            ///< out
};
/// Exported as "weft_emd_fit". @throws what TrainablePredictor::fit throws.
using FitFunction = void (*)(FitJob& job);

/// One calibration of a model for the training library.
struct CalibrationJob {
  const Dataset& dataset;
  const std::vector<std::size_t>& examples;  ///< positions in the dataset
  const Training& training;
  std::uint64_t seed;
  Host& host;
  Model model;               ///< in and out; only its calibration and sigma layer change
  CalibrationReport report;  ///< out
};
/// Exported as "weft_emd_calibrate".
using CalibrationFunction = void (*)(CalibrationJob& job);

/// Loss and gradients by autograd, for tests of the hand-written ones. All arrays as in Block (normalised).
struct AutogradJob {
  const Model& model;
  const struct Block& block;
  const float* d_mean;  ///< [wanted, coordinates]
  const float* d_sigma;
  std::vector<float> mean, sigma;                  ///< out
  std::vector<float> d_inputs, d_shape, d_change;  ///< out: gradients of <d_mean, mean> + <d_sigma, sigma>
  std::vector<float> d_weights;                    ///< out, [Layout::size]
};
/// Exported as "weft_emd_autograd".
using AutogradFunction = void (*)(AutogradJob& job);

/// A function of the training library. The first call loads the library, which lies beside this plugin. It is never
/// unloaded, since libtorch does not survive that.
/// @param kernels numeric variant: libtorch and OpenBLAS choose their code by it when they are loaded.
/// @throws Unsupported when weft was built without libtorch, or when it was loaded for another variant.
void* training_function(const char* name, const std::string& kernels = "auto");

}  // namespace weft::emd
