// The network: its products, its derivatives against autograd, and that batches do not change its results.
#include <array>
#include <cmath>
#include <cstring>

#include "loader/program_host.hpp"
#include "plugins/emd_fixture.hpp"
#include "session/session.hpp"
#include "unit/serial_host.hpp"

namespace weft::emd {
namespace {

TEST(EmdKernels, ProductsAgreeAndRowsDoNotDependOnOneAnother) {
  for (const char* isa : {"v2", "v3", "v4", "amx"}) {
    const Kernels* kernels = find_kernels(isa);
    if (kernels == nullptr) continue;
    const double rounding = std::strcmp(isa, "amx") == 0 ? 1e-3 : 1e-4;  // of sums of up to 65 numbers around 1
    RandomStream random(1);
    for (const auto& [m, k, n] : {std::array<std::size_t, 3>{1, 5, 3}, {13, 37, 65}, {40, 64, 31}, {25, 3, 200}}) {
      std::vector<float> a(m * k), b(k * n), bias(n), c(m * n), packed(kernels->packed_size(k, n));
      for (auto* v : {&a, &b, &bias})
        for (float& x : *v) x = static_cast<float>(random.normal());
      kernels->pack(k, n, b.data(), n, 1, packed.data());
      kernels->gemm(m, k, n, a.data(), k, packed.data(), c.data(), n, bias.data(), false);
      for (std::size_t i = 0; i < m; ++i) {
        for (std::size_t j = 0; j < n; ++j) {
          double sum = static_cast<double>(bias[j]);
          for (std::size_t l = 0; l < k; ++l)
            sum += static_cast<double>(a[i * k + l]) * static_cast<double>(b[l * n + j]);
          ASSERT_NEAR(c[i * n + j], sum, rounding) << isa;
        }
        std::vector<float> row(n);
        kernels->gemm(1, k, n, a.data() + i * k, k, packed.data(), row.data(), n, bias.data(), false);
        ASSERT_EQ(std::memcmp(row.data(), c.data() + i * n, n * sizeof(float)), 0) << isa;
      }
      // The transpose, accumulated.
      std::vector<float> back(kernels->packed_size(n, k)), d(m * k, 1.0f);
      kernels->pack(n, k, b.data(), 1, n, back.data());
      kernels->gemm(m, n, k, c.data(), n, back.data(), d.data(), k, nullptr, true);
      double sum = 1.0;
      for (std::size_t j = 0; j < n; ++j) sum += static_cast<double>(c[j]) * static_cast<double>(b[j]);
      EXPECT_NEAR(d[0], sum, 10.0 * rounding * (1.0 + std::abs(sum)));
    }
    std::vector<float> x, y(401), slope(401, 1.0f);
    for (int i = 0; i <= 400; ++i) x.push_back(0.1f * static_cast<float>(i - 200));
    for (const bool use_tanh : {false, true}) {
      kernels->activate(x.size(), x.data(), y.data(), use_tanh);
      std::fill(slope.begin(), slope.end(), 1.0f);
      kernels->activate_pullback(x.size(), x.data(), slope.data(), use_tanh);
      for (std::size_t i = 0; i < x.size(); ++i) {
        const double v = static_cast<double>(x[i]), s = 1.0 / (1.0 + std::exp(-v));
        EXPECT_NEAR(y[i], use_tanh ? std::tanh(v) : v * s, 2e-6);
        EXPECT_NEAR(slope[i], use_tanh ? 1.0 - std::tanh(v) * std::tanh(v) : s * (1.0 + v * (1.0 - s)), 2e-6);
      }
    }
    kernels->exponential(x.size(), x.data(), y.data());
    for (std::size_t i = 0; i < x.size(); ++i) EXPECT_NEAR(y[i] / std::exp(static_cast<double>(x[i])), 1.0, 5e-7);
  }
}

/// Relative difference of two arrays.
double difference(const std::vector<float>& a, const std::vector<float>& b) {
  EXPECT_EQ(a.size(), b.size());
  double error = 0.0, size = 1e-20;
  for (std::size_t i = 0; i < std::min(a.size(), b.size()); ++i) {
    error += std::pow(static_cast<double>(a[i]) - static_cast<double>(b[i]), 2);
    size += std::pow(static_cast<double>(b[i]), 2);
  }
  return std::sqrt(error / size);
}

/// Four sub-sequences with random shapes and inputs, and cotangents of what they predict.
struct Drawn {
  Block block;
  std::vector<float> d_mean, d_sigma;
  RandomStream random{5};

