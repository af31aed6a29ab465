#include "model.hpp"

#include <algorithm>
#include <cmath>

#include "weft/hdf5_file.hpp"
#include "weft/random.hpp"

namespace weft::emd {
namespace {

constexpr const char* kSchema = "weft emd model 4";
constexpr const char* kSchema3 = "weft emd model 3";  // without /calibration_datasets
constexpr const char* kSchema2 = "weft emd model 2";  // without that and /calibration_added
constexpr const char* kSchema1 = "weft emd model 1";  // without these and /datasets, and with checksum_1
constexpr Index kMostDatasets = 1000;

std::uint64_t mix(std::uint64_t hash, const void* data, std::size_t size) {
  const auto* bytes = static_cast<const unsigned char*>(data);
  for (std::size_t i = 0; i < size; ++i) hash = (hash ^ bytes[i]) * 0x100000001b3ull;
  return hash;
}

/// Of all that a file holds. @param architecture as in the file: a later version may word the same one otherwise.
std::string checksum(const Model& m, const std::string& architecture) {
  std::uint64_t hash = 0xcbf29ce484222325ull;
  const auto add = [&](const auto&... all) {
    const auto one = [&](const auto& v) {
      const std::uint64_t size = v.size();
      hash = mix(hash, &size, sizeof(size));
      hash = mix(hash, v.data(), v.size() * sizeof(v[0]));
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
  const auto add_datasets = [&](const std::vector<DatasetOrigin>& datasets) {
    for (const auto& one : datasets) {
      add(one.identity, std::to_string(one.seed), std::vector<double>{one.validation_fraction, one.test_fraction});
    }
  };
  add_datasets(m.datasets);
  if (!m.calibrated.empty()) add(std::string("calibrated"));  // so that none moves from one list to the other
  add_datasets(m.calibrated);
  return std::to_string(hash);
}
/// What the old schema had: of the network alone.
std::string checksum_1(const Model& m) {
  std::uint64_t hash = 0xcbf29ce484222325ull;
  for (const auto* v : {&m.weights, &m.mean, &m.basis, &m.scale, &m.input_mean, &m.input_sd, &m.calibration}) {
    hash = mix(hash, v->data(), v->size() * sizeof(float));
  }
  return std::to_string(hash);
}

std::vector<std::string> names_of(const std::vector<Variable>& variables) {
  std::vector<std::string> names;
  for (const auto& v : variables) names.push_back(v.name);
  return names;
}
std::string join(const std::vector<std::string>& words) {
  std::string text;
  for (const auto& word : words) text += (text.empty() ? "" : " ") + word;
  return text;
}
std::string list(const std::vector<double>& numbers) {
  std::string text;
  for (const double x : numbers) text += (text.empty() ? "" : ", ") + std::to_string(x);
  return "[" + text + "]";
}
bool close(const std::vector<double>& a, const std::vector<double>& b) {
  return std::equal(a.begin(), a.end(), b.begin(), b.end(), [](double x, double y) { return std::abs(x - y) <= 1e-6; });
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

}  // namespace

Layout::Layout(const Architecture& a, const Dimensions& d) {
  const auto add = [&](const std::string& name, Index rows, Index columns) {
    weights.push_back({name, rows, columns, size});
    size += weights.back().size();
    return static_cast<int>(weights.size()) - 1;
  };
  const Index n = d.coordinates(), z = a.latent + a.memory, u = d.inputs();
  encoder_shape = add("encoder.shape", n, a.encoder_hidden);
  if (a.previous_shape) encoder_velocity = add("encoder.velocity", a.latent, a.encoder_hidden);
  encoder_bias = add("encoder.bias", 1, a.encoder_hidden);
  encoder_out = add("encoder.out", a.encoder_hidden, z);
  encoder_out_bias = add("encoder.out_bias", 1, z);
  for (Index i = 0; i < a.layers; ++i) {
    const std::string name = "module." + std::to_string(i);
    Layer layer;
    layer.h = add(name + ".h", i == 0 ? z : a.hidden, a.hidden);
    if (i == 0 || a.repeat_inputs) layer.u = add(name + ".u", u, a.hidden);
    layer.b = add(name + ".bias", 1, a.hidden);
    layers.push_back(layer);
  }
  out.h = add("module.out.h", a.hidden, z);
  if (a.repeat_inputs) out.u = add("module.out.u", u, z);
  out.b = add("module.out.bias", 1, z);
  decoder_in = add("decoder.in", z, a.decoder_hidden);
  decoder_bias = add("decoder.bias", 1, a.decoder_hidden);
  mean = add("decoder.mean", a.decoder_hidden, n);
  mean_bias = add("decoder.mean_bias", 1, n);
  sigma = add("decoder.sigma", a.decoder_hidden, n);
  sigma_bias = add("decoder.sigma_bias", 1, n);
}

Model::SigmaCalibration Model::sigma_calibration(Index steps, bool from_start, double mean_width) const {
  const std::size_t length = calibration.size() / 4;
  const std::size_t at = (from_start ? 0 : 2 * length) + std::min(static_cast<std::size_t>(steps), length) - 1;
  SigmaCalibration c;
  const double certain = std::log(calibration[at]), unknown = std::log(calibration[at + length]);
  c.factor_slope = unknown - certain;
  c.factor = std::exp(certain + mean_width * c.factor_slope);
  if (calibration_added.empty()) return c;
  const double unit = static_cast<double>(kLength), least = unit * static_cast<double>(calibration_added[at]);
  c.added_slope = unit * static_cast<double>(calibration_added[at + length]) - least;
  c.added = least + mean_width * c.added_slope;
  return c;
}

void Model::describe_task(const Task& task) {
  const auto& m = task.manipulation;
  garment_name = task.garment->name;
  garment_hash = task.garment->hash;
  control_names = names_of(task.trajectory->controls());
  state_names = names_of(task.trajectory->state());
  grasp_vertices.assign(m.grasp_vertices.begin(), m.grasp_vertices.end());
  const Vector state = task.trajectory->initial_state(m);
  initial_state.assign(state.data(), state.data() + state.size());
  const Positions targets = task.trajectory->targets(m, state);
  initial_targets.assign(targets.data(), targets.data() + targets.size());
  drop_height = m.drop_height;
  contact_height = m.contact_height;
  displacement = {m.displacement.x(), m.displacement.y()};
  material = write_material_space(task.material).to_yaml();
  dimensions.vertices = task.garment->vertex_count();
  dimensions.controls = static_cast<Index>(control_names.size());
  dimensions.states = static_cast<Index>(state_names.size());
  dimensions.hands = task.trajectory->hands();
}

std::string Model::require_task(const Task& task, bool allow_other_fabric) const {
  Model wanted;
  wanted.describe_task(task);
  const auto refuse = [](const std::string& what, const std::string& trained, const std::string& given) {
    throw ConfigError("emd: the model was trained for " + what + " " + trained + ", the task has " + given);
  };
  if (garment_hash != wanted.garment_hash) {
    refuse("the garment", "'" + garment_name + "' (hash " + std::to_string(garment_hash) + ")",
           "'" + wanted.garment_name + "' (hash " + std::to_string(wanted.garment_hash) + ")");
  }
  if (control_names != wanted.control_names)
    refuse("a trajectory with the controls", join(control_names), join(wanted.control_names));
  if (state_names != wanted.state_names)
    refuse("a trajectory with the state", join(state_names), join(wanted.state_names));
  if (grasp_vertices != wanted.grasp_vertices) {
    const auto text = [](const std::vector<std::int64_t>& v) { return list({v.begin(), v.end()}); };
    refuse("the grasp vertices", text(grasp_vertices), text(wanted.grasp_vertices));
  }
  if (!close(displacement, wanted.displacement))
    refuse("the displacement", list(displacement), list(wanted.displacement));
  if (!close({drop_height}, {wanted.drop_height}))
    refuse("the drop height", list({drop_height}), list({wanted.drop_height}));
  if (!close({contact_height}, {wanted.contact_height})) {
    refuse("the contact height", list({contact_height}), list({wanted.contact_height}));
  }
  if (!close(initial_state, wanted.initial_state))
    refuse("the initial control state", list(initial_state), list(wanted.initial_state));
  if (!close(initial_targets, wanted.initial_targets))
    refuse("the grasp points", list(initial_targets), list(wanted.initial_targets));
  if (material != wanted.material) {
    const std::string text =
        "emd: the model was trained with another material space than the task's: its properties in [0, 1] stand "
        "for other fabrics";
    if (!allow_other_fabric) throw ConfigError(text + " (predictor.params.other_fabric: warn uses it all the same)");
    return text;
  }
  return {};
}

void draw_weights(const Layout& layout, std::uint64_t seed, std::vector<float>& weights) {
  RandomStream random(seed, 0x77656967687473ull);
  weights.assign(layout.size, 0.0f);
  for (const auto& w : layout.weights) {
    if (w.rows == 1) continue;  // biases start at 0
    double gain = 1.0;
    for (const char* last : {"encoder.out", "module.out.h", "module.out.u", "decoder.mean", "decoder.sigma"}) {
      if (w.name == last) gain = 0.1;
    }
    if (w.name == "encoder.shape") gain = 0.5;  // shapes are smooth: their coordinates add up
    const double sd = gain / std::sqrt(static_cast<double>(w.rows));
    for (std::size_t i = 0; i < w.size(); ++i) weights[w.offset + i] = static_cast<float>(sd * random.normal());
  }
  const auto& bias = layout.weights[static_cast<std::size_t>(layout.sigma_bias)];
  std::fill_n(weights.begin() + static_cast<std::ptrdiff_t>(bias.offset), bias.size(), std::log(0.1f));  // sigma 10 mm
}

Model untrained_model(Architecture architecture, const Task& task, std::uint64_t seed) {
  Model m;
  m.describe_task(task);
  const auto& d = m.dimensions;
  const Index n = d.coordinates();
  architecture.latent = std::min<std::int64_t>(architecture.latent, n);
  m.architecture = architecture;
  draw_weights(Layout(architecture, d), seed, m.weights);
  for (Index i = 0; i < n; ++i) m.mean.push_back(static_cast<float>(task.garment->positions.data()[i]) / kLength);
  if (m.needs_basis()) {
    // Cosines over the garment, made orthonormal: smooth shapes, as principal components are.
    const auto latent = static_cast<Index>(architecture.latent);
    Matrix waves(n, latent);
    RandomStream random(seed, 0x6261736973ull);
    for (Index c = 0; c < latent; ++c) {
      const double a = 12.0 * random.normal(), b = 12.0 * random.normal(), phase = random.uniform(0.0, 6.3),
                   turn = random.uniform(0.0, 6.3);
      for (Index i = 0; i < n; ++i) {
        const auto rest = task.garment->rest.row(i / 3);
        waves(i, c) =
            std::cos(a * rest(0) + b * rest(1) + phase + turn * static_cast<double>(i % 3)) + 0.01 * random.normal();
      }
    }
    for (int pass = 0; pass < 2; ++pass) {  // Gram-Schmidt, twice for accuracy
      for (Index c = 0; c < latent; ++c) {
        for (Index b = 0; b < c; ++b) waves.col(c) -= waves.col(b).dot(waves.col(c)) * waves.col(b);
        waves.col(c).normalize();
      }
    }
    for (Index i = 0; i < n; ++i) {
      for (Index c = 0; c < latent; ++c) m.basis.push_back(static_cast<float>(waves(i, c)));
    }
    m.scale.assign(static_cast<std::size_t>(latent), 1.0f);
  }
  const auto add = [&](double mean, double sd) {
    m.input_mean.push_back(static_cast<float>(mean));
    m.input_sd.push_back(static_cast<float>(sd));
  };
  for (const auto& v : task.trajectory->controls()) {
    add(v.default_value, v.scale);
    m.control_low.push_back(v.lower);
    m.control_high.push_back(v.upper);
  }
  const auto states = task.trajectory->state();
  for (int end = 0; end < 2; ++end) {
    for (std::size_t s = 0; s < states.size(); ++s) add(m.initial_state[s], states[s].scale);
  }
  for (int end = 0; end < 2; ++end) {
    for (const double x : m.initial_targets) add(x, 0.25);
  }
  add(0.0, 0.5);
  for (int p = 0; p < 4; ++p) add(0.5, 0.29);
  for (int p = 0; p < 4; ++p) add(0.33, 0.3);
  m.calibration = {1.0f, 0.9f, 1.3f, 1.4f, 1.1f, 1.0f, 1.2f, 1.5f};  // any, so that tests see them
  m.calibration_added = {0.0f, 0.01f, 0.02f, 0.05f, 0.0f, 0.0f, 0.03f, 0.02f};
  return m;
}

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

void save_model(const std::filesystem::path& path, const Model& model, bool half_precision) {
  Model stored = model;
  if (half_precision) {
    for (auto* v : {&stored.weights, &stored.basis}) {
      for (float& x : *v) x = round_to_half(x);
    }
  }
  const auto& d = stored.dimensions;
  auto file = Hdf5File::create(path);
  file.write("/schema", std::string(kSchema));
  const std::string architecture = write_architecture(stored.architecture);
  file.write("/architecture", architecture);
  const std::int64_t sizes[4] = {d.vertices, d.controls, d.states, d.hands};
  file.write("/sizes", {4}, sizes);
  const auto write = [&](const std::string& name, std::vector<Index> shape, const float* data, bool half) {
    half ? file.write_half(name, shape, data) : file.write(name, shape, data);
  };
  const Layout layout(stored.architecture, d);
  for (const auto& w : layout.weights) {
    write("/weights/" + w.name, {w.rows, w.columns}, stored.weights.data() + w.offset, half_precision);
  }
  const auto vector = [&](const std::string& name, const std::vector<float>& v) {
    file.write(name, {static_cast<Index>(v.size())}, v.data());
  };
  vector("/normalisation/mean", stored.mean);
  if (stored.needs_basis()) {
    write("/normalisation/basis", {d.coordinates(), stored.architecture.latent}, stored.basis.data(), half_precision);
    vector("/normalisation/scale", stored.scale);
  }
  vector("/normalisation/input_mean", stored.input_mean);
  vector("/normalisation/input_sd", stored.input_sd);
  file.write("/calibration", {2, 2, static_cast<Index>(stored.calibration.size() / 4)}, stored.calibration.data());
  if (!stored.calibration_added.empty()) {
    file.write("/calibration_added", {2, 2, static_cast<Index>(stored.calibration.size() / 4)},
               stored.calibration_added.data());
  }
  file.write("/checksum", checksum(stored, architecture));
  file.write("/garment/name", stored.garment_name);
  file.write("/garment/hash", std::to_string(stored.garment_hash));
  file.write("/garment/grasp_vertices", {static_cast<Index>(stored.grasp_vertices.size())},
             stored.grasp_vertices.data());
  file.write("/trajectory/controls", join(stored.control_names));
  file.write("/trajectory/states", join(stored.state_names));
  const auto numbers = [&](const std::string& name, const std::vector<double>& v) {
    file.write(name, {static_cast<Index>(v.size())}, v.data());
  };
  numbers("/trajectory/control_low", stored.control_low);
  numbers("/trajectory/control_high", stored.control_high);
  numbers("/manipulation/initial_state", stored.initial_state);
  numbers("/manipulation/initial_targets", stored.initial_targets);
  numbers("/manipulation/displacement", stored.displacement);
  numbers("/manipulation/heights", {stored.drop_height, stored.contact_height});
  file.write("/material", stored.material);
  file.write("/dataset", stored.dataset);
  const auto origins = [&](const std::string& group, const std::vector<DatasetOrigin>& datasets) {
    if (datasets.empty()) return;
    std::vector<std::string> identities, seeds;
    std::vector<double> fractions;
    for (const auto& one : datasets) {
      identities.push_back(one.identity);
      seeds.push_back(std::to_string(one.seed));
      fractions.insert(fractions.end(), {one.validation_fraction, one.test_fraction});
    }
    file.write(group + "/identities", join(identities));
    file.write(group + "/seeds", join(seeds));
    file.write(group + "/split_fractions", {static_cast<Index>(seeds.size()), 2}, fractions.data());
  };
  origins("/datasets", stored.datasets);
  origins("/calibration_datasets", stored.calibrated);
  file.write("/provenance", stored.provenance);
  file.write("/training", stored.training);
  file.commit();
}

Model load_model(const std::filesystem::path& path) {
  const auto file = Hdf5File::open(path);
  const auto refuse = [&](const std::string& reason) { throw ConfigError(path.string() + ": " + reason); };
  if (!file.has("/schema")) refuse("is no model of the predictor emd");
  const auto schema = file.read_text("/schema");
  if (schema != kSchema && schema != kSchema3 && schema != kSchema2 && schema != kSchema1) {
    refuse("has the schema '" + schema + "', this program reads '" + kSchema1 + "' to '" + kSchema + "'");
  }
  Model m;
  const std::string architecture = file.read_text("/architecture");
  read_params(ConfigNode::parse(architecture, path.string() + ": /architecture"), m.architecture);
  const auto sizes = file.read_int("/sizes", 4);
  if (sizes.size() != 4) refuse("/sizes must have 4 entries");
  for (const auto size : sizes) {
    if (size < 1 || size > 100000) refuse("/sizes holds " + std::to_string(size) + ", must be in [1, 100000]");
  }
  auto& d = m.dimensions;
  d = {sizes[0], sizes[1], sizes[2], sizes[3]};
  if (d.controls > 64 || d.states > 64 || d.hands > 16)
    refuse("/sizes has more controls, states or hands than any trajectory");
  const Layout layout(m.architecture, d);
  if (layout.size > (1u << 28)) refuse("describes a network of " + std::to_string(layout.size) + " weights, too large");
  const auto read = [&](const std::string& name, const std::vector<Index>& shape) {
    if (file.shape(name) != shape) refuse(name + " has a shape that does not fit the architecture");
    std::size_t count = 1;
    for (const Index n : shape) count *= static_cast<std::size_t>(n);
    auto values = file.read_float(name, count);
    for (const float x : values) {
      if (!std::isfinite(x)) refuse(name + " holds a number that is not finite");
    }
    return values;
  };
  m.weights.resize(layout.size);
  for (const auto& w : layout.weights) {
    const auto values = read("/weights/" + w.name, {w.rows, w.columns});
    std::copy(values.begin(), values.end(), m.weights.begin() + static_cast<std::ptrdiff_t>(w.offset));
  }
  m.mean = read("/normalisation/mean", {d.coordinates()});
  if (m.needs_basis()) {
    m.basis = read("/normalisation/basis", {d.coordinates(), m.architecture.latent});
    m.scale = read("/normalisation/scale", {m.architecture.latent});
    if (std::any_of(m.scale.begin(), m.scale.end(), [](float x) { return !(x > 1e-12f); }))
      refuse("/normalisation/scale must be positive");
  }
  m.input_mean = read("/normalisation/input_mean", {d.inputs()});
  m.input_sd = read("/normalisation/input_sd", {d.inputs()});
  if (std::any_of(m.input_sd.begin(), m.input_sd.end(), [](float x) { return !(x > 1e-12f); }))
    refuse("/normalisation/input_sd must be positive");
  const auto steps = file.shape("/calibration");
  if (steps.size() != 3 || steps[0] != 2 || steps[1] != 2 || steps[2] < 1 || steps[2] > 1000)
    refuse("/calibration must have the shape [2, 2, steps]");
  m.calibration = read("/calibration", steps);
  if (std::any_of(m.calibration.begin(), m.calibration.end(), [](float x) { return !(x > 1e-3f && x < 1e3f); }))
    refuse("/calibration must be in (0.001, 1000)");
  if (file.has("/calibration_added")) {
    m.calibration_added = read("/calibration_added", steps);
    if (std::any_of(m.calibration_added.begin(), m.calibration_added.end(),
                    [](float x) { return !(x >= 0.0f && x < 100.0f); }))
      refuse("/calibration_added must be in [0, 100)");
  }
  m.garment_name = file.read_text("/garment/name");
  const auto integer = [&](const std::string& name, const std::string& text) -> std::uint64_t {
    try {
      return std::stoull(text);
    } catch (const std::logic_error&) {
      refuse(name + " holds '" + text + "', which is no number");
      return 0;
    }
  };
  m.garment_hash = integer("/garment/hash", file.read_text("/garment/hash"));
  m.grasp_vertices = file.read_int("/garment/grasp_vertices", 64);
  const auto words = [&](const std::string& name, Index count) {
    std::vector<std::string> all(1);
    for (const char c : file.read_text(name)) {
      if (c == ' ') {
        all.emplace_back();
      } else {
        all.back().push_back(c);
      }
    }
    if (static_cast<Index>(all.size()) != count) refuse(name + " must have " + std::to_string(count) + " words");
    return all;
  };
  m.control_names = words("/trajectory/controls", d.controls);
  m.state_names = words("/trajectory/states", d.states);
  const auto numbers = [&](const std::string& name, Index count) {
    auto values = file.read(name, 4096);
    if (static_cast<Index>(values.size()) != count) refuse(name + " must have " + std::to_string(count) + " entries");
    for (const double x : values) {
      if (!std::isfinite(x)) refuse(name + " holds a number that is not finite");
    }
    return values;
  };
  m.control_low = numbers("/trajectory/control_low", d.controls);
  m.control_high = numbers("/trajectory/control_high", d.controls);
  for (std::size_t c = 0; c < m.control_low.size(); ++c) {
    if (m.control_low[c] > m.control_high[c])
      refuse("/trajectory/control_low of " + m.control_names[c] + " lies above control_high");
  }
  m.initial_state = numbers("/manipulation/initial_state", d.states);
  m.initial_targets = numbers("/manipulation/initial_targets", 3 * d.hands);
  m.displacement = numbers("/manipulation/displacement", 2);
  const auto heights = numbers("/manipulation/heights", 2);
  m.drop_height = heights[0];
  m.contact_height = heights[1];
  m.material = file.read_text("/material");
  m.dataset = file.read_text("/dataset");
  const auto origins = [&](const std::string& group) {
    std::vector<DatasetOrigin> datasets;
    const std::string name = group + "/split_fractions";
    if (!file.has(name)) return datasets;
    const auto shape = file.shape(name);
    if (shape.size() != 2 || shape[0] < 1 || shape[0] > kMostDatasets || shape[1] != 2)
      refuse(name + " must have the shape [n, 2]");
    const auto identities = words(group + "/identities", shape[0]), seeds = words(group + "/seeds", shape[0]);
    const auto fractions = numbers(name, 2 * shape[0]);
    for (std::size_t i = 0; i < seeds.size(); ++i)
      datasets.push_back({identities[i], integer(group + "/seeds", seeds[i]), fractions[2 * i], fractions[2 * i + 1]});
    return datasets;
  };
  m.datasets = origins("/datasets");
  m.calibrated = origins("/calibration_datasets");
  m.provenance = file.read_text("/provenance");
  m.training = file.read_text("/training");
  const std::string wanted = schema == kSchema1 ? checksum_1(m) : checksum(m, architecture);
  if (wanted != file.read_text("/checksum")) refuse("is damaged: its content does not have the recorded checksum");
  return m;
}

}  // namespace weft::emd
