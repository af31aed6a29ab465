#pragma once
#include <filesystem>
#include <map>
#include <mutex>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "experiments/physics/physics.hpp"
#include "identity/identity.hpp"

namespace weft {

/// A row for another process or a later one: with every bit of its numbers.
nlohmann::ordered_json exact_json(const PhysicsRow& row);
/// @throws nlohmann::json::exception, ConfigError if it is no such row.
PhysicsRow exact_physics_row(const nlohmann::ordered_json& json);

/// The cases that `evaluate physics` has finished, in a file, until it has all of them. So a command that was stopped or
/// killed goes on.
class PhysicsCheckpoint {
 public:
  /// Reads what an earlier process left, if it belongs to the same identity. Writes nothing.
  /// @param holder of the file, for messages. @param cases must outlive this.
  /// @throws ConfigError for another identity, unless that is accepted: then its cases run again.
  PhysicsCheckpoint(const std::filesystem::path& folder, const Identity& identity,
                    const std::vector<PhysicsCase>& cases, bool accept_changed);
  /// The rows of a finished case; null: it must run.
  const std::vector<PhysicsRow>* rows(std::size_t number) const;
  /// Keeps the rows of a case that has run to its end. Thread-safe. @throws WriteError.
  void add(std::size_t number, const std::vector<PhysicsRow>& rows);
  /// All results are written.
  void remove() const;

 private:
  std::string name_of(std::size_t number) const { return cases_[number].test + ": " + cases_[number].name; }
  std::filesystem::path file_;
  Identity identity_;
  const std::vector<PhysicsCase>& cases_;
  std::map<std::size_t, std::vector<PhysicsRow>> earlier_;
  std::mutex mutex_;
  std::map<std::size_t, std::vector<PhysicsRow>> done_;  ///< with the earlier ones
};

}  // namespace weft