  explicit Drawn(const Model& model) {
    const Index n = model.dimensions.coordinates();
    block.rows = 4;
    block.steps = {6, 4, 4, 1};
    block.wanted = {{0, 2}, {0, 6}, {1, 4}, {2, 1}, {3, 1}};
    fill(block.shape, 4 * n, 0.5);
    fill(block.change, 4 * n, 0.2);
    fill(block.inputs, block.total() * model.dimensions.inputs(), 1.0);
    fill(d_mean, 5 * n, 1.0);
    fill(d_sigma, 5 * n, 1.0);
  }
  void fill(std::vector<float>& v, Index size, double scale) {
    v.resize(static_cast<std::size_t>(size));
    for (float& x : v) x = static_cast<float>(scale * random.normal());
  }
};

#if WEFT_HAS_TORCH
double product(const std::vector<float>& a, const std::vector<float>& b) {
  double sum = 0.0;
  for (std::size_t k = 0; k < a.size(); ++k) sum += static_cast<double>(a[k]) * static_cast<double>(b[k]);
  return sum;
}

/// Forward pass, pullback, gradient of the weights and jvp of one variant.
void compare(const Model& model, Drawn& drawn, const AutogradJob& job, const std::string& variant) {
  SCOPED_TRACE(variant);
  const Block& block = drawn.block;
  // Sums in another order, in single precision or of split numbers; a term left out is of the order of 1.
  const double rounding = variant == "amx" ? 10.0 : 1.0;
  const Network network(model, kernels(variant));
  Network::Tape tape;
  std::vector<float> mean(drawn.d_mean.size()), sigma(mean.size());
  network.forward(block, tape, mean.data(), sigma.data());
  EXPECT_LT(difference(mean, job.mean), 1e-5 * rounding);
  EXPECT_LT(difference(sigma, job.sigma), 1e-5 * rounding);
  std::vector<float> d_inputs(block.inputs.size()), d_shape(block.shape.size()), d_change(block.shape.size());
  network.pullback(block, tape, drawn.d_mean.data(), drawn.d_sigma.data(), d_inputs.data(), d_shape.data(),
                   d_change.data());
  EXPECT_LT(difference(d_inputs, job.d_inputs), 5e-5 * rounding);
  EXPECT_LT(difference(d_shape, job.d_shape), 5e-5 * rounding);
  EXPECT_LT(difference(d_change, job.d_change), 5e-5 * rounding);

  std::vector<float> d_weights;
  network.weight_gradient(block, tape, drawn.d_mean.data(), drawn.d_sigma.data(), d_weights);
  for (const auto& weight : Layout(model.architecture, model.dimensions).weights) {
    const auto slice = [&](const std::vector<float>& whole) {
      return std::vector<float>(whole.begin() + static_cast<std::ptrdiff_t>(weight.offset),
                                whole.begin() + static_cast<std::ptrdiff_t>(weight.offset + weight.size()));
    };
    EXPECT_LT(difference(slice(d_weights), slice(job.d_weights)), 5e-5 * rounding) << weight.name;
  }

  // The jvp is the transpose: <d, J t> = <J^T d, t>.
  std::vector<float> t_inputs, t_mean(mean.size()), t_sigma(mean.size());
  drawn.fill(t_inputs, std::ssize(block.inputs), 1.0);
  network.jvp(block, tape, {0, 1, 2, 3}, t_inputs.data(), t_mean.data(), t_sigma.data());
  double size = 0.0;
  for (std::size_t k = 0; k < mean.size(); ++k)
    size += std::abs(static_cast<double>(drawn.d_mean[k]) * static_cast<double>(t_mean[k]));
  EXPECT_NEAR(product(drawn.d_mean, t_mean) + product(drawn.d_sigma, t_sigma), product(d_inputs, t_inputs),
              1e-5 * rounding * size);
}

TEST(EmdNetwork, AgreesWithAutogradForEverySwitch) {
  const auto autograd = reinterpret_cast<AutogradFunction>(training_function("weft_emd_autograd"));
  std::vector<Architecture> all(1, small());
  const auto with = [&](auto change) {
    all.push_back(small());
    change(all.back());
  };
  with([](Architecture& a) { a.residual = 0; });
  with([](Architecture& a) { a.residual = 2; });
  with([](Architecture& a) { a.repeat_inputs = false; });
  with([](Architecture& a) { a.pca_skip = false; });
  with([](Architecture& a) { a.pca_skip = a.previous_shape = false; });
  with([](Architecture& a) { a.differential_latent = false; });
  with([](Architecture& a) { a.latent_normalisation = "none"; });
  with([](Architecture& a) { a.latent_normalisation = "all"; });
  with([](Architecture& a) { a.differential_decoding = false; });
  with([](Architecture& a) { a.activation = "tanh"; });
  with([](Architecture& a) { a.memory = 0; });
  with([](Architecture& a) { a.layers = 1; });
  const Task task = patch_task();
  for (std::size_t i = 0; i < all.size(); ++i) {
    SCOPED_TRACE(i);
    const Model model = untrained_model(all[i], task, 11);
    Drawn drawn(model);
    AutogradJob job{model, drawn.block, drawn.d_mean.data(), drawn.d_sigma.data(), {}, {}, {}, {}, {}, {}};
    autograd(job);
    for (const std::string& variant : kernels_here()) compare(model, drawn, job, variant);
  }
}

#endif  // WEFT_HAS_TORCH

TEST(EmdNetwork, SomeCoordinatesAreThoseOfAll) {
  const Model model = untrained_model(small(), patch_task(), 11);
  const Drawn drawn(model);
  const Block& block = drawn.block;
  const auto n = static_cast<std::size_t>(model.dimensions.coordinates());
  const std::vector<std::int64_t> columns = {0, 1, 2, 6, 7, 8};
  const auto some = [&](const std::vector<float>& whole) {
    std::vector<float> chosen;
    for (std::size_t w = 0; w < block.wanted.size(); ++w)
      for (const std::int64_t c : columns) chosen.push_back(whole[w * n + static_cast<std::size_t>(c)]);
    return chosen;
  };
  // Cotangents of 0 elsewhere.
  const auto alone = [&](const std::vector<float>& whole) {
    std::vector<float> masked(whole.size(), 0.0f);
    for (std::size_t w = 0; w < block.wanted.size(); ++w)
      for (const std::int64_t c : columns)
        masked[w * n + static_cast<std::size_t>(c)] = whole[w * n + static_cast<std::size_t>(c)];
    return masked;
  };
  test::SerialHost host;
  for (const std::string& variant : kernels_here()) {
    SCOPED_TRACE(variant);
    Network network(model, kernels(variant));
    Network::Tape tape, tape_of_some;
    std::vector<float> mean(drawn.d_mean.size()), sigma(mean.size()), gradient;
    network.forward(block, tape, mean.data(), sigma.data());
    network.weight_gradient(block, tape, alone(drawn.d_mean).data(), alone(drawn.d_sigma).data(), gradient);

    network.set_weights(model.weights.data(), columns, host);
    ASSERT_EQ(network.decoded(), std::ssize(columns));
    std::vector<float> some_mean(block.wanted.size() * columns.size()), some_sigma(some_mean.size()), some_gradient;
    network.forward(block, tape_of_some, some_mean.data(), some_sigma.data());
    EXPECT_LT(difference(some_mean, some(mean)), 1e-6);
    EXPECT_LT(difference(some_sigma, some(sigma)), 1e-6);
    network.weight_gradient(block, tape_of_some, some(drawn.d_mean).data(), some(drawn.d_sigma).data(), some_gradient);
    EXPECT_LT(difference(some_gradient, gradient), variant == "amx" ? 1e-4 : 1e-5);
  }
}

double largest_distance(const Positions& a, const Positions& b) { return (a - b).rowwise().norm().maxCoeff(); }

/// Cases of different lengths, starts and requests.
std::vector<PredictionCase> some_cases(const Task& task, std::size_t count, std::uint64_t seed) {
  std::vector<PredictionCase> cases;
  const auto variables = task.trajectory->controls();
  for (std::size_t i = 0; i < count; ++i) {
    RandomStream random(seed, i);
    PredictionCase one;
    Positions shape = task.garment->positions;
    for (Index v = 0; v < shape.size(); ++v) shape.data()[v] += 0.01 * random.normal();
    one.shape = std::make_shared<const Positions>(shape);
    if (i % 3 == 1) {
      for (Index v = 0; v < shape.size(); ++v) shape.data()[v] += 0.01 * random.normal();
      one.previous = std::make_shared<const Positions>(shape);
    }
    one.state = task.trajectory->initial_state(task.manipulation);
    one.state[0] += static_cast<double>(i % 4) * 30.0;
    const auto k = static_cast<Index>(1 + random.below(9));
    one.controls = task.trajectory->default_controls(k);
    for (Index j = 0; j < k; ++j)
      for (Index c = 0; c < one.controls.cols(); ++c) one.controls(j, c) += 0.5 * variables[c].scale * random.normal();
    for (Index p = 0; p < 4; ++p) {
      one.knowledge.centre[p] = random.uniform();
      one.knowledge.width[p] = random.uniform();
    }
    for (Index j = 1; j <= k; ++j)
      if (random.uniform() < 0.5 || j == k) one.segments.push_back(j);
    cases.push_back(one);
  }
  return cases;
}

TEST(EmdPredictor, VariantsPredictTheSameShapes) {
  const auto host = make_host(std::make_shared<PluginRegistry>(), {.threads = 1});
  const ConfigNode config = ConfigNode::load(WEFT_SOURCE_DIR "/configs/tasks/tshirt_fold_network.yaml");
  SessionParams session;
  read_params(config, session);
  const Task task = make_task(session.task, config, *host);
  Params params;
  params.model = WEFT_SOURCE_DIR "/configs/models/tshirt.h5";
  const auto cases = some_cases(task, 24, 7);
  std::vector<std::unique_ptr<Prediction>> predictions;
  std::vector<std::unique_ptr<EmdPredictor>> predictors;
  for (const std::string& variant : kernels_here()) {
    params.kernels = variant;
    predictors.push_back(std::make_unique<EmdPredictor>(params, *host));
    predictors.back()->bind(task);
    predictions.push_back(predictors.back()->predict(cases, {.moments = Moments::mean_and_sigma}));
  }
  for (std::size_t k = 1; k < predictions.size(); ++k) {
    for (std::size_t i = 0; i < cases.size(); ++i) {
      for (std::size_t j = 0; j < cases[i].segments.size(); ++j) {
        const auto &one = predictions[k]->shapes()[i][j], &other = predictions[0]->shapes()[i][j];
        EXPECT_LT(largest_distance(one.mean, other.mean), 5e-5) << kernels_here()[k] << ", case " << i;
        EXPECT_LT(largest_distance(one.sigma, other.sigma), 5e-5) << kernels_here()[k] << ", case " << i;
      }
    }
  }
}

TEST(EmdPredictor, ACaseIsTheSameWhateverElseIsInTheBatch) {
  const Task task = patch_task();
  Params params;
  params.untrained = true;
  params.architecture = small();
  TestHost one(1), three(3);
  EmdPredictor predictor(params, three), alone(params, one);
  predictor.bind(task);
  alone.bind(task);
  const auto cases = some_cases(task, 43, 1);
  const PredictionRequest request{.gradients = true, .state_gradients = true, .shape_gradients = true};
  const auto batch = predictor.predict(cases, request);
  std::vector<std::vector<ShapeCotangent>> ones;
  for (const auto& c : cases)
    ones.emplace_back(c.segments.size(), ShapeCotangent{Positions::Ones(20, 3), Positions::Ones(20, 3)});
  const auto gradients = batch->pullback(ones);
  for (std::size_t i = 0; i < cases.size(); ++i) {
    const auto single = alone.predict({cases[i]}, request);
    for (std::size_t s = 0; s < cases[i].segments.size(); ++s) {
      EXPECT_EQ(single->shapes()[0][s].mean, batch->shapes()[i][s].mean);
      EXPECT_EQ(single->shapes()[0][s].sigma, batch->shapes()[i][s].sigma);
    }
    const auto g = single->pullback({ones[i]});
    EXPECT_EQ(g[0].controls, gradients[i].controls);
    EXPECT_EQ(g[0].centre, gradients[i].centre);
    EXPECT_EQ(g[0].state, gradients[i].state);
    EXPECT_EQ(g[0].shape, gradients[i].shape);
  }
}

}  // namespace
}  // namespace weft::emd
