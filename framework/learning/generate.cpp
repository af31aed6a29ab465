#include "learning/generate.hpp"

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <mutex>

#include "learning/dataset_files.hpp"
#include "sdk/fingerprint.hpp"
#include "simulation/fold.hpp"

namespace weft {

namespace fs = std::filesystem;

DatasetHeader make_dataset_header(const Task& task, const DataParams& params, std::uint64_t seed,
                                  const ConfigNode& resolved, const std::string& provenance) {
  DatasetHeader h;
  h.config = resolved.to_yaml();
  h.provenance = provenance;
  h.seed = seed;
  h.garment_name = task.garment->name;
  h.garment_hash = task.garment->hash;
  h.vertices = task.garment->vertex_count();
  for (const auto& v : task.trajectory->controls()) h.control_names.push_back(v.name);
  for (const auto& v : task.trajectory->state()) h.state_names.push_back(v.name);
  h.controls = static_cast<Index>(h.control_names.size());
  h.states = static_cast<Index>(h.state_names.size());
  h.hands = task.trajectory->hands();
  h.shard_examples = params.shard_examples;
  h.validation_fraction = params.validation_fraction;
  h.test_fraction = params.test_fraction;
  Fingerprint f;
  f.add(h.config);
  f.add_values(&h.seed, 1);
  f.add_values(&h.garment_hash, 1);
  h.identity = f.hex();
  return h;
}

Example make_example(Simulator& simulator, const Task& task, const DataParams& params, std::uint64_t seed,
                     std::int64_t index) {
  const RandomStream streams(seed, 0x6578616d706c65ull, static_cast<std::uint64_t>(index));
  Example example;
  example.index = index;
  RandomStream material = streams.child(0);
  for (Index p = 0; p < 4; ++p) example.q(p) = material.uniform();
  RandomStream random = streams.child(1);
  const double amplitude = random.uniform(params.amplitude_low, std::max(params.amplitude_low, params.amplitude_high));
  RandomControlsParams distribution = params.distribution;
  distribution.drift *= amplitude;
  distribution.walk *= amplitude;
  Controls controls = random_controls(*task.trajectory, params.max_segments, distribution, random);
  const auto variables = task.trajectory->controls();
  RandomStream jitter = streams.child(2);
  for (Index j = 0; j < controls.rows(); ++j) {
    for (Index c = 0; c < controls.cols(); ++c) {
      const auto& v = variables[static_cast<std::size_t>(c)];
      controls(j, c) =
          std::clamp(controls(j, c) + amplitude * params.jitter * v.scale * jitter.normal(), v.lower, v.upper);
    }
  }
  FoldResult fold;
  try {
    fold = simulate_fold(simulator, task, example.q, controls);
  } catch (const Error& error) {
    example.failure = error.what();
    if (example.failure.empty()) example.failure = "failed";
    example.controls.resize(0, controls.cols());
    return example;
  }
  example.controls = controls.topRows(fold.segments);
  example.states = fold.states;
  example.targets.resize(fold.segments + 1, 3 * task.trajectory->hands());
  for (Index j = 0; j <= fold.segments; ++j) {
    const Positions targets = task.trajectory->targets(task.manipulation, fold.states.row(j).transpose());
    example.targets.row(j) = Eigen::Map<const Vector>(targets.data(), targets.size()).transpose();
  }
  for (const auto& shape : fold.shapes) {
    for (Index i = 0; i < shape.size(); ++i) example.shapes.push_back(static_cast<float>(shape.data()[i]));
  }
  example.released = fold.released;
  example.settle = fold.settle;
  example.max_grasp_strain = fold.max_grasp_strain;
  return example;
}

GenerateReport generate_dataset(const Task& task, const DataParams& params, const DatasetHeader& header,
                                const GenerateOptions& options, Host& host, const GenerateProgress& progress) {
  const auto started = std::chrono::steady_clock::now();
  GenerateReport report;
  fs::create_directories(options.folder);
  // A run that was killed leaves its temporary file. Those of other parts may be in the making.
  for (const auto& entry : fs::directory_iterator(options.folder)) {
    long long number = 0;
    int used = 0;
    const auto name = entry.path().filename().string();
    if (std::sscanf(name.c_str(), "shard-%lld.h5.tmp%n", &number, &used) == 1 && used > 0 &&
        number % options.shard_count == options.shard_index)
      fs::remove(entry.path());
  }
  const std::int64_t size = params.shard_examples;
  std::vector<std::int64_t> missing;
  bool warned = false;
  for (std::int64_t number = 0; number * size < options.examples; ++number) {
    if (number % options.shard_count != options.shard_index) continue;
    ++report.files;
    const fs::path file = options.folder / shard_name(number);
    const std::int64_t wanted = std::min(options.examples - number * size, size);
    if (fs::exists(file)) {
      try {
        const Shard shard = read_shard(file);
        if (shard.header.identity != header.identity) {
          throw Error(file.string() + ": belongs to another dataset (identity " + shard.header.identity +
                      ", this one is " + header.identity + "); choose another folder");
        }
        bool complete = static_cast<std::int64_t>(shard.examples.size()) >= wanted;
        for (std::int64_t i = 0; complete && i < wanted; ++i) {
          complete = shard.examples[static_cast<std::size_t>(i)].index == number * size + i;
        }
        if (complete) {
          if (!warned && shard.header.provenance != header.provenance) {
            host.log(LogLevel::warning,
                     file.string() + ": was made by another version of weft or its plugins; its examples are kept");
            warned = true;
          }
          report.kept += wanted;
          for (const auto& e : shard.examples) report.failed += e.failed();
          continue;
        }
      } catch (const ConfigError& error) {
        ++report.refused;
        host.log(LogLevel::warning, std::string(error.what()) + "; it is made again");
      } catch (const Error& error) {
        throw ConfigError(error.what());
      }
    }
    missing.push_back(number);
  }
  const auto elapsed = [&] {
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - started).count();
  };
  std::int64_t total = 0;
  for (const auto number : missing) total += std::min(options.examples - number * size, size);

