#include "weft/dataset.hpp"

#include <algorithm>

#include "weft/random.hpp"

namespace weft {
namespace {

constexpr std::uint64_t kSplitKey = 0x73706c6974ull;

std::string join(const std::vector<std::string>& words) {
  std::string text;
  for (const auto& word : words) text += (text.empty() ? "" : " ") + word;
  return text;
}

}  // namespace

Split split_named(const std::string& name) {
  const auto found = std::find(kSplitNames.begin(), kSplitNames.end(), name);
  if (found == kSplitNames.end()) throw ConfigError("'" + name + "' must be one of train, validation, test");
  return static_cast<Split>(found - kSplitNames.begin());
}

std::optional<Split> split_or_all(const std::string& name) {
  if (name == "all") return {};
  return split_named(name);
}

Split DatasetOrigin::split(std::int64_t index) const {
  const double u = RandomStream(kSplitKey, static_cast<std::uint64_t>(index)).uniform();
  if (u < test_fraction) return Split::test;
  return u < test_fraction + validation_fraction ? Split::validation : Split::train;
}

std::size_t Dataset::source(std::size_t example) const {
  if (begins.empty()) return 0;
  return static_cast<std::size_t>(std::upper_bound(begins.begin(), begins.end(), example) - begins.begin()) - 1;
}

std::vector<std::size_t> Dataset::select(std::optional<Split> split) const {
  std::vector<std::size_t> chosen;
  for (std::size_t i = 0; i < examples.size(); ++i) {
    if (!examples[i].failed() && (!split || header.split(examples[i].index) == *split)) chosen.push_back(i);
  }
  return chosen;
}

Positions Dataset::shape(std::size_t example, Index segment) const {
  const auto& e = examples.at(example);
  if (segment < 0 || segment > e.segments() || e.failed()) {
    throw ShapeError("example " + std::to_string(e.index) + " has no shape after segment " + std::to_string(segment));
  }
  using Single = Eigen::Matrix<float, Eigen::Dynamic, 3, Eigen::RowMajor>;
  return Eigen::Map<const Single>(e.shapes.data() + segment * header.vertices * 3, header.vertices, 3).cast<double>();
}

void Dataset::require_task(const Task& task) const {
  const auto fail = [&](const std::string& what) { throw ConfigError("dataset " + header.identity + ": " + what); };
  if (header.garment_hash != task.garment->hash) {
    fail("belongs to the garment '" + header.garment_name + "' (hash " + std::to_string(header.garment_hash) +
         "), the task has '" + task.garment->name + "' (hash " + std::to_string(task.garment->hash) + ")");
  }
  const auto names = [](const std::vector<Variable>& variables) {
    std::vector<std::string> all;
    for (const auto& v : variables) all.push_back(v.name);
    return all;
  };
  if (header.control_names != names(task.trajectory->controls()) ||
      header.state_names != names(task.trajectory->state())) {
    fail("belongs to another trajectory: controls " + join(header.control_names) + ", the task has " +
         join(names(task.trajectory->controls())));
  }
  for (const auto& e : examples) {
    if (e.failed()) continue;
    const Vector start = task.trajectory->initial_state(task.manipulation);
    const Positions targets = task.trajectory->targets(task.manipulation, start);
    const Eigen::Map<const Vector> flat_targets(targets.data(), targets.size());
    if (flat_targets.size() != e.targets.cols() || !e.states.row(0).transpose().isApprox(start, 1e-9) ||
        !e.targets.row(0).transpose().isApprox(flat_targets, 1e-9)) {
      fail("belongs to another manipulation: grasp points or displacement differ from the task's");
    }
    break;
  }
}

}  // namespace weft
