#pragma once
#include <array>
#include <filesystem>
#include <string>
#include <vector>

#include "simulation/fold.hpp"
#include "weft/dataset.hpp"

namespace weft {

/// One file of a dataset.
struct Shard {
  DatasetHeader header;
  std::vector<Example> examples;
};
enum class ShapesIn {
  memory,
  files  ///< where a shard's layout allows it (schema 2): an example is read, and its checksum compared, when it is used
};

/// The file is whole or absent. Its bytes depend on the content alone.
void write_shard(const std::filesystem::path& file, const Shard& shard);
/// Checks schema, shapes, finite numbers and, with all shapes in memory, the checksum of the content.
/// @throws ConfigError naming file and reason.
Shard read_shard(const std::filesystem::path& file, ShapesIn shapes = ShapesIn::memory);
/// The header alone. @throws ConfigError naming file and reason.
DatasetHeader read_shard_header(const std::filesystem::path& file);
/// "shard-00012.h5"
std::string shard_name(std::int64_t number);
/// The shard files of a folder, sorted. @throws ConfigError if it is not a folder, or if a killed merge or split left a part.
std::vector<std::filesystem::path> list_shards(const std::filesystem::path& folder);

/// Reads and checks every shard of a folder. If its examples belong to several identities (`weft generate
/// --accept-changed`), the dataset gets an identity of its own.
/// @param max_examples stop after this many; 0: all.
/// @throws ConfigError for a damaged shard, shards of different datasets, or a folder without shards.
Dataset load_dataset(const std::filesystem::path& folder, std::size_t max_examples = 0,
                     ShapesIn shapes = ShapesIn::memory);
/// Adds the examples of another dataset of the same task, with another distribution or seed. Examples keep their split.
/// @throws ConfigError if garment, trajectory, hands or the shares of the splits differ, or for the same dataset twice.
void append_dataset(Dataset& dataset, Dataset other);

/// Copies the shards of several folders of one dataset into one. @return number of files.
/// @param cancelled asked before every file.
/// @throws ConfigError if the datasets differ, or if two folders hold different examples with the same number.
/// @throws Interrupted if the user asked to stop. Nothing is left then.
std::int64_t merge_datasets(const std::vector<std::filesystem::path>& from, const std::filesystem::path& to,
                            const Cancelled& cancelled = {});
/// Writes each split as a dataset: to/train, to/validation, to/test. @return the number of examples in each.
/// @throws ConfigError, Interrupted.
std::array<std::int64_t, 3> split_dataset(const std::filesystem::path& from, const std::filesystem::path& to,
                                          const Cancelled& cancelled = {});

}  // namespace weft
