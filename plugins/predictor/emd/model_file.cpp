#include "model_file.hpp"

#include <algorithm>
#include <cmath>

#include "weft/hash.hpp"
#include "weft/hdf5_file.hpp"

namespace weft::emd {
namespace {

constexpr const char* kSchema = "weft emd model 4";
constexpr const char* kSchema3 = "weft emd model 3";  // without /calibration_datasets
constexpr const char* kSchema2 = "weft emd model 2";  // without /calibration_datasets and /calibration_added
constexpr const char* kSchema1 = "weft emd model 1";  // without those two and /datasets, and with checksum_1
constexpr Index kMostDatasets = 1000;

/// Checksum of everything that a file holds.
/// @param architecture the text in the file: a later version may word the same architecture differently.
std::string checksum(const Model& m, const std::string& architecture) {
  Fnv1a hash;
  const auto add = [&](const auto&... all) {
    const auto one = [&](const auto& v) {
      const std::uint64_t size = v.size();
      hash.add(&size, sizeof(size));
      hash.add(v.data(), v.size() * sizeof(v[0]));
    };
    (one(all), ...);
  };
  const auto& d = m.dimensions;
  add(architecture, std::vector<std::int64_t>{d.vertices, d.controls, d.states, d.hands});
  add(m.weights, m.mean, m.basis, m.scale, m.input_mean, m.input_sd, m.calibration);
  if (!m.calibration_added.empty()) add(m.calibration_added);
  add(m.garment_name, std::to_string(m.garment_hash), m.grasp_vertices);
  for (const auto* names : {&m.control_names, &m.state_names}) {
    for (const auto& name : *names) add(name);
  }
  add(m.control_low, m.control_high, m.initial_state, m.initial_targets, m.displacement);
  add(std::vector<double>{m.drop_height, m.contact_height}, m.material, m.dataset, m.provenance, m.training);
  if (!m.opens_at.empty()) add(std::string("opens_at"), m.opens_at);
  const auto add_datasets = [&](const std::vector<DatasetOrigin>& datasets) {
    for (const auto& one : datasets) {
      add(one.identity, std::to_string(one.seed), std::vector<double>{one.validation_fraction, one.test_fraction});
    }
  };
  add_datasets(m.datasets);
  if (!m.calibrated.empty()) add(std::string("calibrated"));  // marks where the other list begins
  add_datasets(m.calibrated);
  return std::to_string(hash.value());
}
/// The checksum of kSchema1, which covers the network alone.
std::string checksum_1(const Model& m) {
  Fnv1a hash;
  for (const auto* v : {&m.weights, &m.mean, &m.basis, &m.scale, &m.input_mean, &m.input_sd, &m.calibration}) {
    hash.add(v->data(), v->size() * sizeof(float));
  }
  return std::to_string(hash.value());
}

/// The values as a mapping that read_params reads back.
std::string write_architecture(Architecture architecture) {
  struct Writer {
    std::vector<std::pair<std::string, ConfigNode>> out;
    void operator()(const char* name, double& v, const Range&, const char*) {
      out.emplace_back(name, ConfigNode::number(v));
    }
    void operator()(const char* name, std::int64_t& v, const Range&, const char*) {
      out.emplace_back(name, ConfigNode::integer(v));
    }
    void operator()(const char* name, bool& v, const char*) { out.emplace_back(name, ConfigNode::boolean(v)); }
    void operator()(const char* name, std::string& v, const Choice&, const char*) {
      out.emplace_back(name, ConfigNode::quoted(v));
    }
  } writer;
  architecture.visit(writer);
  return ConfigNode::mapping(writer.out).to_yaml();
}

class ModelWriter {
 public:
  ModelWriter(const std::filesystem::path& path, const Model& model, bool half_precision)
      : m_(model), half_(half_precision), file_(Hdf5File::create(path)) {}

  void write() {
    file_.write("/schema", std::string(kSchema));
    const std::string architecture = write_architecture(m_.architecture);
    file_.write("/architecture", architecture);
    const auto& d = m_.dimensions;
    const std::int64_t sizes[4] = {d.vertices, d.controls, d.states, d.hands};
    file_.write("/sizes", {4}, sizes);
    write_network();
    write_calibration();
    file_.write("/checksum", checksum(m_, architecture));
    write_task();
    file_.write("/dataset", m_.dataset);
    write_origins("/datasets", m_.datasets);
    write_origins("/calibration_datasets", m_.calibrated);
    file_.write("/provenance", m_.provenance);
    file_.write("/training", m_.training);
    file_.commit();
  }

