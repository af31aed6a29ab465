#pragma once
#include <array>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "weft/random_controls.hpp"
#include "weft/task.hpp"

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
      "Each example multiplies drift, walk and jitter by a factor drawn from here ...");
    v("amplitude_high", amplitude_high, range(0, 10), "... to here: calm examples as well as wild ones.");
    v("jitter", jitter, range(0, 10),
      "Standard deviation of noise that is independent for each segment, in units of the control's scale.");
    v("max_segments", max_segments, range(1, 200, "segments"),
      "b: an example that is not released by then ends unreleased.");
    v("shard_examples", shard_examples, range(1, 4096), "Examples per file.");
    v("validation_fraction", validation_fraction, range(0, 0.5), "Share of the examples held out to steer training.");
    v("test_fraction", test_fraction, range(0, 0.5), "Share of the examples held out for the final figures.");
  }
};

/// One manipulation example (section 3): what was done to which material, and every shape.
struct Example {
  std::int64_t index = 0;  ///< its number; with the seed it fixes everything else
  MaterialProperties q = MaterialProperties::Zero();
  Controls controls;          ///< [k, C]
  Controls states;            ///< [k + 1, S]: at the start and after every segment
  Controls targets;           ///< [k + 1, 3 G] m: grasp targets at those states
  std::vector<float> shapes;  ///< [k + 1, V, 3] m: at the start and after every segment; settled if released
  bool released = false;
  SettleResult settle;
  double max_grasp_strain = 0.0;
  std::string failure;  ///< why its simulation failed; then there are no segments and no shapes

  Index segments() const { return controls.rows(); }
  bool failed() const { return !failure.empty(); }
};

enum class Split { train, validation, test };  // in order of use: < is meaningful
inline constexpr std::array<const char*, 3> kSplitNames = {"train", "validation", "test"};
/// @throws ConfigError for what is no split's name.
WEFT_API Split split_named(const std::string& name);
/// The same; `all`: none, for every split. @throws ConfigError for what is neither.
WEFT_API std::optional<Split> split_or_all(const std::string& name);

/// What tells whether two datasets can share examples: example i is made of (seed, i), its split goes by i and the
/// fractions.
struct DatasetOrigin {
  std::string identity;
  std::uint64_t seed = 0;
  double validation_fraction = 0.0, test_fraction = 0.0;

  /// By example, never by frame, from the index alone: more examples never move one from one split to another.
  WEFT_API Split split(std::int64_t index) const;
};

/// What all shards of a dataset share.
struct DatasetHeader {
  std::string config;      ///< resolved config that made it, YAML
  std::string identity;    ///< hash of config, seed and garment: equal identities, equal examples
  std::string provenance;  ///< version, commit and plugins, JSON
  std::uint64_t seed = 0;
  std::string garment_name;
  std::uint64_t garment_hash = 0;
  Index vertices = 0, controls = 0, states = 0, hands = 0;
  std::int64_t shard_examples = 1;  ///< example i belongs in file i / shard_examples
  std::vector<std::string> control_names, state_names;
  double validation_fraction = 0.0, test_fraction = 0.0;

  DatasetOrigin origin() const { return {identity, seed, validation_fraction, test_fraction}; }
  Split split(std::int64_t index) const { return origin().split(index); }
};

/// Examples in memory, ascending by index within each dataset.
struct Dataset {
  DatasetHeader header;
  std::vector<Example> examples;
  std::vector<DatasetOrigin> appended;  ///< after append(): all that it was put together from, the first one included
  std::vector<std::size_t> begins;      ///< after append(): position of the first example of each of these

