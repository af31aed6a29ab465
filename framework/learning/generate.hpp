#pragma once
#include <cstdint>
#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "identity/identity.hpp"
#include "processes/work_status.hpp"
#include "simulation/random_controls.hpp"
#include "weft/dataset.hpp"
#include "weft/host.hpp"
#include "weft/params.hpp"

namespace weft {

/// How examples are made (section 3): the part of an experiment's config under `data:`.
struct DataParams {
  RandomControlsParams distribution;
  double amplitude_low = 0.2;
  double amplitude_high = 1.4;
  double jitter = 0.5;
  std::int64_t max_segments = 25;
  std::int64_t shard_examples = 64;
  double validation_fraction = 0.04;
  double test_fraction = 0.08;

  template <class Visitor>
  void visit(Visitor& v) {
    v.group("distribution", distribution, "Random controls around the default trajectory.");
    v("amplitude_low", amplitude_low, range(0, 10),
      "Lower end of the range for each example's factor on drift, walk and jitter.");
    v("amplitude_high", amplitude_high, range(0, 10), "Upper end of that range.");
    v("jitter", jitter, range(0, 10),
      "Standard deviation of noise that is independent for each segment, in units of the control's scale.");
    v("max_segments", max_segments, range(1, 200, "segments"),
      "b: an example ends after this many segments, even without a release.");
    v("shard_examples", shard_examples, range(1, 4096), "Examples per file.");
    v("validation_fraction", validation_fraction, range(0, 0.5), "Share of the examples held out for model selection.");
    v("test_fraction", test_fraction, range(0, 0.5), "Share of the examples held out for the final figures.");
  }
};

/// Header of the dataset that a task, its resolved config and a seed define.
/// @param identity what its examples belong to; unknown: of config, seed and garment alone.
DatasetHeader make_dataset_header(const Task& task, const DataParams& params, std::uint64_t seed,
                                  const ConfigNode& resolved, const std::string& provenance,
                                  const Identity& identity = {});
/// The header with which examples are added to a folder: `header`, or with an accepted change the one that goes on under
/// the name of the dataset that is there. Changes nothing on the disk.
/// @throws ConfigError naming what differs between the folder's examples and `header`, unless it is accepted; also if
/// seed, garment, trajectory or the form of the files differ, which cannot be accepted.
/// @param identity of `header`.
DatasetHeader header_to_add(const DatasetHeader& header, const Identity& identity, const std::filesystem::path& folder,
                            bool accept_changed);
struct GenerateOptions {
  std::int64_t examples = 0;
  std::filesystem::path folder;
  /// This machine makes the files with number % shard_count == shard_index.
  std::int64_t shard_index = 0, shard_count = 1;
  /// Command of the child processes that make the examples, and the request that one of them understands. Empty: the
  /// threads of this process make them, and a crash in one ends them all.
  std::vector<std::string> worker = {};
  std::function<std::string(std::int64_t index)> request = {};
  Retry retry = Retry::none;  ///< which failed examples of complete files are made again
  bool fail_fast = false;     ///< stop after the first example that failed
  bool is_share = false;      ///< return when the missing files are those that other living processes make
  double cell_limit_s = 0.0;  ///< CPU time of an example after which it hangs; 0: 20 times the slowest, at least 600
  /// Called for every example that fails, one call at a time.
  std::function<void(std::int64_t index, const WorkFailure& failure)> failed = {};
};
struct GenerateReport {
  std::int64_t made = 0, kept = 0, files = 0, refused = 0;
  /// Of the failed examples in the files of this part, kept ones included.
  std::vector<WorkStatus> failures;
  std::int64_t left = 0;  ///< files that other processes are making
  double seconds = 0.0;
  bool cancelled = false;

  std::int64_t failed() const { return static_cast<std::int64_t>(failures.size()); }
  /// Diverged examples are data, up to one in a hundred. Any other failure makes the dataset one to look at.
  bool acceptable() const;
};
/// Called after every file.
using GenerateProgress = std::function<void(const GenerateReport&, std::int64_t total)>;

/// Files of [0, examples) that are not there, or hold fewer examples. Looks at no contents but the number of examples.
std::int64_t files_left(const DataParams& params, std::int64_t examples, const std::filesystem::path& folder);

/// How a failed example failed. Its `failure` begins with the status unless it diverged.
WorkFailure failure_of(const Example& example);
/// Makes example `index`. It depends on (seed, index), the task and the parameters alone.
Example make_example(Simulator& simulator, const Task& task, const DataParams& params, std::uint64_t seed,
                     std::int64_t index);
/// Makes the missing shards of [0, examples). Complete files of this dataset are kept; damaged ones are reported and
/// made again. If the process is killed, only complete files remain. Several processes may make one dataset: each
/// claims the files that it makes, and the call returns when all files are there.
/// @throws ConfigError if the folder holds another dataset.
GenerateReport generate_dataset(const Task& task, const DataParams& params, const DatasetHeader& header,
                                const GenerateOptions& options, Host& host, const GenerateProgress& progress = {});

}  // namespace weft
