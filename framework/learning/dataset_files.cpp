#include "learning/dataset_files.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <map>
#include <optional>
#include <set>

#include "identity/identity.hpp"
#include "sdk/files.hpp"
#include "sdk/fingerprint.hpp"
#include "sdk/garment_arrays.hpp"
#include "sdk/listed.hpp"
#include "weft/hdf5_file.hpp"

namespace weft {
namespace {

namespace fs = std::filesystem;

constexpr const char* kSchema = "weft dataset 2";
constexpr const char* kFirstSchema = "weft dataset 1";  // compressed shapes, no checksum per example
constexpr Index kMostSegments = 100000;

std::vector<std::string> words_of(const std::string& text) {
  std::vector<std::string> words(1);
  for (const char c : text) {
    if (c == ' ') {
      words.emplace_back();
    } else {
      words.back() += c;
    }
  }
  if (words.back().empty()) words.pop_back();
  return words;
}

std::vector<double> flat(const Controls& m) { return {m.data(), m.data() + m.size()}; }

/// All arrays of a shard as in the file: examples one after the other.
struct Columns {
  std::vector<std::int64_t> index, segments, released, settled, settle_frames;
  std::vector<std::int64_t> checksums;  ///< of each example; empty: schema 1
  std::vector<double> settle_speed, strain, q, controls, states, targets;
  std::vector<float> shapes;
  std::vector<std::string> failures;