  /// The datasets that the examples come from: one, or all that were appended.
  std::vector<DatasetOrigin> origins() const { return appended.empty() ? std::vector{header.origin()} : appended; }
  /// Which of origins() an example comes from. @param example position in `examples`.
  WEFT_API std::size_t source(std::size_t example) const;
  /// Reads and checks every shard of a folder.
  /// @param max_examples stop after that many; 0: all.
  /// @throws ConfigError for a damaged shard (refused whole), shards of different datasets, or a folder without shards.
  WEFT_API static Dataset load(const std::filesystem::path& folder, std::size_t max_examples = 0);
  /// Adds the examples of another dataset of the same task, made with another distribution or seed; each keeps its
  /// split. @throws ConfigError when garment, trajectory, hands or the shares of the splits differ, or for the same
  /// dataset twice.
  WEFT_API void append(Dataset other);
  /// Positions in `examples` of the good ones of a split; of all, when there is none.
  WEFT_API std::vector<std::size_t> select(std::optional<Split> split) const;
  /// Positions in `examples` of the good ones that the fit of a model, which was trained on these datasets, has not
  /// seen, and that no test is to be made with: of a dataset that it knows the validation split, of others the train
  /// and the validation split. Equal numbers of one seed count as the same example, see held_out_warning(). When
  /// nothing is known of the fit, `trained_on` is empty: the validation split, for any dataset may have been trained
  /// on.
  WEFT_API std::vector<std::size_t> unseen(const std::vector<DatasetOrigin>& trained_on) const;
  /// Why the examples of a split may not be what its name says, to a model that was trained on these datasets: some
  /// were in an earlier split then, or, for the split train, none was; or its sigma was calibrated on some of them
  /// afterwards. No split: all examples, as if they were test examples. Empty: no reason is known, as when `trained_on`
  /// is.
  WEFT_API std::string held_out_warning(std::optional<Split> split, const std::vector<DatasetOrigin>& trained_on,
                                        const std::vector<DatasetOrigin>& calibrated_on = {}) const;
  WEFT_API Positions shape(std::size_t example, Index segment) const;  ///< [V, 3] m
  /// @throws ConfigError with the reason when the examples were not made for this task's garment, trajectory or
  /// manipulation.
  WEFT_API void require_task(const Task& task) const;
};

/// One file of a dataset.
struct Shard {
  DatasetHeader header;
  std::vector<Example> examples;
};
/// Whole or absent; the bytes depend on the content alone.
WEFT_API void write_shard(const std::filesystem::path& file, const Shard& shard);
/// Checks schema, shapes, finite numbers and the checksum of the content. @throws ConfigError naming file and reason.
WEFT_API Shard read_shard(const std::filesystem::path& file);
/// "shard-00012.h5"
WEFT_API std::string shard_name(std::int64_t number);
/// The shard files of a folder, sorted. @throws ConfigError if it is no folder.
WEFT_API std::vector<std::filesystem::path> list_shards(const std::filesystem::path& folder);

struct GenerateOptions {
  std::int64_t examples = 0;
  std::filesystem::path folder;
  std::int64_t shard_index = 0,
               shard_count = 1;  ///< this machine makes the files with number % shard_count == shard_index
};
struct GenerateReport {
  std::int64_t made = 0, kept = 0, failed = 0, files = 0, refused = 0;
  double seconds = 0.0;
  bool cancelled = false;
};
/// Called after every file.
using GenerateProgress = std::function<void(const GenerateReport&, std::int64_t total)>;

/// Header of the dataset that a task, its resolved config and a seed define.
WEFT_API DatasetHeader make_dataset_header(const Task& task, const DataParams& params, std::uint64_t seed,
                                           const ConfigNode& resolved, const std::string& provenance);
/// Example `index`: a function of (seed, index), the task and the parameters alone.
WEFT_API Example make_example(Simulator& simulator, const Task& task, const DataParams& params, std::uint64_t seed,
                              std::int64_t index);
/// Makes the shards of [0, examples) that are missing. Files that are complete and belong to this dataset are kept;
/// damaged ones are reported and made again. Killed at any moment it leaves only complete files.
/// @throws ConfigError when the folder holds another dataset.
WEFT_API GenerateReport generate_dataset(const Task& task, const DataParams& params, const DatasetHeader& header,
                                         const GenerateOptions& options, Host& host,
                                         const GenerateProgress& progress = {});

/// Copies the shards of several folders of one dataset into one. @return number of files.
/// @throws ConfigError when they are of different datasets, or two hold different examples under one number.
WEFT_API std::int64_t merge_datasets(const std::vector<std::filesystem::path>& from, const std::filesystem::path& to);
/// Writes the three splits as datasets of their own: to/train, to/validation, to/test. @return examples of each.
WEFT_API std::array<std::int64_t, 3> split_dataset(const std::filesystem::path& from, const std::filesystem::path& to);

}  // namespace weft
