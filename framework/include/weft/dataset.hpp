#pragma once
#include <array>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "weft/material.hpp"
#include "weft/simulator.hpp"
#include "weft/task.hpp"
#include "weft/types.hpp"

namespace weft {

/// Where the shapes of an example lie that are not in memory.
struct StoredShapes {
  std::shared_ptr<const std::filesystem::path> file;  ///< null: they are in memory
  std::uint64_t at = 0;                               ///< their first byte in it
  std::uint64_t checksum = 0;                         ///< Example::checksum() of the whole example
};

/// One manipulation example (section 3): the material, the controls and the simulated shapes.
struct Example {
  std::int64_t index = 0;  ///< index and seed fix everything else in the example
  MaterialProperties q = MaterialProperties::Zero();
  Controls controls;          ///< [k, C]
  Controls states;            ///< [k + 1, S]: at the start and after every segment
  Controls targets;           ///< [k + 1, 3 G] m: grasp targets at those states
  std::vector<float> shapes;  ///< [k + 1, V, 3] m: at the start and after every segment; settled if released
  bool released = false;
  SettleResult settle;
  double max_grasp_strain = 0.0;
  std::string failure;  ///< why the simulation failed; a failed example has no segments and no shapes
  StoredShapes stored;  ///< with a file: `shapes` is empty, and read_shapes() reads them

  Index segments() const { return controls.rows(); }
  bool failed() const { return !failure.empty(); }
  /// Of all that the example holds, with these shapes.
  WEFT_API std::uint64_t checksum(const std::vector<float>& shapes_of_it) const;
  /// The shapes, from memory or from their file. Thread-safe.
  /// @param vertices V. @return [k + 1, V, 3] m.
  /// @throws ConfigError naming the file when it cannot be read, or holds something else than when it was listed.
  WEFT_API std::vector<float> read_shapes(Index vertices) const;
  /// The same into a vector whose memory is used again. @param to [k + 1, V, 3] m.
  WEFT_API void read_shapes(Index vertices, std::vector<float>& to) const;
};

enum class Split { train, validation, test };  // in order of use: < is meaningful
inline constexpr std::array<const char*, 3> kSplitNames = {"train", "validation", "test"};
/// @throws ConfigError if `name` is not the name of a split.
WEFT_API Split split_named(const std::string& name);
/// The split of that name, or nullopt for `all`. @throws ConfigError for any other name.
WEFT_API std::optional<Split> split_or_all(const std::string& name);

/// Tells whether two datasets share examples. Seed and i fix example i; i and the fractions fix its split.
struct DatasetOrigin {
  std::string identity;
  std::uint64_t seed = 0;
  double validation_fraction = 0.0, test_fraction = 0.0;

  /// All frames of an example are in one split. It depends on the index alone, so adding examples moves none.
  WEFT_API Split split(std::int64_t index) const;
};

/// What all shards of a dataset share.
struct DatasetHeader {
  std::string config;      ///< resolved config that made it, YAML
  std::string identity;    ///< hash of config, seed and garment; datasets with equal identities hold equal examples
  std::string provenance;  ///< version, commit and plugins, JSON
  std::uint64_t seed = 0;
  std::string garment_name;
  std::uint64_t garment_hash = 0;
  GarmentForm garment_form;  ///< empty for garments of one chart and one layer
  Index vertices = 0, controls = 0, states = 0, hands = 0;
  std::int64_t shard_examples = 1;  ///< example i belongs in file i / shard_examples
  std::vector<std::string> control_names, state_names;
  double validation_fraction = 0.0, test_fraction = 0.0;

  DatasetOrigin origin() const { return {identity, seed, validation_fraction, test_fraction}; }
  Split split(std::int64_t index) const { return origin().split(index); }
};

/// Examples, ascending by index within each dataset. Their shapes are in memory, or in files (Example::stored).
struct Dataset {
  DatasetHeader header;
  std::vector<Example> examples;
  std::vector<DatasetOrigin> appended;  ///< after append(): the datasets it consists of, including the first
  std::vector<std::size_t> begins;      ///< after append(): the position of each one's first example

  /// The datasets that the examples come from: one, or several after append().
  std::vector<DatasetOrigin> origins() const { return appended.empty() ? std::vector{header.origin()} : appended; }
  /// Which of origins() an example comes from. @param example position in `examples`.
  WEFT_API std::size_t source(std::size_t example) const;
  /// Positions in `examples` of those of a split that did not fail; nullopt: of all splits.
  WEFT_API std::vector<std::size_t> select(std::optional<Split> split) const;
  WEFT_API Positions shape(std::size_t example, Index segment) const;  ///< [V, 3] m
  /// @throws ConfigError with the reason if the examples belong to another garment, trajectory or manipulation.
  WEFT_API void require_task(const Task& task) const;
};

}  // namespace weft
