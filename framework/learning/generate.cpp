#include "learning/generate.hpp"

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <mutex>
#include <tuple>

#include "learning/dataset_files.hpp"
#include "sdk/fingerprint.hpp"
#include "simulation/fold.hpp"

namespace weft {

namespace fs = std::filesystem;

DatasetHeader make_dataset_header(const Task& task, const DataParams& params, std::uint64_t seed,
                                  const ConfigNode& resolved, const std::string& provenance, const Identity& identity) {
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
  h.identity = identity.is_known() ? identity.hash() : f.hex();
  return h;
}

DatasetHeader header_to_add(const DatasetHeader& header, const Identity& identity, const fs::path& folder,
                            bool accept_changed) {
  DatasetHeader result = header;
  if (!fs::is_directory(folder)) return result;
  bool is_first = true;
  for (const auto& file : list_shards(folder)) {
    DatasetHeader there;
    try {
      there = read_shard_header(file);
    } catch (const ConfigError&) {
      continue;  // damaged: it is made again
    }
    const auto changes = identity.changes_since(identity_in(there.provenance, file.string()));
    if (!changes.empty() && !accept_changed) throw ConfigError(changed_message(file.string(), changes));
    const auto form = [](const DatasetHeader& h) {
      return std::tie(h.seed, h.garment_hash, h.vertices, h.hands, h.shard_examples, h.control_names, h.state_names,
                      h.validation_fraction, h.test_fraction);
    };
    if (form(there) != form(header)) {
      throw ConfigError(file.string() +
                        ": belongs to a dataset of another seed, garment, trajectory, shard_examples or split; choose "
                        "another folder");
    }
    if (is_first) result.identity = there.identity;
    is_first = false;
  }
  return result;
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

namespace {

/// A killed run leaves its temporary file. The temporary files of other parts may be in use.
void remove_temporaries(const GenerateOptions& options) {
  for (const auto& entry : fs::directory_iterator(options.folder)) {
    long long number = 0;
    int used = 0;
    const auto name = entry.path().filename().string();
    if (std::sscanf(name.c_str(), "shard-%lld.h5.tmp%n", &number, &used) == 1 && used > 0 &&
        number % options.shard_count == options.shard_index)
      fs::remove(entry.path());
  }
}

/// The examples [first, end) of one file.
struct ShardRange {
  std::int64_t number = 0, first = 0, end = 0;
  std::int64_t count() const { return end - first; }
};

/// Whether the file holds the examples of its range. If so, they count as kept. A damaged file is reported.
/// @throws ConfigError if it belongs to another dataset.
bool is_complete(const fs::path& file, const ShardRange& range, const DatasetHeader& header, GenerateReport& report,
                 Host& host) {
  if (!fs::exists(file)) return false;
  Shard shard;
  try {
    shard = read_shard(file);
  } catch (const ConfigError& error) {
    ++report.refused;
    host.log(LogLevel::warning, std::string(error.what()) + "; it is made again");
    return false;
  } catch (const Error& error) {
    throw ConfigError(error.what());
  }
  if (shard.header.identity != header.identity) {
    throw ConfigError(file.string() + ": belongs to another dataset (identity " + shard.header.identity +
                      ", this one is " + header.identity + "); choose another folder");
  }
  if (static_cast<std::int64_t>(shard.examples.size()) < range.count()) return false;
  for (std::int64_t i = 0; i < range.count(); ++i) {
    if (shard.examples[i].index != range.first + i) return false;
  }
  report.kept += range.count();
  for (const auto& e : shard.examples) report.failed += e.failed();
  return true;
}

/// The missing files of this part.
std::vector<ShardRange> missing_files(const DatasetHeader& header, std::int64_t size, const GenerateOptions& options,
                                      GenerateReport& report, Host& host) {
  std::vector<ShardRange> missing;
  for (std::int64_t number = 0; number * size < options.examples; ++number) {
    if (number % options.shard_count != options.shard_index) continue;
    ++report.files;
    const ShardRange range{number, number * size, std::min(options.examples, (number + 1) * size)};
    if (!is_complete(options.folder / shard_name(number), range, header, report, host)) missing.push_back(range);
  }
  return missing;
}

/// Simulators for the threads that make examples. A new one is made if all others are in use.
class SimulatorPool {
 public:
  SimulatorPool(Host& host, const ConfigNode& slot) : host_(host), slot_(slot) {}
  std::shared_ptr<Simulator> take() {
    {
      const std::lock_guard lock(mutex_);
      if (!free_.empty()) {
        auto simulator = std::move(free_.back());
        free_.pop_back();
        return simulator;
      }
    }
    return host_.create<Simulator>(slot_);
  }
  void give_back(std::shared_ptr<Simulator> simulator) {
    const std::lock_guard lock(mutex_);
    free_.push_back(std::move(simulator));
  }

 private:
  Host& host_;
  ConfigNode slot_;
  std::mutex mutex_;
  std::vector<std::shared_ptr<Simulator>> free_;
};

}  // namespace

GenerateReport generate_dataset(const Task& task, const DataParams& params, const DatasetHeader& header,
                                const GenerateOptions& options, Host& host, const GenerateProgress& progress) {
  const auto started = std::chrono::steady_clock::now();
  const auto elapsed = [&] {
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - started).count();
  };
  GenerateReport report;
  fs::create_directories(options.folder);
  remove_temporaries(options);
  const auto missing = missing_files(header, params.shard_examples, options, report, host);
  std::int64_t total = 0;
  for (const ShardRange& range : missing) total += range.count();

  SimulatorPool pool(host, task.simulator);
  // With many threads several files are made at a time, so that few threads wait for the last example of a file.
  const auto wave = static_cast<std::size_t>(std::max(1, host.threads() / 8));
  for (std::size_t at = 0; at < missing.size() && !report.cancelled; at += wave) {
    const std::size_t files = std::min(wave, missing.size() - at);
    std::vector<Shard> shards(files);
    std::vector<std::pair<std::size_t, std::int64_t>> jobs;
    for (std::size_t f = 0; f < files; ++f) {
      const ShardRange& range = missing[at + f];
      shards[f].header = header;
      shards[f].examples.resize(range.count());
      for (std::int64_t i = range.first; i < range.end; ++i) jobs.emplace_back(f, i);
    }
    host.parallel_for(static_cast<std::int64_t>(jobs.size()), [&](std::int64_t j) {
      if (host.cancelled()) return;
      const auto [f, index] = jobs[j];
      auto simulator = pool.take();
      shards[f].examples[index - missing[at + f].first] = make_example(*simulator, task, params, header.seed, index);
      pool.give_back(std::move(simulator));
    });
    report.cancelled = host.cancelled();
    for (std::size_t f = 0; f < files && !report.cancelled; ++f) {
      write_shard(options.folder / shard_name(missing[at + f].number), shards[f]);
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
