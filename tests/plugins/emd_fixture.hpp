#pragma once
// Shared by the tests of the learned predictor: a small garment, quick settings, and a dataset made without simulator.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <fstream>
#include <functional>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "learning/dataset_files.hpp"
#include "learning/generate.hpp"
#include "predictor/emd/emd.hpp"
#include "predictor/emd/model_file.hpp"
#include "predictor/emd/training_library.hpp"
#include "trajectory/arc/arc.cpp"  // compiled in, as the predictor's objects are
#include "unit/test_support.hpp"

namespace weft::emd {

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

inline Task patch_task(Index columns = 5) {
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

inline Architecture small() {
  Architecture a;
  a.latent = 20;
  a.memory = 7;
  a.hidden = 33;
  a.encoder_hidden = 21;
  a.decoder_hidden = 26;
  return a;
}

/// Folds that obey a simple rule: the grasped half follows the hands, the faster the stiffer; release flattens it.
inline Dataset toy_dataset(const Task& task, std::int64_t count, std::uint64_t seed = 1) {
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
inline PredictionCase whole_example(const Dataset& data, std::size_t i) {
  const auto& e = data.examples[i];
  PredictionCase one;
  one.shape = std::make_shared<const Positions>(data.shape(i, 0));
  one.state = e.states.row(0).transpose();
  one.controls = e.controls;
  one.knowledge = MaterialKnowledge::certain(e.q);
  return one;
}

inline Training quick() {
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

inline Params small_and_quick() {
  Params params;
  params.architecture = small();
  params.training = quick();
  return params;
}

inline std::string bytes_of(const std::filesystem::path& file) {
  std::ifstream stream(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), {}};
}

}  // namespace weft::emd
