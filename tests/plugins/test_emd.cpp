// The learned predictor: its products, its derivatives against autograd, its files, its training.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <fstream>
#include <functional>
#include <nlohmann/json.hpp>
#include <string_view>
#include <thread>

#include "learning/dataset_files.hpp"
#include "learning/generate.hpp"
#include "learning/held_out.hpp"
#include "predictor/emd/emd.hpp"
#include "predictor/emd/sampling.hpp"
#include "predictor/emd/training/calibration.hpp"
#include "predictor/emd/training_library.hpp"
#include "trajectory/arc/arc.cpp"  // compiled in, as the predictor's objects are
#include "unit/test_support.hpp"
#include "weft/hdf5_file.hpp"

namespace weft::emd {
namespace {

using test::Folder;
using test::message_of;
using ::testing::HasSubstr;

class TestHost final : public Host {
 public:
  explicit TestHost(int threads = 2) : threads_(threads) {}
  int threads() const override { return threads_; }
  void parallel_for(std::int64_t count, const std::function<void(std::int64_t)>& body) override {
    std::vector<std::thread> workers;
    for (int t = 0; t < threads_; ++t) {
      workers.emplace_back([&, t] {
        for (std::int64_t i = t; i < count; i += threads_) body(i);
      });
    }
    for (auto& worker : workers) worker.join();
  }
  bool cancelled() const override { return false; }
  void log(LogLevel, const std::string& message) override { messages_ += message; }
  std::uint64_t seed() const override { return 3; }
  std::string messages_;

 protected:
  std::shared_ptr<void> create_erased(const std::string&, const ConfigNode&) override { throw Error("makes nothing"); }

