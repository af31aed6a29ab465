#include "learning/generate.hpp"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <mutex>
#include <optional>
#include <set>
#include <thread>
#include <tuple>
#include <utility>

#include "learning/dataset_files.hpp"
#include "learning/example_bytes.hpp"
#include "loader/where.hpp"
#include "processes/claims.hpp"
#include "processes/worker_process.hpp"
#include "sdk/files.hpp"
#include "sdk/fingerprint.hpp"
#include "simulation/fold.hpp"
#include "simulation/hand_limits.hpp"

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
  h.garment_form = task.garment->form;
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
    } catch (const ReadError&) {
      throw;
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

namespace {

RandomStream example_streams(std::uint64_t seed, std::int64_t index) {
  return RandomStream(seed, 0x6578616d706c65ull, static_cast<std::uint64_t>(index));
}

MaterialProperties example_material(const RandomStream& streams) {
  RandomStream random = streams.child(0);
  MaterialProperties q;
  for (Index p = 0; p < 4; ++p) q(p) = random.uniform();
  return q;
}

/// An example that has no shapes. @param controls the trajectory's.
Example failed_example(std::uint64_t seed, std::int64_t index, Index controls, const WorkFailure& failure) {
  Example example;
  example.index = index;
  example.q = example_material(example_streams(seed, index));
  example.controls.resize(0, controls);
  example.failure = failure.message;
  if (failure.status != WorkStatus::diverged)
    example.failure = std::string(to_string(failure.status)) + ": " + example.failure;
  return example;
}

}  // namespace

WorkFailure failure_of(const Example& example) {
  if (!example.failed()) return {WorkStatus::done, ""};
  for (const auto status : {WorkStatus::refused, WorkStatus::crashed, WorkStatus::hung, WorkStatus::lost}) {
    const std::string beginning = std::string(to_string(status)) + ": ";
    if (example.failure.starts_with(beginning)) return {status, example.failure.substr(beginning.size())};
  }
  return {WorkStatus::diverged, example.failure};
}

namespace {

/// The highest number of a file in [0, files); -1 without one. When it was begun all others were full.
std::int64_t last_shard(const fs::path& folder, std::int64_t files) {
  std::int64_t last = files - 1;
  while (last >= 0 && !fs::exists(folder / shard_name(last))) --last;
  return last;
}

std::int64_t files_of(const DataParams& params, std::int64_t examples) {
  return (examples + params.shard_examples - 1) / params.shard_examples;
}

}  // namespace

std::int64_t files_left(const DataParams& params, std::int64_t examples, const fs::path& folder) {
  const std::int64_t files = files_of(params, examples), last = last_shard(folder, files);
  std::int64_t left = files - 1 - last;
  for (std::int64_t number = 0; number < last; ++number)
    if (!fs::exists(folder / shard_name(number))) ++left;
  if (last < 0) return left;
  const std::int64_t wanted = std::min(params.shard_examples, examples - last * params.shard_examples);
  try {
    if (std::cmp_less(read_shard(folder / shard_name(last)).examples.size(), wanted)) ++left;
  } catch (const ConfigError&) {
    ++left;  // damaged: it is made again
  }
  return left;
}

bool GenerateReport::acceptable() const {
  const auto diverged = std::count(failures.begin(), failures.end(), WorkStatus::diverged);
  constexpr std::int64_t kMostDiverged = 100;  // one in so many
  return diverged == failed() && diverged * kMostDiverged <= made + kept;
}

Example make_example(Simulator& simulator, const Task& task, const DataParams& params, std::uint64_t seed,
                     std::int64_t index) {
  const Step step("example", index);
  const RandomStream streams = example_streams(seed, index);
  Example example;
  example.index = index;
  example.q = example_material(streams);
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
      const auto& v = variables[c];
      controls(j, c) =
          std::clamp(controls(j, c) + amplitude * params.jitter * v.scale * jitter.normal(), v.lower, v.upper);
    }
  }
  FoldResult fold;
  try {
    // What the hands cannot do is nothing to learn from: no plan will ask for it.
    if (task.hands.any())
      controls = within_limits(task, task.trajectory->initial_state(task.manipulation), {}, controls).controls;
    fold = simulate_fold(simulator, task, example.q, controls);
  } catch (...) {
    return failed_example(seed, index, controls.cols(), current_failure());
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

/// The examples [first, end) of one file.
struct ShardRange {
  std::int64_t number = 0, first = 0, end = 0;
  bool was_there = false;  ///< when this process began, but not complete
  std::int64_t count() const { return end - first; }
};

/// The examples of a complete file that need not be made; empty if the file must be made. A damaged one is reported.
/// @param range is widened to all examples of a file that is made again in part.
/// @param damaged numbers of the files that were reported; those of this call are added.
/// @throws ConfigError if it belongs to another dataset.
std::vector<Example> kept_examples(const fs::path& file, ShardRange& range, const DatasetHeader& header, Retry retry,
                                   GenerateReport& report, std::set<std::int64_t>& damaged, Host& host) {
  if (!fs::exists(file)) return {};
  Shard shard;
  try {
    shard = read_shard(file);
  } catch (const ReadError&) {
    throw;  // it may be whole, so it is not made again
  } catch (const ConfigError& error) {
    if (!damaged.insert(range.number).second) return {};
    ++report.refused;
    host.log(LogLevel::warning, std::string(error.what()) + "; it is made again");
    return {};
  } catch (const Error& error) {
    throw ConfigError(error.what());
  }
  if (shard.header.identity != header.identity) {
    throw ConfigError(file.string() + ": belongs to another dataset (identity " + shard.header.identity +
                      ", this one is " + header.identity + "); choose another folder");
  }
  if (static_cast<std::int64_t>(shard.examples.size()) < range.count()) return {};
  for (std::int64_t i = 0; i < range.count(); ++i) {
    if (shard.examples[static_cast<std::size_t>(i)].index != range.first + i) return {};
  }
  const auto tried_again = [&](const Example& e) { return tries_again(retry, failure_of(e).status); };
  if (std::none_of(shard.examples.begin(), shard.examples.end(), tried_again))
    shard.examples.resize(static_cast<std::size_t>(range.count()));
  range.end = range.first + static_cast<std::int64_t>(shard.examples.size());
  std::erase_if(shard.examples, tried_again);
  return std::move(shard.examples);
}

/// Makes the files of a part: hands out their examples to threads, and writes each file when it has all of them.
class Production {
 public:
  Production(const Task& task, const DataParams& params, const DatasetHeader& header, const GenerateOptions& options,
             Host& host, const GenerateProgress& progress)
      : task_(task),
        params_(params),
        header_(header),
        options_(options),
        host_(host),
        progress_(progress),
        started_(std::chrono::steady_clock::now()),
        slowest_(options.cell_limit_s),
        claims_(options.folder / "claims"),
        leftovers_(options.folder) {
    const std::int64_t files = files_of(params, options.examples), last = last_shard(options.folder, files);
    for (std::int64_t number = 0; number < files; ++number) {
      if (number % options.shard_count != options.shard_index) continue;
      ++report_.files;
      const bool is_there = fs::exists(options.folder / shard_name(number));
      // Whoever does the rest reads what is there. A share does not: many processes would all read everything.
      if (is_there && reads_nothing() && number != last) continue;
      const auto first = number * params.shard_examples;
      ShardRange range{number, first, std::min(options.examples, first + params.shard_examples), is_there};
      auto kept = look(range);
      if (std::cmp_equal(kept.size(), range.count()))
        keep(kept);
      else
        missing_.push_back(range);
      total_ += range.count() - static_cast<std::int64_t>(kept.size());
    }
  }

  /// Makes examples until there are no more; several threads may call it.
  void work() {
    std::optional<WorkerProcess> child;
    std::shared_ptr<Simulator> simulator;
    if (!options_.worker.empty()) child.emplace(options_.worker);
    try {
      while (const auto job = next()) {
        Example example;
        if (child) {
          auto made = make_in(*child, job->index);
          if (!made) return;
          example = std::move(*made);
        } else {
          if (!simulator) simulator = host_.create<Simulator>(task_.simulator);
          example = make_example(*simulator, task_, params_, header_.seed, job->index);
        }
        if (host_.cancelled()) return;
        finish(*job, std::move(example));
      }
    } catch (...) {
      stopping_ = true;
      throw;
    }
  }

  GenerateReport report() {
    report_.seconds = elapsed();
    report_.cancelled = over();
    report_.left = std::ssize(missing_);
    return report_;
  }

 private:
  /// A file that is being made.
  struct Open {
    ShardRange range;
    Shard shard;
    std::vector<std::int64_t> todo;  ///< indices, the next one last
    std::size_t at_work = 0;         ///< examples that were handed out and are not finished
    std::int64_t made = 0;
  };
  struct Job {
    std::shared_ptr<Open> file;
    std::int64_t index;
  };

  bool reads_nothing() const { return options_.is_share && options_.retry == Retry::none; }
  double elapsed() const { return std::chrono::duration<double>(std::chrono::steady_clock::now() - started_).count(); }
  bool over() const { return stopping_ || host_.cancelled(); }

  std::vector<Example> look(ShardRange& range) {
    return kept_examples(options_.folder / shard_name(range.number), range, header_, options_.retry, report_, damaged_,
                         host_);
  }
  void keep(const std::vector<Example>& examples) {
    report_.kept += static_cast<std::int64_t>(examples.size());
    count_failures(examples);
  }
  void count_failures(const std::vector<Example>& examples) {
    for (const auto& e : examples)
      if (e.failed()) report_.failures.push_back(failure_of(e).status);
  }

  /// The next example to make. Waits while the missing files are other processes'. @return nothing: all are there.
  std::optional<Job> next() {
    while (!over()) {
      {
        const std::lock_guard lock(mutex_);
        if (open_ == nullptr || open_->todo.empty()) open_ = claim();
        if (open_ != nullptr) {
          const auto index = open_->todo.back();
          open_->todo.pop_back();
          ++open_->at_work;
          return Job{open_, index};
        }
        if (missing_.empty() || (options_.is_share && others_are_at_work())) return std::nullopt;
      }
      std::this_thread::sleep_for(std::chrono::milliseconds(500));
    }
    return std::nullopt;
  }

  bool others_are_at_work() {
    return std::all_of(missing_.begin(), missing_.end(),
                       [&](const ShardRange& range) { return claims_.is_held(shard_name(range.number)); });
  }

  /// Claims a missing file. Files that other processes have made in the meantime are kept.
  std::shared_ptr<Open> claim() {
    for (std::size_t i = 0; i < missing_.size();) {
      ShardRange range = missing_[i];
      const std::string name = shard_name(range.number);
      if (reads_nothing() && !range.was_there && fs::exists(options_.folder / name)) {  // another process has made it
        missing_.erase(missing_.begin() + static_cast<std::ptrdiff_t>(i));
        continue;
      }
      if (!claims_.take(name)) {
        ++i;
        continue;
      }
      leftovers_.remove(options_.folder / name);
      missing_.erase(missing_.begin() + static_cast<std::ptrdiff_t>(i));
      auto kept = look(range);  // whoever had the claim before may have made it
      if (std::cmp_equal(kept.size(), range.count())) {
        keep(kept);
        claims_.release(name);
        continue;
      }
      auto file = std::make_shared<Open>();
      file->range = range;
      file->shard.header = header_;
      file->shard.examples.resize(static_cast<std::size_t>(range.count()));
      std::vector<bool> has(file->shard.examples.size());
      for (auto& example : kept) {
        const auto place = static_cast<std::size_t>(example.index - range.first);
        has.at(place) = true;
        file->shard.examples[place] = std::move(example);
      }
      for (std::int64_t index = range.end; index-- > range.first;)
        if (!has[static_cast<std::size_t>(index - range.first)]) file->todo.push_back(index);
      return file;
    }
    return nullptr;
  }

  /// @return nothing if the user asked to stop.
  std::optional<Example> make_in(WorkerProcess& child, std::int64_t index) {
    const auto fail = [&](const WorkFailure& failure) {
      return failed_example(header_.seed, index, std::ssize(header_.control_names), failure);
    };
    const WorkEnd end = child.run(
        options_.request(index), [&] { return slowest_.limits(); }, [&] { return over(); });
    if (end.kind == WorkEnd::Kind::cancelled) return std::nullopt;
    if (end.kind != WorkEnd::Kind::answered) return fail(failure_of(end));
    slowest_.add(end.cpu_seconds);
    try {
      if (end.text.starts_with(kNoExample)) return fail(read_no_example(end.text));
      Example example = example_from_hex(end.text);
      if (example.index == index) return example;
    } catch (const ConfigError&) {  // reported below
    }
    return fail({WorkStatus::crashed, "its process answered with nonsense: " + end.text.substr(0, 200)});
  }

  void finish(const Job& job, Example example) {
    const std::lock_guard lock(mutex_);
    Open& file = *job.file;
    if (example.failed()) {
      if (options_.failed) options_.failed(example.index, failure_of(example));
      if (options_.fail_fast) stopping_ = true;
    }
    file.shard.examples[static_cast<std::size_t>(job.index - file.range.first)] = std::move(example);
    ++file.made;
    if (--file.at_work > 0 || !file.todo.empty()) return;
    const std::string name = shard_name(file.range.number);
    write_shard(options_.folder / name, file.shard);
    claims_.release(name);
    report_.made += file.made;
    report_.kept += file.range.count() - file.made;
    count_failures(file.shard.examples);
    report_.seconds = elapsed();
    if (progress_) progress_(report_, total_);
  }

  const Task& task_;
  const DataParams& params_;
  const DatasetHeader& header_;
  const GenerateOptions& options_;
  Host& host_;
  const GenerateProgress& progress_;
  std::chrono::steady_clock::time_point started_;
  SlowestUnit slowest_;
  Claims claims_;
  Leftovers leftovers_;
  std::atomic<bool> stopping_ = false;
  std::mutex mutex_;  ///< for what follows
  GenerateReport report_;
  std::set<std::int64_t> damaged_;  ///< files
  std::int64_t total_ = 0;
  std::vector<ShardRange> missing_;  ///< that no thread has claimed
  std::shared_ptr<Open> open_;       ///< the file whose examples are handed out
};

}  // namespace

GenerateReport generate_dataset(const Task& task, const DataParams& params, const DatasetHeader& header,
                                const GenerateOptions& options, Host& host, const GenerateProgress& progress) {
  make_writable_folder(options.folder);
  Production production(task, params, header, options, host, progress);
  host.parallel_for(host.threads(), [&](std::int64_t) { production.work(); });
  return production.report();
}

}  // namespace weft