 private:
  template <class T>
  void write_vector(const std::string& name, const std::vector<T>& v) {
    file_.write(name, {static_cast<Index>(v.size())}, v.data());
  }
  /// Writes numbers in the file's precision.
  void write_matrix(const std::string& name, Index rows, Index columns, const float* data) {
    half_ ? file_.write_half(name, {rows, columns}, data) : file_.write(name, {rows, columns}, data);
  }

  void write_network() {
    for (const auto& w : Layout(m_.architecture, m_.dimensions).weights) {
      write_matrix("/weights/" + w.name, w.rows, w.columns, m_.weights.data() + w.offset);
    }
    write_vector("/normalisation/mean", m_.mean);
    if (m_.needs_basis()) {
      write_matrix("/normalisation/basis", m_.dimensions.coordinates(), m_.architecture.latent, m_.basis.data());
      write_vector("/normalisation/scale", m_.scale);
    }
    write_vector("/normalisation/input_mean", m_.input_mean);
    write_vector("/normalisation/input_sd", m_.input_sd);
  }

  void write_calibration() {
    const std::vector<Index> shape = {2, 2, static_cast<Index>(m_.calibration.size() / 4)};
    file_.write("/calibration", shape, m_.calibration.data());
    if (!m_.calibration_added.empty()) file_.write("/calibration_added", shape, m_.calibration_added.data());
  }

  void write_task() {
    file_.write("/garment/name", m_.garment_name);
    file_.write("/garment/hash", std::to_string(m_.garment_hash));
    write_vector("/garment/grasp_vertices", m_.grasp_vertices);
    file_.write("/trajectory/controls", join(m_.control_names));
    file_.write("/trajectory/states", join(m_.state_names));
    write_vector("/trajectory/control_low", m_.control_low);
    write_vector("/trajectory/control_high", m_.control_high);
    write_vector("/manipulation/initial_state", m_.initial_state);
    write_vector("/manipulation/initial_targets", m_.initial_targets);
    write_vector("/manipulation/displacement", m_.displacement);
    write_vector("/manipulation/heights", std::vector<double>{m_.drop_height, m_.contact_height});
    if (!m_.opens_at.empty()) write_vector("/manipulation/opens_at", m_.opens_at);
    file_.write("/material", m_.material);
  }

  void write_origins(const std::string& group, const std::vector<DatasetOrigin>& datasets) {
    if (datasets.empty()) return;
    std::vector<std::string> identities, seeds;
    std::vector<double> fractions;
    for (const auto& one : datasets) {
      identities.push_back(one.identity);
      seeds.push_back(std::to_string(one.seed));
      fractions.insert(fractions.end(), {one.validation_fraction, one.test_fraction});
    }
    file_.write(group + "/identities", join(identities));
    file_.write(group + "/seeds", join(seeds));
    file_.write(group + "/split_fractions", {static_cast<Index>(seeds.size()), 2}, fractions.data());
  }

  const Model& m_;
  bool half_;
  Hdf5File file_;
};

class ModelReader {
 public:
  explicit ModelReader(const std::filesystem::path& path) : path_(path), file_(Hdf5File::open(path)) {}

  Model read() {
    const std::string schema = read_schema();
    const std::string architecture = file_.read_text("/architecture");
    read_params(ConfigNode::parse(architecture, path_.string() + ": /architecture"), m_.architecture);
    read_sizes();
    read_network();
    read_normalisation();
    read_calibration();
    read_task();
    m_.dataset = file_.read_text("/dataset");
    m_.datasets = origins("/datasets");
    m_.calibrated = origins("/calibration_datasets");
    m_.provenance = file_.read_text("/provenance");
    m_.training = file_.read_text("/training");
    const std::string got = schema == kSchema1 ? checksum_1(m_) : checksum(m_, architecture);
    if (const auto recorded = file_.read_text("/checksum"); got != recorded)
      refuse("is damaged: its content has the checksum " + got + ", not the recorded checksum " + recorded);
    return std::move(m_);
  }