 private:
  int threads_;
};

Task patch_task(Index columns = 5) {
  Task task;
  Mesh mesh;
  const Index rows = 4;
  mesh.positions.resize(rows * columns, 3);
  for (Index r = 0; r < rows; ++r)
    for (Index c = 0; c < columns; ++c)
      mesh.positions.row(r * columns + c) << 0.1 * static_cast<double>(c), 0.1 * static_cast<double>(r), 0.0;
  mesh.faces.resize(2 * (rows - 1) * (columns - 1), 3);
  Index f = 0;
  for (Index r = 0; r + 1 < rows; ++r) {
    for (Index c = 0; c + 1 < columns; ++c) {
      const int at = static_cast<int>(r * columns + c), up = at + static_cast<int>(columns);
      mesh.faces.row(f++) << at, at + 1, up;
      mesh.faces.row(f++) << at + 1, up + 1, up;
    }
  }
  task.garment = std::make_shared<const Garment>(make_garment(mesh, "patch"));
  task.trajectory = std::make_shared<const arc::Arc>(arc::Params{});
  task.manipulation.grasp_vertices = {0, (rows - 1) * columns};
  task.manipulation.grasp_points.resize(2, 3);
  task.manipulation.grasp_points.row(0) = mesh.positions.row(0);
  task.manipulation.grasp_points.row(1) = mesh.positions.row((rows - 1) * columns);
  task.manipulation.displacement = {0.4, 0.0};
  task.material.ranges = {{{0.2, 0.9, false}, {0.5, 2.0, true}, {0.5, 2.0, true}, {0.001, 0.002, false}}};
  return task;
}

Architecture small() {
  Architecture a;
  a.latent = 20;
  a.memory = 7;
  a.hidden = 33;
  a.encoder_hidden = 21;
  a.decoder_hidden = 26;
  return a;
}

/// Cases of different lengths, starts and wishes.
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
      for (Index c = 0; c < one.controls.cols(); ++c)
        one.controls(j, c) += 0.5 * variables[static_cast<std::size_t>(c)].scale * random.normal();
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

/// Folds that obey a simple rule: the grasped half follows the hands, the faster the stiffer; release flattens it.
Dataset toy_dataset(const Task& task, std::int64_t count, std::uint64_t seed = 1) {
  Dataset data;
  DataParams params;
  params.validation_fraction = 0.15;
  params.test_fraction = 0.15;
  data.header = make_dataset_header(task, params, seed, ConfigNode::parse("{toy: 1}", "test"), "{}");
  const auto variables = task.trajectory->controls();
  for (std::int64_t i = 0; i < count; ++i) {
    RandomStream random(8 + seed, static_cast<std::uint64_t>(i));
    Example e;
    e.index = i;
    for (Index p = 0; p < 4; ++p) e.q[p] = random.uniform();
    Controls controls = random_controls(*task.trajectory, 20, {}, random);
    const Index u = task.trajectory->release_segment(task.manipulation,
                                                     task.trajectory->initial_state(task.manipulation), controls);
    e.controls = controls.topRows(u);
    e.states.resize(u + 1, 5);
    e.states.row(0) = task.trajectory->initial_state(task.manipulation).transpose();
    e.states.bottomRows(u) =
        task.trajectory->segment_states(task.manipulation, e.states.row(0).transpose(), e.controls);
    e.targets.resize(u + 1, 6);
    Positions shape = task.garment->positions;
    for (Index j = 0; j <= u; ++j) {
      const Positions targets = task.trajectory->targets(task.manipulation, e.states.row(j).transpose());
      e.targets.row(j) = Eigen::Map<const Vector>(targets.data(), 6).transpose();
      e.released = task.trajectory->released(e.states.row(j).transpose());
      for (Index v = 0; v < shape.rows() && j > 0; ++v) {
        const double share = std::max(0.0, 1.0 - task.garment->positions(v, 0) / 0.2) * (0.4 + 0.5 * e.q[1]);
        const Eigen::RowVector3d hand = targets.colwise().mean();
        Eigen::RowVector3d goal = hand;
        goal[1] += task.garment->positions(v, 1) - 0.15;
        shape.row(v) += share * (goal - shape.row(v));
        if (e.released) shape(v, 2) = 0.002;
      }
      for (Index v = 0; v < shape.size(); ++v) e.shapes.push_back(static_cast<float>(shape.data()[v]));
    }
    e.settle.settled = true;
    data.examples.push_back(std::move(e));
  }
  return data;
}

/// Example i from its start, its material known; no segment wanted yet.
PredictionCase whole_example(const Dataset& data, std::size_t i) {
  const auto& e = data.examples[i];
  PredictionCase one;
  one.shape = std::make_shared<const Positions>(data.shape(i, 0));
  one.state = e.states.row(0).transpose();
  one.controls = e.controls;
  one.knowledge = MaterialKnowledge::certain(e.q);
  return one;
}

Training quick() {
  Training t;
  t.batch = 12;
  t.iterations = 60;
  t.evaluate_every = 20;
  t.checkpoint_every = 20;
  t.warmup = 5;
  t.rate = 3e-3;
  t.average = 0.9;
  return t;
}

std::string bytes_of(const std::filesystem::path& file) {
  std::ifstream stream(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), {}};
}

// ---------------------------------------------------------------------------------------------------------------------

TEST(EmdKernels, ProductsAgreeAndRowsDoNotDependOnOneAnother) {
  for (const char* isa : {"v2", "v3", "v4"}) {
    const Kernels* kernels = find_kernels(isa);
    if (kernels == nullptr) continue;
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
          ASSERT_NEAR(c[i * n + j], sum, 1e-4) << isa;
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
      EXPECT_NEAR(d[0], sum, 1e-3 * (1.0 + std::abs(sum)));
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

#if WEFT_HAS_TORCH
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
    const Index n = model.dimensions.coordinates();
    Block block;
    block.rows = 4;
    block.steps = {6, 4, 4, 1};
    block.wanted = {{0, 2}, {0, 6}, {1, 4}, {2, 1}, {3, 1}};
    RandomStream random(5);
    const auto fill = [&](std::vector<float>& v, Index size, double scale) {
      v.resize(static_cast<std::size_t>(size));
      for (float& x : v) x = static_cast<float>(scale * random.normal());
    };
    fill(block.shape, 4 * n, 0.5);
    fill(block.change, 4 * n, 0.2);
    fill(block.inputs, block.total() * model.dimensions.inputs(), 1.0);
    std::vector<float> mean(5 * static_cast<std::size_t>(n)), sigma(mean.size()), d_mean, d_sigma;
    fill(d_mean, 5 * n, 1.0);
    fill(d_sigma, 5 * n, 1.0);
    AutogradJob job{model, block, d_mean.data(), d_sigma.data(), {}, {}, {}, {}, {}};
    autograd(job);
    const Network network(model, kernels());
    Network::Tape tape;
    network.forward(block, tape, mean.data(), sigma.data());
    EXPECT_LT(difference(mean, job.mean), 1e-5);
    EXPECT_LT(difference(sigma, job.sigma), 1e-5);
    std::vector<float> d_inputs(block.inputs.size()), d_shape(block.shape.size()), d_change(block.shape.size());
    network.pullback(block, tape, d_mean.data(), d_sigma.data(), d_inputs.data(), d_shape.data(), d_change.data());
    // Sums in another order, in single precision; a term left out is of the order of 1.
    EXPECT_LT(difference(d_inputs, job.d_inputs), 5e-5);
    EXPECT_LT(difference(d_shape, job.d_shape), 5e-5);
    EXPECT_LT(difference(d_change, job.d_change), 5e-5);

    // The jvp is the transpose: <d, J t> = <J^T d, t>.
    std::vector<float> t_inputs, t_mean(mean.size()), t_sigma(mean.size());
    fill(t_inputs, block.total() * model.dimensions.inputs(), 1.0);
    network.jvp(block, tape, {0, 1, 2, 3}, t_inputs.data(), t_mean.data(), t_sigma.data());
    double left = 0.0, right = 0.0, size = 0.0;
    for (std::size_t k = 0; k < mean.size(); ++k) {
      left += static_cast<double>(d_mean[k]) * static_cast<double>(t_mean[k]) +
              static_cast<double>(d_sigma[k]) * static_cast<double>(t_sigma[k]);
      size += std::abs(static_cast<double>(d_mean[k]) * static_cast<double>(t_mean[k]));
    }
    for (std::size_t k = 0; k < d_inputs.size(); ++k)
      right += static_cast<double>(d_inputs[k]) * static_cast<double>(t_inputs[k]);
    EXPECT_NEAR(left, right, 1e-5 * size);
  }
}

#endif  // WEFT_HAS_TORCH

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

TEST(EmdPredictor, NeedsAModelAndRefusesOneOfAnotherTask) {
  const Folder folder;
  TestHost host;
  const Task task = patch_task();
  EmdPredictor without(Params{}, host);
  EXPECT_THAT(message_of<ConfigError>([&] { without.bind(task); }), HasSubstr("needs a model file"));
  EXPECT_THROW(without.predict({}, {}), Error);
  save_model(folder / "m.h5", untrained_model(small(), task, 1), true);
  Params params;
  params.model = folder / "m.h5";
  const auto refusal = [&](const Task& other) {
    EmdPredictor predictor(params, host);
    return message_of<ConfigError>([&] { predictor.bind(other); });
  };
  EXPECT_THAT(refusal(patch_task(6)), HasSubstr("trained for the garment 'patch'"));
  Task other = task;
  other.manipulation.displacement = {0.41, 0.0};
  EXPECT_THAT(refusal(other), HasSubstr("displacement [0.400000, 0.000000], the task has [0.410000"));
  other = task;
  other.manipulation.drop_height = 0.06;
  EXPECT_THAT(refusal(other), HasSubstr("drop height"));
  other = task;
  other.manipulation.grasp_vertices[0] = 1;
  EXPECT_THAT(refusal(other), HasSubstr("grasp vertices"));
  other = task;
  other.material.ranges[0].high = 0.8;
  EXPECT_THAT(refusal(other), HasSubstr("another material space"));
  params.other_fabric = "warn";
  EmdPredictor warned(params, host);
  warned.bind(other);
  EXPECT_THAT(host.messages_, HasSubstr("another material space"));
}

TEST(EmdPredictor, NamesTheControlsThatItsModelHasSeen) {
  const Folder folder;
  TestHost host;
  const Task task = patch_task();
  Model model = untrained_model(small(), task, 1);
  model.control_low[2] = -0.25;
  model.control_high[2] = 0.125;
  save_model(folder / "m.h5", model, true);
  Params params;
  params.model = folder / "m.h5";
  EmdPredictor predictor(params, host);
  EXPECT_THROW(predictor.control_range(), Error);
  predictor.bind(task);
  const auto range = predictor.control_range();
  ASSERT_TRUE(range.has_value());
  EXPECT_EQ(range->lower(2), -0.25);
  EXPECT_EQ(range->upper(2), 0.125);
  const auto variables = task.trajectory->controls();
  ASSERT_EQ(range->dim(), static_cast<Index>(variables.size()));
  EXPECT_EQ(range->upper(0), variables[0].upper);
}

TEST(EmdModel, ComesBackAsItWasAndDamageIsRefused) {
  const Folder folder;
  Model model = untrained_model(small(), patch_task(), 1);
  model.training = "{\"a\":1}";
  model.datasets = {{"first", 7, 0.04, 0.08}, {"second", ~0ull, 0.125, 0.25}};
  for (const bool half : {false, true}) {
    save_model(folder / "m.h5", model, half);
    const Model back = load_model(folder / "m.h5");
    Model rounded = model;
    if (half) {
      for (float& w : rounded.weights) w = round_to_half(w);
      for (float& w : rounded.basis) w = round_to_half(w);
    }
    EXPECT_EQ(back.weights, rounded.weights);
    EXPECT_EQ(back.basis, rounded.basis);
    EXPECT_EQ(back.control_names, model.control_names);
    EXPECT_EQ(back.material, model.material);
    EXPECT_EQ(back.training, model.training);
    ASSERT_EQ(back.datasets.size(), 2u);
    EXPECT_EQ(back.datasets[1].identity, "second");
    EXPECT_EQ(back.datasets[1].seed, ~0ull);
    EXPECT_EQ(back.datasets[1].test_fraction, 0.25);
    save_model(folder / "again.h5", back, half);
    EXPECT_EQ(bytes_of(folder / "m.h5"), bytes_of(folder / "again.h5"));
  }
  EXPECT_NEAR(round_to_half(0.1f), 0.1f, 3e-5f);
  EXPECT_EQ(round_to_half(1e6f), 65504.0f);

  const std::string good = bytes_of(folder / "m.h5");
  const auto weights = load_model(folder / "m.h5").weights;
  RandomStream random(2);
  int refused = 0;
  for (int trial = 0; trial < 150; ++trial) {
    std::string bad = good;
    if (trial % 3 == 0) {
      bad.resize(random.below(bad.size()));
    } else {
      for (int k = 0; k < 2; ++k) bad[random.below(bad.size())] ^= static_cast<char>(1 + random.below(255));
    }
    std::ofstream(folder / "bad.h5", std::ios::binary) << bad;
    try {
      EXPECT_EQ(load_model(folder / "bad.h5").weights, weights);
    } catch (const Error&) {
      ++refused;
    }
  }
  EXPECT_GT(refused, 60);
}

/// A model file with one bit changed, in the first byte of a value that it holds.
template <class T>
std::string with_changed_bit(std::string file, const T& value) {
  const std::string_view wanted(reinterpret_cast<const char*>(value.data()), value.size() * sizeof(value[0]));
  const auto at = file.find(wanted);
  EXPECT_NE(at, std::string::npos);
  EXPECT_EQ(file.find(wanted, at + 1), std::string::npos) << "not the only one";
  if (at != std::string::npos) file[at] ^= 1;
  return file;
}

// Whatever a plan, an estimate or a comparison of data relies on: the finite, plausible values of another model would
// do harm in silence.
TEST(EmdModel, AChangeOfAnyValueIsRefused) {
  const Folder folder;
  Model model = untrained_model(small(), patch_task(), 1);
  model.dataset = "6f1d";
  model.provenance = "{\"commit\":\"5a\"}";
  model.training = "{\"iterations\":12}";
  model.datasets = {{"6f1c", 7171717, 0.04, 0.08}};
  model.calibrated = {{"6f1b", 8181818, 0.03, 0.07}};
  model.grasp_vertices = {3, 14};
  model.initial_state = {0.125, 0.2, 0.3, 0.4, 0.5};
  model.garment_name = "tablecloth";
  save_model(folder / "m.h5", model, false);
  ASSERT_NO_THROW(load_model(folder / "m.h5"));
  const std::string good = bytes_of(folder / "m.h5");
  const auto check = [&](const char* what, const auto& value) {
    SCOPED_TRACE(what);
    std::ofstream(folder / "bad.h5", std::ios::binary) << with_changed_bit(good, value);
    EXPECT_THAT(message_of<ConfigError>([&] { load_model(folder / "bad.h5"); }), HasSubstr("recorded checksum"));
  };
  check("control_low", model.control_low);
  check("control_high", model.control_high);
  check("initial_state", model.initial_state);
  check("initial_targets", model.initial_targets);
  check("displacement", model.displacement);
  check("heights", std::vector<double>{model.drop_height, model.contact_height});
  check("grasp_vertices", model.grasp_vertices);
  check("garment", model.garment_name);
  check("hash", std::to_string(model.garment_hash));
  check("controls", std::string("dtheta dr"));
  check("material", model.material);
  check("dataset", model.dataset);
  check("datasets", model.datasets[0].identity);
  check("seed", std::to_string(model.datasets[0].seed));
  check("fractions", std::vector<double>{0.04, 0.08});
  check("calibrated", model.calibrated[0].identity);
  check("calibrated seed", std::to_string(model.calibrated[0].seed));
  check("calibrated fractions", std::vector<double>{0.03, 0.07});
  check("provenance", model.provenance);
  check("training", model.training);
  check("input_mean", model.input_mean);
  check("calibration", model.calibration);
  check("calibration_added", model.calibration_added);
  check("scale", model.scale);
}

TEST(EmdModel, FilesOfEarlierSchemasAreRead) {
  const Folder folder;
  const auto old = WEFT_SOURCE_DIR "/tests/plugins/emd_model_1.h5";
  const Model model = load_model(old);
  EXPECT_EQ(model.dataset, "0123456789abcdef");
  EXPECT_TRUE(model.datasets.empty());
  TestHost host;
  Params params;
  params.model = old;
  EmdPredictor(params, host).bind(patch_task());
  save_model(folder / "new.h5", model, true);
  EXPECT_EQ(load_model(folder / "new.h5").weights, model.weights);
  const auto refusal = [&](const std::string& bytes) {
    std::ofstream(folder / "bad.h5", std::ios::binary) << bytes;
    return message_of<ConfigError>([&] { load_model(folder / "bad.h5"); });
  };
  EXPECT_THAT(refusal(with_changed_bit(bytes_of(old), model.mean)), HasSubstr("recorded checksum"));
  // Called the new one, it lacks the new checksum.
  std::string renamed = bytes_of(old);
  renamed.replace(renamed.find("emd model 1"), 11, "emd model 4");
  EXPECT_THAT(refusal(renamed), HasSubstr("recorded checksum"));
  // The second one had no added lengths.
  Model second = model;
  second.calibration_added.clear();
  save_model(folder / "second.h5", second, false);
  renamed = bytes_of(folder / "second.h5");
  renamed.replace(renamed.find("emd model 4"), 11, "emd model 2");
  std::ofstream(folder / "second.h5", std::ios::binary) << renamed;
  EXPECT_TRUE(load_model(folder / "second.h5").calibration_added.empty());
  // The third had them, but did not say what was calibrated on later.
  save_model(folder / "third.h5", model, false);
  renamed = bytes_of(folder / "third.h5");
  renamed.replace(renamed.find("emd model 4"), 11, "emd model 3");
  std::ofstream(folder / "third.h5", std::ios::binary) << renamed;
  EXPECT_EQ(load_model(folder / "third.h5").calibration_added, model.calibration_added);
  EXPECT_TRUE(load_model(folder / "third.h5").calibrated.empty());
  EXPECT_GT(load_model(WEFT_SOURCE_DIR "/configs/models/tshirt.h5").weights.size(), 1000000u);  // whichever it has
}

TEST(EmdModel, HostileContentIsRefusedWithTheReason) {
  const Folder folder;
  const Task task = patch_task();
  const auto refusal = [&](auto change) {
    Model model = untrained_model(small(), task, 1);
    change(model);
    save_model(folder / "m.h5", model, false);
    return message_of<ConfigError>([&] { load_model(folder / "m.h5"); });
  };
  EXPECT_THAT(refusal([](Model& m) { m.weights[7] = std::nanf(""); }), HasSubstr("not finite"));
  EXPECT_THAT(refusal([](Model& m) { m.scale[0] = 0.0f; }), HasSubstr("/normalisation/scale must be positive"));
  EXPECT_THAT(refusal([](Model& m) { m.input_sd[0] = -1.0f; }), HasSubstr("input_sd"));
  EXPECT_THAT(refusal([](Model& m) { m.calibration = {1.0f, 1.0f, 1.0f, -1.0f}; }), HasSubstr("/calibration"));
  EXPECT_THAT(refusal([](Model& m) { m.calibration_added[0] = -1.0f; }), HasSubstr("/calibration_added must be in"));
  EXPECT_THAT(refusal([](Model& m) { m.control_names.pop_back(); }), HasSubstr("/trajectory/controls"));
  EXPECT_THAT(refusal([](Model& m) { std::swap(m.control_low, m.control_high); }),
              HasSubstr("control_low of dtheta lies above control_high"));
  EXPECT_THAT(refusal([](Model& m) { m.control_low[1] = -INFINITY; }), HasSubstr("not finite"));
  EXPECT_THAT(refusal([](Model& m) { m.control_high.pop_back(); }), HasSubstr("must have 5 entries"));
  EXPECT_THAT(refusal([](Model& m) { m.datasets = {{"two words", 1, 0.1, 0.1}}; }), HasSubstr("/datasets/identities"));
  EXPECT_THAT(refusal([](Model& m) { m.input_mean.pop_back(); }), HasSubstr("/normalisation/input_mean has a shape"));
  auto file = Hdf5File::create(folder / "other.h5");
  file.write("/schema", std::string("weft session 1"));
  file.commit();
  EXPECT_THAT(message_of<ConfigError>([&] { load_model(folder / "other.h5"); }), HasSubstr("has the schema"));
}

// eq. 3: w = u^2, so that E w = 1/3 and E w^2 = 1/5; c - q = w v / 2 with v uniform in [-1, 1], so that its mean is 0
// and its variance E w^2 / 12.
TEST(EmdSampling, KnowledgeHasTheMomentsOfEquation3) {
  constexpr int kDraws = 20000;
  const double root = std::sqrt(kDraws);
  const MaterialProperties q(0.5, 0.02, 0.5, 1.0);
  RandomStream random(8);
  PropertyVector w = PropertyVector::Zero(), ww = w, d = w, dd = w, clipped = w;
  double ww01 = 0.0, dd02 = 0.0;
  for (int i = 0; i < kDraws; ++i) {
    const MaterialKnowledge k = sample_knowledge(q, 0.0, 0.0, random);
    ASSERT_TRUE((k.width.array() >= 0.0).all() && (k.width.array() <= 1.0).all());
    ASSERT_TRUE((k.centre.array() >= 0.0).all() && (k.centre.array() <= 1.0).all());
    const PropertyVector off = k.centre - q;
    ASSERT_TRUE((off.array().abs() <= 0.5 * k.width.array() + 1e-15).all());  // the interval holds the truth
    w += k.width;
    ww += k.width.cwiseAbs2();
    d += off;
    dd += off.cwiseAbs2();
    clipped.array() += (k.centre.array() == 0.0).cast<double>() + (k.centre.array() == 1.0).cast<double>();
    ww01 += (k.width[0] - 1.0 / 3.0) * (k.width[1] - 1.0 / 3.0);
    dd02 += off[0] * off[2];
  }
  for (Index p = 0; p < 4; ++p) {
    EXPECT_NEAR(w[p] / kDraws, 1.0 / 3.0, 5.0 * 0.3 / root);
    EXPECT_NEAR(ww[p] / kDraws, 0.2, 5.0 * 0.27 / root);
  }
  for (const Index p : {0, 2}) {  // in the middle nothing is clipped
    EXPECT_EQ(clipped[p], 0.0);
    EXPECT_NEAR(d[p] / kDraws, 0.0, 5.0 * std::sqrt(1.0 / 60.0) / root);
    EXPECT_NEAR(dd[p] / kDraws, 1.0 / 60.0, 5.0 * 0.034 / root);
  }
  EXPECT_NEAR(clipped[3], 0.5 * kDraws, 5.0 * 0.5 * root);  // at the edge half of the draws are
  EXPECT_GT(clipped[1], 0.3 * kDraws);
  EXPECT_LT(clipped[1], 0.5 * kDraws);
  EXPECT_NEAR(ww01 / kDraws, 0.0, 5.0 * 0.09 / root);  // each property has its own
  EXPECT_NEAR(dd02 / kDraws, 0.0, 5.0 / 60.0 / root);
}

TEST(EmdSampling, SharesOfKnowledgeStartsAndShapesAreThoseAskedFor) {
  constexpr int kDraws = 20000;
  Training t;
  t.start_share = 0.35;
  t.certain_share = 0.15;
  t.unknown_share = 0.1;
  t.max_steps = 6;
  t.decoded_steps = 3;
  Example e;
  e.q = MaterialProperties(0.2, 0.4, 0.6, 0.8);
  e.controls = Controls::Zero(10, 5);
  RandomStream random(9);
  std::array<int, 10> starts{};
  std::array<int, 7> decoded{};
  int certain = 0, unknown = 0, long_ones = 0;
  for (int i = 0; i < kDraws; ++i) {
    const Sequence s = sample_sequence(4, e, t, random);
    ASSERT_EQ(s.example, 4u);
    ++starts.at(static_cast<std::size_t>(s.start));
    ASSERT_EQ(s.steps, std::min<Index>(10 - s.start, 6));
    ASSERT_EQ(s.decoded.size(), std::min<std::size_t>(3, static_cast<std::size_t>(s.steps)));
    ASSERT_EQ(s.decoded.back(), s.steps);
    ASSERT_GE(s.decoded.front(), 1);
    ASSERT_EQ(std::adjacent_find(s.decoded.begin(), s.decoded.end(), std::greater_equal<>()), s.decoded.end());
    if (s.steps == 6) {
      ++long_ones;
      for (const Index j : s.decoded) ++decoded.at(static_cast<std::size_t>(j));
    }
    certain += s.knowledge.width.isZero(0.0) && s.knowledge.centre == e.q;
    unknown += s.knowledge.width.isOnes(0.0) && s.knowledge.centre.isConstant(0.5, 0.0);
  }
  const auto expect_share = [](int count, double share, int of) {
    EXPECT_NEAR(count, share * of, 5.0 * std::sqrt(of * share * (1.0 - share)));
  };
  expect_share(starts[0], 0.35 + 0.65 / 10.0, kDraws);
  for (std::size_t k = 1; k < 10; ++k) expect_share(starts[k], 0.65 / 10.0, kDraws);
  expect_share(certain, 0.15, kDraws);
  expect_share(unknown, 0.1, kDraws);
  for (std::size_t j = 1; j < 6; ++j) expect_share(decoded[j], 2.0 / 5.0, long_ones);  // besides the last, 2 of 5
}

#if WEFT_HAS_TORCH
Params small_and_quick() {
  Params params;
  params.architecture = small();
  params.training = quick();
  return params;
}

TEST(EmdTraining, LearnsTheSameBitsOnAnyNumberOfThreads) {
  const Folder folder;
  const Task task = patch_task();
  const Dataset data = toy_dataset(task, 60);
  TestHost host(1);
  Params params = small_and_quick();
  params.training.iterations = 200;
  std::vector<double> losses;
  const auto fit = [&](const std::string& name, Host& on) {
    EmdPredictor predictor(params, on);
    return predictor.trainable()->fit(data, task, {.seed = 4, .model = folder / name}, [&](const FitProgress& p) {
      losses.push_back(p.validation_loss);
      return true;
    });
  };
  const FitReport report = fit("a.h5", host);
  EXPECT_TRUE(report.finished);
  EXPECT_EQ(report.iterations, 200);
  const auto recorded = load_model(folder / "a.h5").datasets;
  ASSERT_EQ(recorded.size(), 1u);
  EXPECT_EQ(recorded[0].identity, data.header.identity);
  EXPECT_EQ(recorded[0].seed, data.header.seed);
  EXPECT_EQ(recorded[0].test_fraction, 0.15);
  EXPECT_LT(losses.back(), losses.front() - 0.5);
  TestHost more(3);
  fit("b.h5", more);
  EXPECT_EQ(bytes_of(folder / "a.h5"), bytes_of(folder / "b.h5"));

  // What it learned is worth something: better than the shape it starts from.
  params.model = folder / "a.h5";
  EmdPredictor predictor(params, host);
  predictor.bind(task);
  double error = 0.0, still = 0.0;
  for (const auto i : data.select(Split::test)) {
    const auto& e = data.examples[i];
    PredictionCase one = whole_example(data, i);
    one.segments = {e.segments()};
    const Positions truth = data.shape(i, e.segments());
    error += mean_distance_mm(predictor.predict({one}, {})->shapes()[0][0].mean, truth);
    still += mean_distance_mm(*one.shape, truth);
  }
  EXPECT_LT(error, 0.4 * still);
}

/// Shapes of 900 coordinates, two thirds with a sigma of 5 mm and one third, which lies on the ground, with 0.4 mm.
/// @param truth what the errors are to sigma. @param buckles share of the shapes where a twentieth of the ground stands
/// 8 mm off.
struct DrawnErrors {
  DrawnErrors(double truth, double buckles) {
    RandomStream random(17, 1);
    for (int shape = 0; shape < 500; ++shape) {
      const bool buckle = random.uniform() < buckles;
      for (Index c = 0; c < kCoordinates; ++c) {
        const bool ground = c % 3 == 2;
        const double s = ground ? 0.4e-3 : 5e-3;
        sigma.push_back(static_cast<float>(s) / kLength);
        const double e = buckle && ground && c % 60 == 2 ? 8e-3 : truth * s * random.normal();
        error.push_back(static_cast<float>(e) / kLength);
      }
      tally.add(&error[error.size() - kCoordinates], &sigma[sigma.size() - kCoordinates], kCoordinates);
    }
  }
  /// Mean normalised squared error and share within one sigma.
  std::pair<double, double> rate(const SigmaTally::Choice& choice) const {
    double square = 0.0, inside = 0.0;
    for (std::size_t k = 0; k < error.size(); ++k) {
      const double z = std::abs(error[k]) / (choice.factor * std::hypot(sigma[k], choice.added));
      square += z * z;
      inside += z < 1.0;
    }
    return {square / static_cast<double>(error.size()), inside / static_cast<double>(error.size())};
  }
  static constexpr Index kCoordinates = 900;
  std::vector<float> error, sigma;
  SigmaTally tally;
};

TEST(EmdCalibration, NormalErrorsGetTheirFactorAlone) {
  for (const double truth : {0.7, 1.0, 1.6}) {
    const SigmaTally::Choice choice = DrawnErrors(truth, 0.0).tally.choose();
    EXPECT_NEAR(choice.factor, truth, 0.04 * truth);
    EXPECT_EQ(choice.added, 0.0f);
  }
}

TEST(EmdCalibration, TailsThatNoFactorMendsAreTakenByALength) {
  const DrawnErrors drawn(1.0, 0.1);
  const SigmaTally::Choice choice = drawn.tally.choose();
  EXPECT_GT(choice.added, 0.0f);
  const auto [nse, coverage] = drawn.rate(choice);
  EXPECT_GT(nse, 0.8);
  EXPECT_LT(nse, 1.25);
  EXPECT_GT(coverage, 0.62);
  EXPECT_LT(coverage, 0.74);
  for (float factor = 0.8f; factor < 2.0f; factor *= 1.05f) {
    const auto [square, inside] = drawn.rate({factor, 0.0f});
    EXPECT_TRUE(square > 1.25 || inside > 0.74) << factor << ": " << square << ", " << inside;
  }
}

TEST(EmdCalibration, OneFoldThatEndedUpElsewhereDecidesNothing) {
  DrawnErrors drawn(1.0, 0.0);
  const SigmaTally::Choice before = drawn.tally.choose();
  std::vector<float> elsewhere(drawn.error.begin(), drawn.error.begin() + DrawnErrors::kCoordinates);
  for (float& e : elsewhere) e *= 20.0f;  // alone it adds 0.8 to the mean squared error over sigma
  drawn.tally.add(elsewhere.data(), drawn.sigma.data(), DrawnErrors::kCoordinates);
  const SigmaTally::Choice after = drawn.tally.choose();
  EXPECT_NEAR(after.factor, before.factor, 0.06);
  EXPECT_EQ(after.added, before.added);
}

// Fitted to few examples sigma is too small for others; the factors from the validation split mend that on the test
// split.
TEST(EmdTraining, CalibrationBringsSigmaToTheErrorsOfUnseenExamples) {
  const Folder folder;
  const Task task = patch_task();
  const Dataset data = toy_dataset(task, 200);
  TestHost host;
  Params params = small_and_quick();
  params.training.iterations = 600;
  params.training.max_examples = 20;
  params.training.average = 0.0;
  params.training.evaluate_every = 600;  // the last weights, over-fitted as they are, and not the best ones
  struct Rating {
    double nse = 0.0, coverage = 0.0;
  };
  const auto rate = [&](bool calibrate) {
    Params one = params;
    one.training.calibrate = calibrate;
    const auto model = folder / (calibrate ? "with.h5" : "without.h5");
    EmdPredictor(one, host).fit(data, task, {.seed = 4, .model = model}, [](const FitProgress&) { return true; });
    one.model = model;
    EmdPredictor predictor(one, host);
    predictor.bind(task);
    Rating rating;
    double count = 0.0;
    for (const auto i : data.select(Split::test)) {
      const auto& e = data.examples[i];
      PredictionCase start = whole_example(data, i);
      for (Index j = 1; j <= e.segments(); ++j) start.segments.push_back(j);
      const auto prediction = predictor.predict({start}, {});
      for (Index j = 1; j <= e.segments(); ++j) {
        const auto& shape = prediction->shapes()[0][static_cast<std::size_t>(j) - 1];
        const auto z = ((data.shape(i, j) - shape.mean).array() / shape.sigma.array()).abs().eval();
        rating.nse += z.square().mean();
        rating.coverage += (z < 1.0).cast<double>().mean();
        ++count;
      }
    }
    return Rating{rating.nse / count, rating.coverage / count};
  };
  const Rating without = rate(false), with = rate(true);
  EXPECT_GT(without.nse, 1.6);
  EXPECT_LT(std::abs(std::log(with.nse)), 0.5 * std::abs(std::log(without.nse)));
  EXPECT_LT(std::abs(with.coverage - 0.683), std::abs(without.coverage - 0.683));
}

/// A model fitted to toy_dataset(task, 60), in folder/fitted.h5, and a predictor's parameters with it.
Params fitted(const Folder& folder, const Task& task, std::int64_t iterations = 60, bool half_precision = true) {
  TestHost host;
  Params params = small_and_quick();
  params.training.iterations = iterations;
  params.training.half_precision = half_precision;
  EmdPredictor(params, host)
      .fit(toy_dataset(task, 60), task, {.seed = 4, .model = folder / "fitted.h5"},
           [](const FitProgress&) { return true; });
  params.training.half_precision = true;
  params.training.sigma_passes = 0;  // the sigma layer's own fit has tests of its own
  params.model = folder / "fitted.h5";
  return params;
}

// A model whose sigma is three times too small, and 40 mm too large within sessions, comes back on the examples of a
// seed that it has never seen; nothing but the calibration is another.
TEST(EmdRecalibration, BringsAWrongSigmaToTheErrorsOfUnseenExamples) {
  const Folder folder;
  const Task task = patch_task();
  TestHost host;
  Params params = fitted(folder, task, 300);
  Model wrong = load_model(params.model);
  const std::size_t half = wrong.calibration.size() / 2;
  for (std::size_t i = 0; i < 2 * half; ++i) {
    wrong.calibration[i] *= i < half ? 0.33f : 1.0f;
    wrong.calibration_added[i] = i < half ? 0.0f : 0.4f;
  }
  params.model = folder / "wrong.h5";
  save_model(params.model, wrong, true);
  const Dataset fresh = toy_dataset(task, 300, 2);

  struct Rating {
    double nse = 0.0, coverage = 0.0, count = 0.0;
  };
  const auto rate = [&](const std::filesystem::path& file, bool within, bool known) {
    Params one = params;
    one.model = file;
    EmdPredictor predictor(one, host);
    predictor.bind(task);
    Rating rating;
    for (const auto i : fresh.select(Split::test)) {
      const auto& e = fresh.examples[i];
      for (Index start = within ? 1 : 0; start < (within ? e.segments() : 1); ++start) {
        PredictionCase from = whole_example(fresh, i);
        if (!known) from.knowledge = MaterialKnowledge::none();
        from.controls = e.controls.bottomRows(e.segments() - start);
        from.state = e.states.row(start).transpose();
        from.shape = std::make_shared<const Positions>(fresh.shape(i, start));
        if (within) from.previous = std::make_shared<const Positions>(fresh.shape(i, start - 1));
        for (Index j = 1; j <= e.segments() - start; ++j) from.segments.push_back(j);
        const auto prediction = predictor.predict({from}, {});
        for (Index j = 1; j <= e.segments() - start; ++j, ++rating.count) {
          const auto& shape = prediction->shapes()[0][static_cast<std::size_t>(j) - 1];
          const auto z = ((fresh.shape(i, start + j) - shape.mean).array() / shape.sigma.array()).abs().eval();
          rating.nse += z.square().mean();
          rating.coverage += (z < 1.0).cast<double>().mean();
        }
      }
    }
    return Rating{rating.nse / rating.count, rating.coverage / rating.count, rating.count};
  };

  EmdPredictor predictor(params, host);
  predictor.bind(task);
  const auto examples = unseen_examples(fresh, predictor.trained_on());
  EXPECT_EQ(examples.size(), 300 - fresh.select(Split::test).size());
  const CalibrationReport report =
      predictor.calibrate(fresh, examples, task, {.seed = 5, .model = folder / "right.h5"});
  EXPECT_EQ(report.examples, static_cast<std::int64_t>(examples.size()));
  ASSERT_EQ(report.rows.size(), 4u);
  for (const bool within : {false, true}) {
    for (const bool known : {true, false}) {
      const Rating before = rate(params.model, within, known), after = rate(folder / "right.h5", within, known);
      SCOPED_TRACE(std::to_string(within) + std::to_string(known) + " " + std::to_string(before.nse) + " -> " +
                   std::to_string(after.nse) + ", " + std::to_string(before.coverage) + " -> " +
                   std::to_string(after.coverage) + ", " + std::to_string(after.count));
      EXPECT_TRUE(before.nse < 0.3 || before.nse > 4.0);
      EXPECT_GT(after.nse, 0.7);
      EXPECT_LT(after.nse, 1.4);
      EXPECT_GT(after.coverage, 0.6);
      EXPECT_LT(after.coverage, 0.83);  // the toy's errors have tails that no length takes
    }
  }
  // The predictor holds what it wrote; and all but the calibration is what it was.
  const Model right = load_model(folder / "right.h5");
  EXPECT_NE(right.calibration, wrong.calibration);
  ASSERT_EQ(right.calibrated.size(), 1u);
  EXPECT_EQ(right.calibrated[0].identity, fresh.header.identity);
  ASSERT_EQ(predictor.calibrated_on().size(), 1u);
  ASSERT_EQ(right.datasets.size(), 1u);
  EXPECT_EQ(right.datasets[0].identity, wrong.datasets[0].identity);
  Model back = right;
  back.calibration = wrong.calibration;
  back.calibration_added = wrong.calibration_added;
  back.calibrated.clear();
  save_model(folder / "back.h5", back, true);
  EXPECT_EQ(bytes_of(folder / "back.h5"), bytes_of(folder / "wrong.h5"));
  // Found on the same examples, whatever it was before.
  params.model = folder / "fitted.h5";
  EmdPredictor(params, host).calibrate(fresh, examples, task, {.seed = 5, .model = folder / "again.h5"});
  EXPECT_EQ(bytes_of(folder / "again.h5"), bytes_of(folder / "right.h5"));
}

TEST(EmdRecalibration, WeightsOfFullPrecisionStayWhole) {
  const Folder folder;
  const Task task = patch_task();
  TestHost host;
  const Params params = fitted(folder, task, 60, false);
  const Model before = load_model(params.model);
  ASSERT_FALSE(fits_half(before));
  const Dataset fresh = toy_dataset(task, 20, 2);
  EmdPredictor predictor(params, host);
  predictor.calibrate(fresh, unseen_examples(fresh, before.datasets), task, {.seed = 5, .model = folder / "new.h5"});
  const Model after = load_model(folder / "new.h5");
  EXPECT_EQ(after.weights, before.weights);
  EXPECT_EQ(after.basis, before.basis);
}

// A prediction within a session begins where there is a shape before: never with the first one.
TEST(EmdRecalibration, StartsWithinASessionAreNeverItsFirstShape) {
  const Folder folder;
  const Task task = patch_task();
  TestHost host;
  const Params params = fitted(folder, task);
  Dataset fresh = toy_dataset(task, 40, 2);
  const auto width = static_cast<std::size_t>(3 * fresh.header.vertices);
  for (auto& e : fresh.examples) {  // a third of one segment, the others of two
    const Index k = e.index % 3 == 0 ? 1 : 2;
    e.controls = e.controls.topRows(k).eval();
    e.states = e.states.topRows(k + 1).eval();
    e.targets = e.targets.topRows(k + 1).eval();
    e.shapes.resize(static_cast<std::size_t>(k + 1) * width);
    e.released = false;
  }
  EmdPredictor predictor(params, host);
  predictor.bind(task);
  const auto examples = unseen_examples(fresh, predictor.trained_on());
  const auto longer =
      std::count_if(examples.begin(), examples.end(), [&](std::size_t i) { return fresh.examples[i].segments() == 2; });
  const auto report = predictor.calibrate(fresh, examples, task, {.seed = 5});
  for (const auto& row : report.rows) {
    if (row.from_start) {
      EXPECT_EQ(row.predictions, static_cast<std::int64_t>(examples.size()));
      EXPECT_EQ(row.shapes, (std::vector<std::int64_t>{row.predictions, longer}));
    } else {
      EXPECT_EQ(row.predictions, 4 * longer);
      EXPECT_EQ(row.shapes, (std::vector<std::int64_t>{4 * longer}));
    }
  }
}

TEST(EmdRecalibration, TheFirstDatasetDecidesAndOthersFillIn) {
  const Folder folder;
  const Task task = patch_task();
  TestHost host;
  const Params params = fitted(folder, task);
  const Dataset calm = toy_dataset(task, 200, 2);
  Dataset wild = toy_dataset(task, 200, 3);
  RandomStream random(6);
  for (auto& e : wild.examples) {
    for (float& x : e.shapes) x += static_cast<float>(0.05 * random.normal());
  }
  const auto rows = [&](const Dataset& first, const Dataset* second) {
    Dataset all = first;
    if (second != nullptr) append_dataset(all, *second);
    EmdPredictor predictor(params, host);
    predictor.bind(task);
    return predictor.calibrate(all, unseen_examples(all, predictor.trained_on()), task, {.seed = 5}).rows;
  };
  const auto alone = rows(calm, nullptr), with_wild = rows(calm, &wild), wild_first = rows(wild, &calm);
  for (const std::size_t row : {0u, 1u}) {  // from the start: every example has one
    EXPECT_EQ(with_wild[row].factor[0], alone[row].factor[0]);
    EXPECT_EQ(with_wild[row].added_m[0], alone[row].added_m[0]);
    EXPECT_EQ(with_wild[row].shapes[0], alone[row].shapes[0]);
    EXPECT_GT(wild_first[row].factor[0] * (1e-3 + wild_first[row].added_m[0]),
              2.0 * alone[row].factor[0] * (1e-3 + alone[row].added_m[0]));
  }
  // Few have the most segments: there the wild ones are heard.
  const auto& longest = with_wild[0];
  EXPECT_LT(longest.shapes.back(), 20);
  EXPECT_GT(longest.factor.back() * (1e-3 + longest.added_m.back()),
            alone[0].factor.back() * (1e-3 + alone[0].added_m.back()));
}

/// Mean and sigma of every shape of the test split, from its start with exact knowledge, without any calibration.
struct Predicted {
  std::vector<Positions> mean, sigma;
  Predicted(const std::filesystem::path& file, const Params& params, const Dataset& data, const Task& task) {
    TestHost host;
    const Folder folder;
    Model model = load_model(file);
    model.calibration.assign(4, 1.0f);
    model.calibration_added.clear();
    save_model(folder / "plain.h5", model, false);
    Params plain = params;
    plain.model = folder / "plain.h5";
    EmdPredictor predictor(plain, host);
    predictor.bind(task);
    for (const auto i : data.select(Split::test)) {
      PredictionCase start = whole_example(data, i);
      for (Index j = 1; j <= data.examples[i].segments(); ++j) start.segments.push_back(j);
      const auto prediction = predictor.predict({start}, {});
      for (Index j = 1; j <= data.examples[i].segments(); ++j) {
        const auto& shape = prediction->shapes()[0][static_cast<std::size_t>(j) - 1];
        mean.push_back(shape.mean);
        sigma.push_back(shape.sigma);
      }
    }
  }
  /// Mean log sigma of an axis over all vertices and shapes.
  double log_sigma(Index axis) const {
    double sum = 0.0;
    for (const auto& s : sigma) sum += s.col(axis).array().log().mean();
    return sum / static_cast<double>(sigma.size());
  }
};

// Sigma that is wrong in a way that no factor mends, too small along x and too large along z, comes back; every mean
// and every other weight is the same bit for bit.
TEST(EmdSigmaLayer, IsFittedAnewAndNoMeanMoves) {
  const Folder folder;
  const Task task = patch_task();
  TestHost host(1), more(3);
  Params params = fitted(folder, task, 300);
  Model wrong = load_model(params.model);
  const Layout layout(wrong.architecture, wrong.dimensions);
  const auto& bias = layout.weights[static_cast<std::size_t>(layout.sigma_bias)];
  for (std::size_t c = 0; c < bias.size(); ++c)
    wrong.weights[bias.offset + c] = round_to_half(wrong.weights[bias.offset + c] + (c % 3 == 0   ? -0.5f
                                                                                     : c % 3 == 2 ? 0.5f
                                                                                                  : 0.0f));
  params.model = folder / "wrong.h5";
  save_model(params.model, wrong, true);
  const Dataset fresh = toy_dataset(task, 150, 2);
  params.training.sigma_passes = 100;
  EmdPredictor predictor(params, host);
  predictor.bind(task);
  const auto examples = unseen_examples(fresh, predictor.trained_on());
  const CalibrationReport report =
      predictor.calibrate(fresh, examples, task, {.seed = 5, .model = folder / "right.h5"});
  const auto told = nlohmann::json::parse(report.json).at("sigma_layer");
  EXPECT_TRUE(told.at("fitted").get<bool>());
  EXPECT_LT(told.at("held_out_loss").at("after").get<double>(),
            told.at("held_out_loss").at("before").get<double>() - 0.1);

  const Predicted before(params.model, params, fresh, task), after(folder / "right.h5", params, fresh, task),
      truth(folder / "fitted.h5", params, fresh, task);
  ASSERT_GT(before.mean.size(), 100u);
  EXPECT_EQ(before.mean, after.mean);
  const auto slant = [](const Predicted& p) { return p.log_sigma(2) - p.log_sigma(0); };
  EXPECT_GT(slant(before) - slant(truth), 0.7);  // 1, but for sigma's floor
  EXPECT_NEAR(slant(after), slant(truth), 0.2);
  Model back = load_model(folder / "right.h5");
  EXPECT_TRUE(fits_half(back));
  const auto& matrix = layout.weights[static_cast<std::size_t>(layout.sigma)];
  for (const auto* of : {&bias, &matrix})
    std::copy_n(wrong.weights.begin() + static_cast<std::ptrdiff_t>(of->offset), of->size(),
                back.weights.begin() + static_cast<std::ptrdiff_t>(of->offset));
  EXPECT_EQ(back.weights, wrong.weights);
  // The same bits on any number of threads.
  EmdPredictor(params, more).calibrate(fresh, examples, task, {.seed = 5, .model = folder / "again.h5"});
  EXPECT_EQ(bytes_of(folder / "again.h5"), bytes_of(folder / "right.h5"));
}

// Heights that are now and then far off: the more the fourth moment counts, the wider is their sigma, and theirs alone.
TEST(EmdSigmaLayer, TailsMakeSigmaWiderWhereTheyAre) {
  const Folder folder;
  const Task task = patch_task();
  TestHost host;
  Params params = fitted(folder, task, 300);
  Dataset fresh = toy_dataset(task, 100, 2);
  RandomStream random(6);
  for (auto& e : fresh.examples) {
    for (std::size_t c = 0; c < e.shapes.size(); ++c)
      e.shapes[c] += static_cast<float>(random.normal() * (c % 3 == 2 && random.uniform() < 0.02 ? 0.1 : 0.005));
  }
  double log_sigma[2][2];
  for (const bool has_tails : {false, true}) {
    params.training.sigma_passes = 400;
    params.training.sigma_tails = has_tails ? 0.3 : 0.0;
    EmdPredictor predictor(params, host);
    predictor.bind(task);
    predictor.calibrate(fresh, unseen_examples(fresh, predictor.trained_on()), task,
                        {.seed = 5, .model = folder / "new.h5"});
    const Predicted now(folder / "new.h5", params, fresh, task);
    for (const int axis : {0, 1}) log_sigma[has_tails][axis] = now.log_sigma(axis == 0 ? 0 : 2);
  }
  const double x = log_sigma[true][0] - log_sigma[false][0], z = log_sigma[true][1] - log_sigma[false][1];
  SCOPED_TRACE(std::to_string(x) + " " + std::to_string(z));
  EXPECT_NEAR(x, 0.0, 0.12);
  EXPECT_GT(z, x + 0.1);
}

// What makes held-out examples no likelier is left alone, and so is a layer with next to nothing to fit it to.
TEST(EmdSigmaLayer, StaysWhenItsFitIsNoBetter) {
  const Folder folder;
  const Task task = patch_task();
  TestHost host;
  Params params = fitted(folder, task, 300);
  const auto weights = load_model(params.model).weights;
  const Dataset fresh = toy_dataset(task, 60, 2);
  const auto fitted_to = [&](std::size_t count) {
    EmdPredictor predictor(params, host);
    predictor.bind(task);
    auto examples = unseen_examples(fresh, predictor.trained_on());
    examples.resize(count);
    const auto report = predictor.calibrate(fresh, examples, task, {.seed = 5, .model = folder / "new.h5"});
    EXPECT_EQ(load_model(folder / "new.h5").weights, weights);
    return nlohmann::json::parse(report.json).at("sigma_layer");
  };
  params.training.sigma_passes = 4000;  // six examples, again and again
  const auto told = fitted_to(6);
  EXPECT_FALSE(told.at("fitted").get<bool>());
  EXPECT_GT(told.at("held_out_loss").at("after").get<double>(), told.at("held_out_loss").at("before").get<double>());
  EXPECT_FALSE(fitted_to(5).contains("held_out_loss"));
  params.training.sigma_passes = 0;
  EXPECT_FALSE(fitted_to(40).at("fitted").get<bool>());
}

TEST(EmdRecalibration, WhatCannotBeCalibratedIsRefused) {
  const Folder folder;
  const Task task = patch_task();
  TestHost host;
  const Dataset fresh = toy_dataset(task, 20, 2);
  const auto refusal = [&](const Params& params, const Task& on, const std::vector<std::size_t>& examples) {
    const std::string message = message_of<ConfigError>(
        [&] { EmdPredictor(params, host).calibrate(fresh, examples, on, {.seed = 5, .model = folder / "none.h5"}); });
    EXPECT_FALSE(std::filesystem::exists(folder / "none.h5"));
    return message;
  };
  Params params = small_and_quick();
  EXPECT_THAT(refusal(params, task, {0}), HasSubstr("needs a model file"));
  params.untrained = true;
  EXPECT_THAT(refusal(params, task, {0}), HasSubstr("random weights"));
  params = fitted(folder, task);
  EXPECT_THAT(refusal(params, task, {}), HasSubstr("no example"));
  EXPECT_THAT(refusal(params, patch_task(6), {0}), HasSubstr("the garment"));
  /// One that learns and cannot do that.
  struct Plain final : TrainablePredictor {
    FitReport fit(const Dataset&, const Task&, const FitOptions&, const FitObserver&) override { return {}; }
    void save(const std::filesystem::path&) const override {}
    void load(const std::filesystem::path&) override {}
  } plain;
  EXPECT_THAT(message_of<ConfigError>([&] { plain.calibrate(fresh, {0}, task, {}); }), HasSubstr("cannot calibrate"));
}

TEST(EmdTraining, TheBestModelSoFarCanBeUsedMeanwhile) {
  const Folder folder;
  const Task task = patch_task();
  TestHost host(1);
  Params params = small_and_quick();
  int loaded = 0;
  EmdPredictor(params, host)
      .fit(toy_dataset(task, 40), task, {.seed = 4, .model = folder / "model.h5"}, [&](const FitProgress& p) {
        if (p.iteration < params.training.iterations && std::filesystem::exists(folder / "model.h5")) {
          Params with_model = params;
          with_model.model = folder / "model.h5";
          EmdPredictor(with_model, host).bind(task);
          ++loaded;
        }
        return true;
      });
  EXPECT_GT(loaded, 0);
}

TEST(EmdTraining, AStoppedFitGoesOnToTheSameBits) {
  const Folder folder;
  const Task task = patch_task();
  const Dataset data = toy_dataset(task, 40);
  TestHost host(1);
  for (const char* optimiser : {"adam", "signsgd"}) {
    Params params = small_and_quick();
    params.training.optimiser = optimiser;
    if (params.training.optimiser == "signsgd") params.training.rate = 1e-3;
    const auto fit = [&](const std::string& name, std::int64_t stop_at) {
      EmdPredictor predictor(params, host);
      FitOptions options{.seed = 4, .model = folder / (name + ".h5"), .checkpoint = folder / (name + ".checkpoint.h5")};
      return predictor.fit(data, task, options, [&](const FitProgress& p) { return p.iteration < stop_at; });
    };
    fit("whole", 1000);
    const FitReport first = fit("parts", 20);
    EXPECT_FALSE(first.finished);
    EXPECT_EQ(first.iterations, 20);
    const FitReport second = fit("parts", 1000);
    EXPECT_TRUE(second.finished);
    EXPECT_TRUE(second.resumed);
    EXPECT_EQ(bytes_of(folder / "whole.h5"), bytes_of(folder / "parts.h5")) << optimiser;
    EXPECT_FALSE(std::filesystem::exists(folder / "parts.checkpoint.h5"));

    fit("other", 20);
    params.training.rate *= 2;
    EXPECT_THAT(message_of<ConfigError>([&] { fit("other", 1000); }),
                HasSubstr("belongs to a fit with other settings"));
    std::filesystem::remove(folder / "other.checkpoint.h5");
  }
}

// One iteration moves every weight by the rate, one way or the other, or not at all. With two voters both must agree:
// then they move it as their summed gradient would, and else it stays. Of three, two can outvote the sum.
TEST(EmdTraining, SignSgdMovesByTheMajorityOfSigns) {
  const Folder folder;
  const Task task = patch_task();
  const Dataset data = toy_dataset(task, 40);
  TestHost host(1);
  Params params = small_and_quick();
  auto& t = params.training;
  t.optimiser = "signsgd";
  t.iterations = 1;
  t.rate = 1.0 / 1024.0;
  t.average = 0.0;
  t.half_precision = false;
  const auto moves = [&](std::int64_t votes) {
    t.votes = votes;
    EmdPredictor(params, host).fit(data, task, {.seed = 4, .model = folder / "m.h5"}, {});
    const Model model = load_model(folder / "m.h5");
    std::vector<float> before;
    draw_weights(Layout(model.architecture, model.dimensions), 4, before);
    std::vector<int> moved;
    for (std::size_t i = 0; i < before.size(); ++i) {
      const float step = (model.weights[i] - before[i]) * 1024.0f;
      moved.push_back(static_cast<int>(std::lround(step)));
      EXPECT_NEAR(step, static_cast<float>(moved.back()), 1e-3f);
      EXPECT_LE(std::abs(moved.back()), 1);
    }
    return moved;
  };
  const auto one = moves(1), two = moves(2), three = moves(3);
  std::size_t moving = 0, undecided = 0, turned = 0, outvoted = 0;
  for (std::size_t i = 0; i < one.size(); ++i) {
    if (one[i] == 0) continue;
    ++moving;
    undecided += two[i] == 0;
    turned += two[i] == -one[i];
    outvoted += three[i] == -one[i];
  }
  const auto share = [&](std::size_t n) { return static_cast<double>(n) / static_cast<double>(moving); };
  EXPECT_GT(moving, one.size() / 2);
  EXPECT_GT(share(undecided), 0.05);
  EXPECT_LT(share(undecided), 0.95);
  EXPECT_LT(share(turned), 1e-3);  // the sums of two and of one differ by rounding
  EXPECT_GT(share(outvoted), 0.01);
  EXPECT_LT(share(outvoted), 0.5);
}

// Over-fitted to three examples, the loss on others soon rises: the rate is halved, the fit ends early, and what is
// kept is the best model and not the last one.
TEST(EmdTraining, SignSgdHalvesItsRateStopsEarlyAndKeepsTheBest) {
  const Folder folder;
  const Task task = patch_task();
  const Dataset data = toy_dataset(task, 40);
  TestHost host(1);
  Params params = small_and_quick();
  auto& t = params.training;
  t.optimiser = "signsgd";
  t.iterations = 2000;
  t.max_examples = 3;
  t.evaluate_every = 4;
  t.rate = 2e-3;
  t.average = 0.0;
  t.patience = 2;
  t.stop_after = 5;
  const auto fit = [&](const std::string& name) {
    return EmdPredictor(params, host).fit(data, task, {.seed = 4, .model = folder / name}, {});
  };
  const FitReport report = fit("early.h5");
  EXPECT_TRUE(report.finished);
  const auto json = nlohmann::json::parse(report.json);
  EXPECT_EQ(json.at("stopped_by"), "early_stop");
  ASSERT_LT(report.iterations, 2000);

  // What its curve says should have happened.
  double best = std::numeric_limits<double>::infinity(), rate = t.rate;
  std::int64_t best_iteration = 0, without = 0, halvings = 0;
  for (const auto& point : json.at("curve")) {
    EXPECT_LT(without, t.stop_after);
    const double loss = point.at("validation_loss");
    if (loss < best) {
      best = loss;
      best_iteration = point.at("iteration");
      without = 0;
    } else if (++without % t.patience == 0) {
      rate *= 0.5;
      ++halvings;
    }
    EXPECT_DOUBLE_EQ(point.at("rate").get<double>(), rate) << point;
  }
  EXPECT_EQ(without, t.stop_after);
  EXPECT_GE(halvings, 2);
  EXPECT_EQ(json.at("best").at("iteration"), best_iteration);
  EXPECT_EQ(json.at("best").at("validation_loss"), best);
  EXPECT_EQ(report.best_loss, best);
  EXPECT_EQ(report.iterations, best_iteration + t.stop_after * t.evaluate_every);

  // SignSGD knows nothing of the planned length: a fit that ends there gives the file that was kept.
  t.iterations = best_iteration;
  fit("until_best.h5");
  EXPECT_EQ(bytes_of(folder / "early.h5"), bytes_of(folder / "until_best.h5"));
}

TEST(EmdTraining, RefusesDataThatDoNotDo) {
  const Task task = patch_task();
  TestHost host(1);
  Params params;
  params.training = quick();
  EmdPredictor predictor(params, host);
  const Dataset data = toy_dataset(task, 40);
  EXPECT_THAT(message_of<ConfigError>([&] { predictor.fit(data, task, {}, {}); }),
              HasSubstr("architecture.latent = 192"));
  Dataset none = data;
  none.examples.clear();
  EXPECT_THAT(message_of<ConfigError>([&] { predictor.fit(none, task, {}, {}); }), HasSubstr("train split"));
}
#else
TEST(EmdTraining, SaysWhatIsMissing) {
  EXPECT_THAT(message_of<Unsupported>([] { training_function("weft_emd_fit"); }), HasSubstr("without libtorch"));
}
#endif

}  // namespace
}  // namespace weft::emd