  std::mutex pool_mutex;
  std::vector<std::shared_ptr<Simulator>> pool;
  const auto simulate = [&](std::int64_t index) {
    std::shared_ptr<Simulator> simulator;
    {
      const std::lock_guard lock(pool_mutex);
      if (!pool.empty()) {
        simulator = pool.back();
        pool.pop_back();
      }
    }
    if (!simulator) simulator = host.create<Simulator>(task.simulator);
    Example example = make_example(*simulator, task, params, header.seed, index);
    const std::lock_guard lock(pool_mutex);
    pool.push_back(std::move(simulator));
    return example;
  };
  // Several files at a time when there are many threads, so that few of them wait for the last example of a file.
  const auto wave = static_cast<std::size_t>(std::max(1, host.threads() / 8));
  for (std::size_t at = 0; at < missing.size() && !report.cancelled; at += wave) {
    const std::size_t files = std::min(wave, missing.size() - at);
    std::vector<Shard> shards(files);
    std::vector<std::pair<std::size_t, std::int64_t>> jobs;
    for (std::size_t f = 0; f < files; ++f) {
      const std::int64_t first = missing[at + f] * size;
      const std::int64_t count = std::min(options.examples - first, size);
      shards[f].header = header;
      shards[f].examples.resize(static_cast<std::size_t>(count));
      for (std::int64_t i = 0; i < count; ++i) jobs.emplace_back(f, first + i);
    }
    host.parallel_for(static_cast<std::int64_t>(jobs.size()), [&](std::int64_t j) {
      if (host.cancelled()) return;
      const auto [f, index] = jobs[static_cast<std::size_t>(j)];
      shards[f].examples[static_cast<std::size_t>(index - missing[at + f] * size)] = simulate(index);
    });
    report.cancelled = host.cancelled();
    for (std::size_t f = 0; f < files && !report.cancelled; ++f) {
      write_shard(options.folder / shard_name(missing[at + f]), shards[f]);
      report.made += static_cast<std::int64_t>(shards[f].examples.size());
      for (const auto& e : shards[f].examples) report.failed += e.failed();
      report.seconds = elapsed();
      if (progress) progress(report, total);
    }
  }
  report.seconds = elapsed();
  return report;
}

}  // namespace weft