 private:
  [[noreturn]] void refuse(const std::string& reason) const { throw ConfigError(path_.string() + ": " + reason); }

  std::string read_schema() const {
    if (!file_.has("/schema")) refuse("is not a model of the predictor emd");
    const auto schema = file_.read_text("/schema");
    if (schema != kSchema && schema != kSchema3 && schema != kSchema2 && schema != kSchema1) {
      refuse("has the schema '" + schema + "', this program reads '" + kSchema1 + "' to '" + kSchema + "'");
    }
    return schema;
  }

  void read_sizes() {
    const auto sizes = file_.read_int("/sizes", 4);
    if (sizes.size() != 4) refuse("/sizes must have 4 entries");
    for (const auto size : sizes) {
      if (size < 1 || size > 100000) refuse("/sizes holds " + std::to_string(size) + ", must be in [1, 100000]");
    }
    auto& d = m_.dimensions;
    d = {sizes[0], sizes[1], sizes[2], sizes[3]};
    if (d.controls > 64 || d.states > 64 || d.hands > 16)
      refuse("/sizes has more controls, states or hands than any trajectory");
  }

  void read_network() {
    const Layout layout(m_.architecture, m_.dimensions);
    if (layout.size > (1u << 28)) {
      refuse("describes a network of " + std::to_string(layout.size) + " weights, too large");
    }
    // In the order of their offsets. The vector grows as the file holds the data, not as it says.
    for (const auto& w : layout.weights) {
      const auto values = floats("/weights/" + w.name, {w.rows, w.columns});
      m_.weights.insert(m_.weights.end(), values.begin(), values.end());
    }
  }

  void read_normalisation() {
    const auto require_positive = [&](const std::string& name, const std::vector<float>& v) {
      if (std::any_of(v.begin(), v.end(), [](float x) { return !(x > 1e-12f); })) refuse(name + " must be positive");
    };
    const auto& d = m_.dimensions;
    m_.mean = floats("/normalisation/mean", {d.coordinates()});
    if (m_.needs_basis()) {
      m_.basis = floats("/normalisation/basis", {d.coordinates(), m_.architecture.latent});
      m_.scale = floats("/normalisation/scale", {m_.architecture.latent});
      require_positive("/normalisation/scale", m_.scale);
    }
    m_.input_mean = floats("/normalisation/input_mean", {d.inputs()});
    m_.input_sd = floats("/normalisation/input_sd", {d.inputs()});
    require_positive("/normalisation/input_sd", m_.input_sd);
  }

  void read_calibration() {
    const auto shape = file_.shape("/calibration");
    if (shape.size() != 3 || shape[0] != 2 || shape[1] != 2 || shape[2] < 1 || shape[2] > 1000)
      refuse("/calibration must have the shape [2, 2, steps]");
    m_.calibration = floats("/calibration", shape);
    for (const float x : m_.calibration) {
      if (!(x > 1e-3f && x < 1e3f)) refuse("/calibration must be in (0.001, 1000)");
    }
    if (!file_.has("/calibration_added")) return;
    m_.calibration_added = floats("/calibration_added", shape);
    for (const float x : m_.calibration_added) {
      if (!(x >= 0.0f && x < 100.0f)) refuse("/calibration_added must be in [0, 100)");
    }
  }

  void read_task() {
    const auto& d = m_.dimensions;
    m_.garment_name = file_.read_text("/garment/name");
    m_.garment_hash = integer("/garment/hash", file_.read_text("/garment/hash"));
    m_.grasp_vertices = file_.read_int("/garment/grasp_vertices", 64);
    m_.control_names = words("/trajectory/controls", d.controls);
    m_.state_names = words("/trajectory/states", d.states);
    m_.control_low = numbers("/trajectory/control_low", d.controls);
    m_.control_high = numbers("/trajectory/control_high", d.controls);
    for (std::size_t c = 0; c < m_.control_low.size(); ++c) {
      if (m_.control_low[c] > m_.control_high[c])
        refuse("/trajectory/control_low of " + m_.control_names[c] + " lies above control_high");
    }
    m_.initial_state = numbers("/manipulation/initial_state", d.states);
    m_.initial_targets = numbers("/manipulation/initial_targets", 3 * d.hands);
    m_.displacement = numbers("/manipulation/displacement", 2);
    const auto heights = numbers("/manipulation/heights", 2);
    m_.drop_height = heights[0];
    m_.contact_height = heights[1];
    if (file_.has("/manipulation/opens_at")) m_.opens_at = numbers("/manipulation/opens_at", d.hands);
    m_.material = file_.read_text("/material");
  }