  std::string checksum() const {
    Fingerprint f;
    for (const auto* v : {&index, &segments, &released, &settled, &settle_frames}) f.add_values(v->data(), v->size());
    for (const auto* v : {&settle_speed, &strain, &q, &controls, &states, &targets}) f.add_values(v->data(), v->size());
    f.add_values(shapes.data(), shapes.size());
    for (const auto& text : failures) f.add(text);
    if (!checksums.empty()) f.add_values(checksums.data(), checksums.size());
    return f.hex();
  }
};

Columns to_columns(const Shard& shard) {
  Columns c;
  const auto append = [](auto& to, const auto& from) { to.insert(to.end(), from.begin(), from.end()); };
  for (const auto& e : shard.examples) {
    c.index.push_back(e.index);
    c.segments.push_back(e.segments());
    c.released.push_back(e.released);
    c.settled.push_back(e.settle.settled);
    c.settle_frames.push_back(e.settle.frames);
    c.settle_speed.push_back(e.settle.max_speed);
    c.strain.push_back(e.max_grasp_strain);
    for (Index p = 0; p < 4; ++p) c.q.push_back(e.q(p));
    append(c.controls, flat(e.controls));
    append(c.states, flat(e.states));
    append(c.targets, flat(e.targets));
    const std::vector<float> shapes = e.read_shapes(shard.header.vertices);
    append(c.shapes, shapes);
    c.failures.push_back(e.failure);
    c.checksums.push_back(static_cast<std::int64_t>(e.checksum(shapes)));
  }
  return c;
}

[[noreturn]] void refuse(const fs::path& file, const std::string& reason) {
  throw ConfigError(file.string() + ": " + reason);
}

void require_same(const fs::path& file, const DatasetHeader& a, const DatasetHeader& b) {
  if (a.identity == b.identity) return;
  std::string text = "belongs to another dataset (identity " + a.identity + ", wanted " + b.identity + "):";
  const auto changes = identity_in(a.provenance, file.string()).changes_since(identity_in(b.provenance, file.string()));
  for (const auto& change : changes) text += "\n  " + change;
  refuse(file, changes.empty() ? text + " config, seed or garment differ" : text);
}

DatasetHeader read_header(const Hdf5File& file, const fs::path& path) {
  DatasetHeader h;
  h.config = file.read_text("/config");
  h.identity = file.read_text("/identity");
  h.provenance = file.read_text("/provenance");
  h.garment_name = file.read_text("/garment/name");
  try {
    h.seed = std::stoull(file.read_text("/seed"));
    h.garment_hash = std::stoull(file.read_text("/garment/hash"));
  } catch (const std::logic_error&) {
    refuse(path, "/seed or /garment/hash is not a number");
  }
  h.control_names = words_of(file.read_text("/names/controls"));
  h.state_names = words_of(file.read_text("/names/states"));
  const auto sizes = file.read_int("/sizes", 5);
  if (sizes.size() != 5) refuse(path, "/sizes must have 5 entries");
  for (const auto size : sizes) {
    if (size < 1 || size > 1000000) refuse(path, "/sizes holds " + std::to_string(size) + ", must be in [1, 1000000]");
  }
  h.vertices = sizes[0];
  h.garment_form = read_garment_form(file, path.string(), h.vertices);
  h.controls = sizes[1];
  h.states = sizes[2];
  h.hands = sizes[3];
  h.shard_examples = sizes[4];
  if (static_cast<Index>(h.control_names.size()) != h.controls ||
      static_cast<Index>(h.state_names.size()) != h.states) {
    refuse(path, "/names do not fit /sizes");
  }
  const auto fractions = file.read("/split_fractions", 2);
  if (fractions.size() != 2 ||
      !(fractions[0] >= 0 && fractions[0] <= 0.5 && fractions[1] >= 0 && fractions[1] <= 0.5)) {
    refuse(path, "/split_fractions must be two numbers in [0, 0.5]");
  }
  h.validation_fraction = fractions[0];
  h.test_fraction = fractions[1];
  return h;
}

void expect_shape(const Hdf5File& file, const fs::path& path, const char* name, const std::vector<Index>& wanted) {
  const auto got = file.shape(name);
  if (got != wanted) {
    std::string text;
    for (const Index d : got) text += (text.empty() ? "" : ", ") + std::to_string(d);
    refuse(path, std::string(name) + " has the shape [" + text + "], which does not fit the rest");
  }
}

/// The columns with one entry per example, and the failures.
Columns read_examples(const Hdf5File& file, const fs::path& path) {
  Columns c;
  const auto expect = [&](const char* name, const std::vector<Index>& wanted) {
    expect_shape(file, path, name, wanted);
  };
  const auto count_shape = file.shape("/examples/index");
  if (count_shape.size() != 1 || count_shape[0] < 1 || count_shape[0] > 1000000)
    refuse(path, "/examples/index must have the shape [n]");
  const Index n = count_shape[0];
  const auto most = static_cast<std::size_t>(n) * 4;
  const auto ints = [&](const char* name) {
    expect(name, {n});
    return file.read_int(name, most);
  };
  c.index = ints("/examples/index");
  c.segments = ints("/examples/segments");
  c.released = ints("/examples/released");
  c.settled = ints("/examples/settled");
  c.settle_frames = ints("/examples/settle_frames");
  expect("/examples/settle_speed", {n});
  c.settle_speed = file.read("/examples/settle_speed", most);
  expect("/examples/max_grasp_strain", {n});
  c.strain = file.read("/examples/max_grasp_strain", most);
  if (file.has("/examples/checksum")) c.checksums = ints("/examples/checksum");
  expect("/examples/q", {n, 4});
  c.q = file.read("/examples/q", most);
  for (Index i = 0; i < n; ++i) {
    const auto at = static_cast<std::size_t>(i);
    if (c.index[at] < 0 || (i > 0 && c.index[at] <= c.index[at - 1]))
      refuse(path, "/examples/index must ascend from 0 or more");
    if (c.segments[at] < 0 || c.segments[at] > kMostSegments) refuse(path, "/examples/segments is out of range");
    const std::string failure = "/failures/" + std::to_string(c.index[at]);
    c.failures.push_back(file.has(failure) ? file.read_text(failure) : std::string());
    if (c.failures.back().empty() == (c.segments[at] == 0)) {
      refuse(path, "example " + std::to_string(c.index[at]) + " must have either segments or a failure");
    }
  }
  return c;
}

Columns read_columns(const Hdf5File& file, const fs::path& path, const DatasetHeader& h, bool has_shapes) {
  Columns c = read_examples(file, path);
  Index segments = 0, shapes = 0;
  for (const Index k : c.segments) {
    segments += k;
    shapes += k == 0 ? 0 : k + 1;
  }
  const auto expect = [&](const char* name, const std::vector<Index>& wanted) {
    expect_shape(file, path, name, wanted);
  };
  expect("/controls", {segments, h.controls});
  expect("/states", {shapes, h.states});
  expect("/targets", {shapes, 3 * h.hands});
  expect("/shapes", {shapes, h.vertices, 3});
  c.controls = file.read("/controls");
  c.states = file.read("/states");
  c.targets = file.read("/targets");
  if (has_shapes) c.shapes = file.read_float("/shapes");
  const auto finite = [](const auto& v) {
    return std::all_of(v.begin(), v.end(), [](auto x) { return std::isfinite(x); });
  };
  for (const auto* v : {&c.settle_speed, &c.strain, &c.q, &c.controls, &c.states, &c.targets}) {
    if (!finite(*v)) refuse(path, "holds a number that is not finite");
  }
  if (!finite(c.shapes)) refuse(path, "/shapes holds a number that is not finite");
  return c;
}

/// @param stored where the shapes lie that the columns do not hold, in all.
std::vector<Example> to_examples(const Columns& c, const DatasetHeader& h, const StoredShapes& stored) {
  std::vector<Example> examples;
  std::size_t segment = 0, shape = 0;
  for (std::size_t i = 0; i < c.index.size(); ++i) {
    Example e;
    e.index = c.index[i];
    e.released = c.released[i] != 0;
    e.settle = {c.settle_frames[i], c.settle_speed[i], c.settled[i] != 0};
    e.max_grasp_strain = c.strain[i];
    for (Index p = 0; p < 4; ++p) e.q(p) = c.q[4 * i + static_cast<std::size_t>(p)];
    e.failure = c.failures[i];
    const auto k = static_cast<Index>(c.segments[i]);
    const Index rows = k == 0 ? 0 : k + 1;
    const auto block = [](const std::vector<double>& from, std::size_t row, Index count, Index columns) {
      return Controls(
          Eigen::Map<const Controls>(from.data() + row * static_cast<std::size_t>(columns), count, columns));
    };
    e.controls = block(c.controls, segment, k, h.controls);
    e.states = block(c.states, shape, rows, h.states);
    e.targets = block(c.targets, shape, rows, 3 * h.hands);
    const auto width = static_cast<std::size_t>(h.vertices) * 3;
    const std::size_t first = shape * width, end = first + static_cast<std::size_t>(rows) * width;
    if (stored.file != nullptr) {
      e.stored = {stored.file, stored.at + first * sizeof(float), static_cast<std::uint64_t>(c.checksums[i])};
    } else {
      e.shapes.assign(c.shapes.begin() + static_cast<std::ptrdiff_t>(first),
                      c.shapes.begin() + static_cast<std::ptrdiff_t>(end));
    }
    segment += static_cast<std::size_t>(k);
    shape += static_cast<std::size_t>(rows);
    examples.push_back(std::move(e));
  }
  return examples;
}

}  // namespace

void write_shard(const fs::path& path, const Shard& shard) {
  const auto& h = shard.header;
  const Columns c = to_columns(shard);
  const auto n = static_cast<Index>(c.index.size());
  auto file = Hdf5File::create(path);
  file.write("/schema", std::string(kSchema));
  file.write("/config", h.config);
  file.write("/identity", h.identity);
  file.write("/provenance", h.provenance);
  file.write("/seed", std::to_string(h.seed));
  file.write("/checksum", c.checksum());
  file.write("/garment/name", h.garment_name);
  file.write("/garment/hash", std::to_string(h.garment_hash));
  write_garment_form(file, h.garment_form);
  file.write("/names/controls", listed(h.control_names, " "));
  file.write("/names/states", listed(h.state_names, " "));
  const std::int64_t sizes[5] = {h.vertices, h.controls, h.states, h.hands, h.shard_examples};
  file.write("/sizes", {5}, sizes);
  const double fractions[2] = {h.validation_fraction, h.test_fraction};
  file.write("/split_fractions", {2}, fractions);
  const auto ints = [&](const char* name, const std::vector<std::int64_t>& v) { file.write(name, {n}, v.data()); };
  ints("/examples/index", c.index);
  ints("/examples/segments", c.segments);
  ints("/examples/released", c.released);
  ints("/examples/settled", c.settled);
  ints("/examples/settle_frames", c.settle_frames);
  ints("/examples/checksum", c.checksums);
  file.write("/examples/settle_speed", {n}, c.settle_speed.data());
  file.write("/examples/max_grasp_strain", {n}, c.strain.data());
  file.write("/examples/q", {n, 4}, c.q.data());
  Index segments = 0, shapes = 0;
  for (const auto& e : shard.examples) {
    segments += e.segments();
    shapes += e.failed() ? 0 : e.segments() + 1;
  }
  file.write("/controls", {segments, h.controls}, c.controls.data());
  file.write("/states", {shapes, h.states}, c.states.data());
  file.write("/targets", {shapes, 3 * h.hands}, c.targets.data());
  file.write_plain("/shapes", {shapes, h.vertices, 3}, c.shapes.data());
  for (const auto& e : shard.examples) {
    if (e.failed()) file.write("/failures/" + std::to_string(e.index), e.failure);
  }
  file.commit();
}

namespace {

Hdf5File open_shard(const fs::path& path) {
  auto file = Hdf5File::open(path);
  if (!file.has("/schema")) refuse(path, "is not a weft dataset");
  if (const auto schema = file.read_text("/schema"); schema != kSchema && schema != kFirstSchema) {
    refuse(path, "has the schema '" + schema + "', this program reads '" + kFirstSchema + "' and '" + kSchema + "'");
  }
  return file;
}

}  // namespace

DatasetHeader read_shard_header(const fs::path& path) { return read_header(open_shard(path), path); }

Shard read_shard(const fs::path& path, ShapesIn shapes) {
  const auto file = open_shard(path);
  Shard shard;
  shard.header = read_header(file, path);
  StoredShapes stored;
  if (shapes == ShapesIn::files && file.has("/examples/checksum")) {
    if (const auto at = file.place("/shapes")) stored = {std::make_shared<const fs::path>(fs::absolute(path)), *at};
  }
  const bool is_whole = stored.file == nullptr;
  const Columns columns = read_columns(file, path, shard.header, is_whole);
  const std::string recorded = file.read_text("/checksum");
  if (const auto got = columns.checksum(); is_whole && got != recorded)
    refuse(path, "is damaged: its content has the checksum " + got + ", not the recorded checksum " + recorded);
  shard.examples = to_examples(columns, shard.header, stored);
  return shard;
}

std::string shard_name(std::int64_t number) {
  char text[40];
  std::snprintf(text, sizeof(text), "shard-%05lld.h5", static_cast<long long>(number));
  return text;
}

namespace {

/// Where the files of a merge or split lie while they are made, and while they are moved to their place.
constexpr const char *kUnfinished = ".weft-unfinished", *kMoving = ".weft-moving";

std::vector<fs::path> shards_in(const fs::path& folder) {
  std::vector<fs::path> files;
  for (const auto& entry : fs::directory_iterator(folder)) {
    const auto name = entry.path().filename().string();
    if (name.rfind("shard-", 0) == 0 && entry.path().extension() == ".h5") files.push_back(entry.path());
  }
  std::sort(files.begin(), files.end());
  return files;
}

}  // namespace

std::vector<fs::path> list_shards(const fs::path& folder) {
  if (!fs::is_directory(folder)) refuse(folder, "is not a folder");
  if (fs::exists(folder / kMoving))
    refuse(folder, "holds a part of a dataset: `weft dataset` was killed while it wrote it; run that command again");
  return shards_in(folder);
}

Dataset load_dataset(const fs::path& folder, std::size_t max_examples, ShapesIn shapes) {
  Dataset dataset;
  const auto files = list_shards(folder);
  if (files.empty()) refuse(folder, "holds no dataset (no shard-*.h5)");
  std::set<std::string> identities;
  for (const auto& file : files) {
    if (max_examples > 0 && dataset.examples.size() >= max_examples) break;
    Shard shard = read_shard(file, shapes);
    if (dataset.examples.empty()) dataset.header = shard.header;
    require_same(file, shard.header, dataset.header);
    identities.insert(identity_in(shard.header.provenance, file.string()).hash());
    for (auto& e : shard.examples) {
      if (!dataset.examples.empty() && e.index <= dataset.examples.back().index) {
        refuse(file, "example " + std::to_string(e.index) +
                         " is also in another file; `weft dataset merge` removes duplicates");
      }
      if (max_examples == 0 || dataset.examples.size() < max_examples) dataset.examples.push_back(std::move(e));
    }
  }
  if (identities.size() > 1) {
    Fingerprint mixed;
    mixed.add(dataset.header.identity);
    for (const auto& identity : identities) mixed.add(identity);
    dataset.header.identity = mixed.hex();
  }
  return dataset;
}

void append_dataset(Dataset& dataset, Dataset other) {
  auto& header = dataset.header;
  const auto& h = other.header;
  const auto fail = [&](const std::string& what) {
    throw ConfigError("datasets " + header.identity + " and " + h.identity + ": " + what);
  };
  if (h.identity == header.identity) fail("are the same one");
  if (h.garment_hash != header.garment_hash) fail("the garments differ");
  if (h.control_names != header.control_names || h.state_names != header.state_names || h.hands != header.hands)
    fail("the trajectories differ");
  // An example's split depends on its number alone.
  if (h.validation_fraction != header.validation_fraction || h.test_fraction != header.test_fraction)
    fail("data.validation_fraction or data.test_fraction differ");
  if (dataset.appended.empty()) dataset.begins = {0};
  dataset.appended = dataset.origins();
  for (auto& origin : other.origins()) dataset.appended.push_back(std::move(origin));
  if (other.appended.empty()) other.begins = {0};
  for (const std::size_t begin : other.begins) dataset.begins.push_back(dataset.examples.size() + begin);
  Fingerprint f;
  f.add(header.identity);
  f.add(h.identity);
  header.identity = f.hex();
  std::move(other.examples.begin(), other.examples.end(), std::back_inserter(dataset.examples));
}

namespace {

void require_wanted(const Cancelled& cancelled) {
  if (cancelled && cancelled()) throw Interrupted("interrupted; no dataset was written");
}

/// Examples of several files, by the number of the file that they belong in.
std::map<std::int64_t, std::vector<fs::path>> canonical_files(const std::vector<fs::path>& folders,
                                                              DatasetHeader& header, const Cancelled& cancelled) {
  std::map<std::int64_t, std::vector<fs::path>> files;
  bool first = true;
  for (const auto& folder : folders) {
    for (const auto& file : list_shards(folder)) {
      require_wanted(cancelled);
      const Shard shard = read_shard(file);
      if (first) header = shard.header;
      first = false;
      require_same(file, shard.header, header);
      std::set<std::int64_t> numbers;
      for (const auto& e : shard.examples) numbers.insert(e.index / header.shard_examples);
      for (const auto number : numbers) files[number].push_back(file);
    }
  }
  if (first) refuse(folders.empty() ? fs::path("dataset") : folders.front(), "holds no dataset (no shard-*.h5)");
  return files;
}

/// A new dataset whose files appear together: until move() they lie in a folder of their own. Until keep() all of it is
/// taken back when this ends, and a folder that was not there before goes again. What a killed process left is made again.
class NewDataset {
 public:
  /// @param was_killed the folder holds a part of a dataset, which is removed.
  /// @throws ConfigError if the folder holds a dataset, or if no file can be written in it.
  NewDataset(fs::path folder, const std::string& remedy, bool was_killed)
      : folder_(std::move(folder)), unfinished_(folder_ / kUnfinished), is_new_(!fs::exists(folder_)) {
    if (was_killed && !is_new_) {
      for (const auto& file : shards_in(folder_)) fs::remove(file);
      fs::remove_all(folder_ / kMoving);
    } else if (fs::is_directory(folder_) && !shards_in(folder_).empty()) {
      refuse(folder_, "holds a dataset already; " + remedy);
    }
    make_writable_folder(folder_);
    fs::remove_all(unfinished_);
    make_writable_folder(unfinished_);
  }
  ~NewDataset() {
    std::error_code ignored;
    for (const auto& file : moved_) fs::remove(file, ignored);
    fs::remove_all(unfinished_, ignored);
    fs::remove_all(folder_ / kMoving, ignored);
    if (is_new_) fs::remove(folder_, ignored);  // unless it holds files
  }
  NewDataset(const NewDataset&) = delete;
  NewDataset& operator=(const NewDataset&) = delete;

