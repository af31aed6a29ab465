#pragma once
#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "weft/material.hpp"
#include "weft/simulator.hpp"
#include "weft/task.hpp"
#include "weft/types.hpp"

namespace weft {

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
  /// Positions in `examples` of the good ones of a split; of all, when there is none.
  WEFT_API std::vector<std::size_t> select(std::optional<Split> split) const;
  WEFT_API Positions shape(std::size_t example, Index segment) const;  ///< [V, 3] m
  /// @throws ConfigError with the reason when the examples were not made for this task's garment, trajectory or
  /// manipulation.
  WEFT_API void require_task(const Task& task) const;
};

}  // namespace weft