  /// Empty when the file has no such group.
  std::vector<DatasetOrigin> origins(const std::string& group) const {
    std::vector<DatasetOrigin> datasets;
    const std::string name = group + "/split_fractions";
    if (!file_.has(name)) return datasets;
    const auto shape = file_.shape(name);
    if (shape.size() != 2 || shape[0] < 1 || shape[0] > kMostDatasets || shape[1] != 2)
      refuse(name + " must have the shape [n, 2]");
    const auto identities = words(group + "/identities", shape[0]), seeds = words(group + "/seeds", shape[0]);
    const auto fractions = numbers(name, 2 * shape[0]);
    for (std::size_t i = 0; i < seeds.size(); ++i)
      datasets.push_back({identities[i], integer(group + "/seeds", seeds[i]), fractions[2 * i], fractions[2 * i + 1]});
    return datasets;
  }

  // Each of these refuses data of another size than the given one, and numbers that are not finite.

  std::vector<float> floats(const std::string& name, const std::vector<Index>& shape) const {
    if (file_.shape(name) != shape) refuse(name + " has a shape that does not fit the architecture");
    std::size_t count = 1;
    for (const Index n : shape) count *= n;
    auto values = file_.read_float(name, count);
    require_finite(name, values);
    return values;
  }
  std::vector<double> numbers(const std::string& name, Index count) const {
    auto values = file_.read(name, 4096);
    if (std::ssize(values) != count) refuse(name + " must have " + std::to_string(count) + " entries");
    require_finite(name, values);
    return values;
  }
  template <class T>
  void require_finite(const std::string& name, const std::vector<T>& values) const {
    for (const T x : values) {
      if (!std::isfinite(x)) refuse(name + " holds a number that is not finite");
    }
  }
  std::vector<std::string> words(const std::string& name, Index count) const {
    std::vector<std::string> all(1);
    for (const char c : file_.read_text(name)) {
      if (c == ' ') {
        all.emplace_back();
      } else {
        all.back().push_back(c);
      }
    }
    if (std::ssize(all) != count) refuse(name + " must have " + std::to_string(count) + " words");
    return all;
  }
  std::uint64_t integer(const std::string& name, const std::string& text) const {
    try {
      return std::stoull(text);
    } catch (const std::logic_error&) {
      refuse(name + " holds '" + text + "', which is not a number");
    }
  }

  std::filesystem::path path_;
  Hdf5File file_;
  Model m_;
};

}  // namespace

void save_model(const std::filesystem::path& path, const Model& model, bool half_precision) {
  Model stored = model;
  if (half_precision) {  // the checksum covers the rounded numbers, as they will be read back
    for (auto* v : {&stored.weights, &stored.basis}) {
      for (float& x : *v) x = round_to_half(x);
    }
  }
  ModelWriter(path, stored, half_precision).write();
}

Model load_model(const std::filesystem::path& path) { return ModelReader(path).read(); }

float round_to_half(float value) {
  // Adding and subtracting 2^(13 + e) leaves 10 mantissa bits; below the smallest normal half the step is 2^-24.
  const float size = std::abs(value);
  if (size >= 65520.0f) return std::copysign(65504.0f, value);
  int exponent = 0;
  std::frexp(size, &exponent);
  const float step = std::ldexp(1.0f, std::max(exponent - 11, -24));
  return std::copysign(std::nearbyint(size / step) * step, value);
}

bool fits_half(const Model& model) {
  const auto fits = [](const std::vector<float>& v) {
    return std::all_of(v.begin(), v.end(), [](float x) { return round_to_half(x) == x; });
  };
  return fits(model.weights) && fits(model.basis);
}

}  // namespace weft::emd
