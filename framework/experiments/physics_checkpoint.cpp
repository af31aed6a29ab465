#include "experiments/physics_checkpoint.hpp"

#include "experiments/json_numbers.hpp"
#include "sdk/files.hpp"
#include "sdk/json_text.hpp"

namespace weft {

using nlohmann::ordered_json;

ordered_json exact_json(const PhysicsRow& row) {
  auto seeds = ordered_json::array();
  for (const auto& [seed, value] : row.by_seed) seeds.push_back({seed, exact(value)});
  return {{"test", row.test},
          {"variant", row.variant},
          {"name", row.name},
          {"quantity", row.quantity},
          {"numbers", {exact(row.reference), exact(row.measured), exact(row.error), exact(row.bound)}},
          {"passed", row.passed},
          {"note", row.note},
          {"by_seed", seeds}};
}

PhysicsRow exact_physics_row(const ordered_json& json) {
  PhysicsRow row;
  row.test = json.at("test").get<std::string>();
  row.variant = json.at("variant").get<std::string>();
  row.name = json.at("name").get<std::string>();
  row.quantity = json.at("quantity").get<std::string>();
  const auto& numbers = json.at("numbers");
  row.reference = exact_of(numbers.at(0));
  row.measured = exact_of(numbers.at(1));
  row.error = exact_of(numbers.at(2));
  row.bound = exact_of(numbers.at(3));
  row.passed = json.at("passed").get<bool>();
  row.note = json.at("note").get<std::string>();
  for (const auto& one : json.at("by_seed"))
    row.by_seed.emplace_back(one.at(0).get<std::uint64_t>(), exact_of(one.at(1)));
  return row;
}

PhysicsCheckpoint::PhysicsCheckpoint(const std::filesystem::path& folder, const Identity& identity,
                                     const std::vector<PhysicsCase>& cases, bool accept_changed)
    : file_(folder / "physics.checkpoint.json"), identity_(identity), cases_(cases) {
  const auto text = whole_text_if_there(file_);
  if (!text) return;
  const auto json = parse_json_if_valid(*text);
  const std::string damaged = file_.string() + ": is damaged; remove it to run all cases again";
  if (!json.is_object()) throw ConfigError(damaged);
  const Identity earlier = identity_in(*text, file_.string());
  try {
    require_identity(folder.string(), earlier, identity, accept_changed);
    if (!identity.changes_since(earlier).empty()) return;
    for (const auto& one : json.at("cases")) {
      const auto number = one.at("case").get<std::size_t>();
      if (number >= cases.size() || one.at("name") != name_of(number)) continue;
      for (const auto& row : one.at("rows")) earlier_[number].push_back(exact_physics_row(row));
    }
  } catch (const ordered_json::exception&) {
    throw ConfigError(damaged);
  }
  done_ = earlier_;
}

const std::vector<PhysicsRow>* PhysicsCheckpoint::rows(std::size_t number) const {
  const auto found = earlier_.find(number);
  return found == earlier_.end() ? nullptr : &found->second;
}

void PhysicsCheckpoint::add(std::size_t number, const std::vector<PhysicsRow>& rows) {
  const std::lock_guard lock(mutex_);
  done_[number] = rows;
  ordered_json json{{"identity", parse_json(identity_.to_json())}, {"cases", ordered_json::array()}};
  for (const auto& [one, its_rows] : done_) {
    auto list = ordered_json::array();
    for (const auto& row : its_rows) list.push_back(exact_json(row));
    json["cases"].push_back({{"case", one}, {"name", name_of(one)}, {"rows", std::move(list)}});
  }
  write_text(file_, text_of_json(json));
}

void PhysicsCheckpoint::remove() const {
  std::error_code ignored;
  std::filesystem::remove(file_, ignored);
}

}  // namespace weft
