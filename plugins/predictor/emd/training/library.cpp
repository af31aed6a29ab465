// What the training library exports (training_library.hpp). A library of its own, so that prediction needs no libtorch.
#include <torch/csrc/autograd/autograd.h>

#include "../training_library.hpp"
#include "calibration.hpp"
#include "fit.hpp"
#include "passes.hpp"

namespace weft::emd {
namespace {

/// Errors of libtorch become ours: its exception types stay inside this library.
template <class Body>
void translated(const Body& body) {
  try {
    body();
  } catch (const c10::Error& error) {
    throw Error(std::string("libtorch: ") + error.what_without_backtrace());
  }
}

void differentiate(AutogradJob& job) {
  const auto& block = job.block;
  const auto n = job.model.dimensions.coordinates();
  job.d_weights.assign(job.model.weights.size(), 0.0f);
  const Graph graph(job.model, job.model.weights.data(), job.d_weights.data());
  Tensor shape = view(block.shape.data(), block.rows, n).clone().set_requires_grad(true);
  Tensor change = view(block.change.data(), block.rows, n).clone().set_requires_grad(true);
  Tensor inputs =
      view(block.inputs.data(), block.total(), job.model.dimensions.inputs()).clone().set_requires_grad(true);
  const auto out = graph.forward(shape, change, inputs, block);
  const Tensor sigma = sigma_of(job.model, out.log_sigma).value;
  const Index wanted = block.wanted.size();
  torch::autograd::backward({out.mean, sigma}, {view(job.d_mean, wanted, n), view(job.d_sigma, wanted, n)});
  const auto copy = [](const Tensor& t) {
    const Tensor c = t.detach().contiguous();
    return std::vector<float>(c.data_ptr<float>(), c.data_ptr<float>() + c.numel());
  };
  job.mean = copy(out.mean);
  job.sigma = copy(sigma);
  job.d_inputs = copy(inputs.grad());
  job.d_shape = copy(shape.grad());
  job.d_change = change.grad().defined() ? copy(change.grad()) : std::vector<float>(job.d_shape.size(), 0.0f);
}

}  // namespace
}  // namespace weft::emd

extern "C" WEFT_API void weft_emd_fit(weft::emd::FitJob& job) {
  weft::emd::translated([&] { weft::emd::fit(job); });
}

extern "C" WEFT_API void weft_emd_calibrate(weft::emd::CalibrationJob& job) {
  weft::emd::translated([&] { weft::emd::calibrate(job); });
}

extern "C" WEFT_API void weft_emd_autograd(weft::emd::AutogradJob& job) {
  weft::emd::translated([&] { weft::emd::differentiate(job); });
}
