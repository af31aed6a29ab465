#pragma once
#include <filesystem>
#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <string>
#include <vector>

#include "experiments/sweep.hpp"

/// The rows of a sweep on disk: cells/seedS-HASH.json, one file per cell, with its clock times beside it in
/// cells/seedS-HASH.times.json; identities/HASH.json, what cells belong to.
namespace weft {

/// What a sweep's folder holds already.
struct SweepFolder {
  std::vector<SweepRow> rows;                 ///< of cells that the plan asks for
  std::vector<std::filesystem::path> others;  ///< row files of cells that it does not ask for; they stay
};

/// Reads the rows of a folder; changes nothing. Rows of earlier versions are read, too.
/// @param accept_changed keep rows that belong to another identity than their arm; SweepRow::changes says what differs.
/// @throws ConfigError naming what differs, unless it is accepted; also for a damaged row.
SweepFolder read_sweep(const SweepPlan& plan, const std::filesystem::path& folder, bool accept_changed);

/// The identities that a sweep's folder names; empty if there is no such folder.
std::vector<Identity> recorded_identities(const std::filesystem::path& folder);
/// Writes the identities of all arms. Other machines that join the sweep take their numeric variants from there.
void write_identities(const SweepPlan& plan, const std::filesystem::path& folder);

/// 8 hexadecimal digits of an arm's name, in the names of its files.
std::string arm_hash(const SweepArm& arm);
/// The file of a cell's row.
std::filesystem::path row_file(const SweepPlan& plan, const std::filesystem::path& folder, std::size_t arm,
                               std::uint64_t seed);
/// The file of the times of a row.
std::filesystem::path times_file(const std::filesystem::path& row);
/// Writes a row to row.file, whole or not at all; before it the row's times.
void write_row(const SweepPlan& plan, const SweepRow& row);

/// A list of the rows that a plan does not ask for, for people; empty if there are none.
std::string other_rows_text(const std::vector<std::filesystem::path>& others);
/// Seeds as `1-4, 7`, for messages.
std::string list_of_seeds(std::vector<std::uint64_t> seeds);
/// Adds to a result under `mixed` the rows of an arm that belong to another identity than the others; nothing if there
/// are none. @param arm nullopt: of all arms.
void add_mixed(nlohmann::ordered_json& result, const std::vector<SweepRow>& rows, std::optional<std::size_t> arm);
/// Per arm the rows that belong to another identity and what differs, for people; empty if there are none.
std::string mixed_rows_text(const SweepPlan& plan, const std::vector<SweepRow>& rows);

}  // namespace weft