  void add(const fs::path& name, const Shard& shard) const { write_shard(unfinished_ / name, shard); }
  void move() {
    fs::rename(unfinished_, folder_ / kMoving);
    for (const auto& file : shards_in(folder_ / kMoving)) {
      fs::rename(file, folder_ / file.filename());
      moved_.push_back(folder_ / file.filename());
    }
  }
  void keep() {
    fs::remove(folder_ / kMoving);
    moved_.clear();
  }

 private:
  fs::path folder_, unfinished_;
  bool is_new_;
  std::vector<fs::path> moved_;
};

}  // namespace

std::int64_t merge_datasets(const std::vector<fs::path>& from, const fs::path& to, const Cancelled& cancelled) {
  DatasetHeader header;
  const auto files = canonical_files(from, header, cancelled);
  NewDataset merging(to, "merge into an empty folder", fs::exists(to / kMoving));
  for (const auto& [number, sources] : files) {
    std::map<std::int64_t, Example> examples;
    Shard merged;
    merged.header = header;
    for (const auto& source : sources) {
      require_wanted(cancelled);
      Shard shard = read_shard(source);
      for (auto& e : shard.examples) {
        if (e.index / header.shard_examples != number) continue;
        const auto found = examples.find(e.index);
        if (found == examples.end()) {
          if (examples.empty()) merged.header = shard.header;
          examples.emplace(e.index, std::move(e));
        } else if (found->second.checksum(found->second.shapes) != e.checksum(e.shapes)) {
          refuse(source,
                 "example " + std::to_string(e.index) + " differs from the one of the same number in another folder");
        }
      }
    }
    for (auto& [index, e] : examples) merged.examples.push_back(std::move(e));
    merging.add(shard_name(number), merged);
  }
  merging.move();
  merging.keep();
  return static_cast<std::int64_t>(files.size());
}

std::array<std::int64_t, 3> split_dataset(const fs::path& from, const fs::path& to, const Cancelled& cancelled) {
  const auto files = list_shards(from);
  if (files.empty()) refuse(from, "holds no dataset (no shard-*.h5)");
  std::array<std::int64_t, 3> counts{};
  // The parts belong together: what was killed while it moved the files of one is made again as a whole.
  const bool was_killed = std::any_of(std::begin(kSplitNames), std::end(kSplitNames),
                                      [&](const auto& name) { return fs::exists(to / name / kMoving); });
  std::array<std::optional<NewDataset>, 3> parts;
  for (std::size_t s = 0; s < 3; ++s) parts[s].emplace(to / kSplitNames[s], "split into an empty folder", was_killed);
  for (const auto& file : files) {
    require_wanted(cancelled);
    Shard shard = read_shard(file);
    for (std::size_t s = 0; s < 3; ++s) {
      Shard part;
      part.header = shard.header;
      for (const auto& e : shard.examples) {
        if (shard.header.split(e.index) == static_cast<Split>(s)) part.examples.push_back(e);
      }
      counts[s] += static_cast<std::int64_t>(part.examples.size());
      if (!part.examples.empty()) parts[s]->add(file.filename(), part);
    }
  }
  for (auto& part : parts) part->move();
  for (auto& part : parts) part->keep();
  return counts;
}

}  // namespace weft
