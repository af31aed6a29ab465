#include "weft/dataset.hpp"

#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>

#include "sdk/fingerprint.hpp"
#include "sdk/listed.hpp"
#include "weft/config.hpp"
#include "weft/random.hpp"

namespace weft {
namespace {

constexpr std::uint64_t kSplitKey = 0x73706c6974ull;

/// manipulation.opens_at of a dataset's config as Manipulation has it; a config without it: empty.
std::vector<double> opening_of(const std::string& config) {
  const ConfigNode root = ConfigNode::parse(config, "/config of the dataset");
  const auto manipulation = root.is_mapping() ? root.find("manipulation") : std::nullopt;
  const auto list = manipulation && manipulation->is_mapping() ? manipulation->find("opens_at") : std::nullopt;
  std::vector<double> opens_at;
  for (std::size_t k = 0; list && list->is_sequence() && k < list->size(); ++k)
    opens_at.push_back((*list)[k].as_double());
  const bool is_early = std::any_of(opens_at.begin(), opens_at.end(), [](double at) { return at < 1.0; });
  return is_early ? opens_at : std::vector<double>();
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

std::uint64_t Example::checksum(const std::vector<float>& shapes_of_it) const {
  Fingerprint f;
  const auto add = [&f](const auto& matrix) { f.add_values(matrix.data(), static_cast<std::size_t>(matrix.size())); };
  const std::int64_t numbers[] = {index, segments(), released, settle.settled, settle.frames};
  f.add_values(numbers, std::size(numbers));
  const double measured[] = {settle.max_speed, max_grasp_strain};
  f.add_values(measured, std::size(measured));
  add(q);
  add(controls);
  add(states);
  add(targets);
  add(shapes_of_it);
  f.add(failure);
  return f.value();
}

std::vector<float> Example::read_shapes(Index vertices) const {
  if (stored.file == nullptr) return shapes;
  std::vector<float> read;
  read_shapes(vertices, read);
  return read;
}

void Example::read_shapes(Index vertices, std::vector<float>& read) const {
  if (stored.file == nullptr) {
    read = shapes;
    return;
  }
  const auto refuse = [this](const std::string& reason) {
    throw ConfigError(stored.file->string() + ": example " + std::to_string(index) + " " + reason);
  };
  read.resize(static_cast<std::size_t>(failed() ? 0 : (segments() + 1) * vertices * 3));
  const int file = ::open(stored.file->c_str(), O_RDONLY | O_CLOEXEC);
  if (file < 0) refuse(std::string("cannot be read: ") + std::strerror(errno));
  // Examples are drawn at random: what lies behind this one in the file is not wanted.
  ::posix_fadvise(file, 0, 0, POSIX_FADV_RANDOM);
  std::size_t done = 0;
  const std::size_t bytes = read.size() * sizeof(float);
  std::string problem;
  while (done < bytes && problem.empty()) {
    const ::ssize_t got = ::pread(file, reinterpret_cast<char*>(read.data()) + done, bytes - done,
                                  static_cast<::off_t>(stored.at + done));
    if (got < 0 && errno == EINTR) continue;
    if (got < 0) problem = std::string("cannot be read: ") + std::strerror(errno);
    if (got == 0) problem = "is missing: the file was cut short";
    if (got > 0) done += static_cast<std::size_t>(got);
  }
  ::close(file);
  if (!problem.empty()) refuse(problem);
  if (checksum(read) != stored.checksum) refuse("is damaged: it does not have its recorded checksum");
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
  const std::vector<float> read = e.stored.file != nullptr ? e.read_shapes(header.vertices) : std::vector<float>();
  const float* shapes = e.stored.file != nullptr ? read.data() : e.shapes.data();
  return Eigen::Map<const Single>(shapes + segment * header.vertices * 3, header.vertices, 3).cast<double>();
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
    fail("belongs to another trajectory: controls " + listed(header.control_names, " ") + ", the task has " +
         listed(names(task.trajectory->controls()), " "));
  }
  const std::vector<double> opens_at = opening_of(header.config);
  const Vector& wanted = task.manipulation.opens_at;
  if (!std::equal(opens_at.begin(), opens_at.end(), wanted.begin(), wanted.end()))
    fail("belongs to another manipulation: manipulation.opens_at differs from the task's");
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
