#include "model.hpp"

#include <algorithm>
#include <cmath>

#include "weft/random.hpp"

namespace weft::emd {
namespace {

std::vector<std::string> names_of(const std::vector<Variable>& variables) {
  std::vector<std::string> names;
  for (const auto& v : variables) names.push_back(v.name);
  return names;
}
std::string list(const std::vector<double>& numbers) {
  std::string text;
  for (const double x : numbers) text += (text.empty() ? "" : ", ") + std::to_string(x);
  return "[" + text + "]";
}
bool close(const std::vector<double>& a, const std::vector<double>& b) {
  return std::equal(a.begin(), a.end(), b.begin(), b.end(), [](double x, double y) { return std::abs(x - y) <= 1e-6; });
}

}  // namespace

std::string join(const std::vector<std::string>& words) {
  std::string text;
  for (const auto& word : words) text += (text.empty() ? "" : " ") + word;
  return text;
}

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
  const std::size_t at = (from_start ? 0 : 2 * length) + std::min<std::size_t>(steps, length) - 1;
  SigmaCalibration c;
  const double certain = std::log(calibration[at]), unknown = std::log(calibration[at + length]);
  c.factor_slope = unknown - certain;
  c.factor = std::exp(certain + mean_width * c.factor_slope);
  if (calibration_added.empty()) return c;
  const double unit = kLength, least = unit * calibration_added[at];
  c.added_slope = unit * calibration_added[at + length] - least;
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
  opens_at.assign(m.opens_at.begin(), m.opens_at.end());
  material = write_material_space(task.material).to_yaml();
  dimensions.vertices = task.garment->vertex_count();
  dimensions.controls = control_names.size();
  dimensions.states = state_names.size();
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
  if (opens_at != wanted.opens_at) {
    const auto text = [](const std::vector<double>& at) { return at.empty() ? "[], all at the release" : list(at); };
    refuse("hands that open at the progress", text(opens_at), text(wanted.opens_at));
  }
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
        "emd: the model was trained with another material space than the task's: the same properties in [0, 1] "
        "mean other fabrics";
    if (!allow_other_fabric) throw ConfigError(text + " (predictor.params.other_fabric: warn uses the model anyway)");
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
    const double sd = gain / std::sqrt(w.rows);
    for (std::size_t i = 0; i < w.size(); ++i) weights[w.offset + i] = static_cast<float>(sd * random.normal());
  }
  const auto& bias = layout.weights[layout.sigma_bias];
  std::fill_n(weights.data() + bias.offset, bias.size(), std::log(0.1f));  // sigma 10 mm
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
    const Index latent = architecture.latent;
    Matrix waves(n, latent);
    RandomStream random(seed, 0x6261736973ull);
    for (Index c = 0; c < latent; ++c) {
      const double a = 12.0 * random.normal(), b = 12.0 * random.normal(), phase = random.uniform(0.0, 6.3),
                   turn = random.uniform(0.0, 6.3);
      for (Index i = 0; i < n; ++i) {
        const auto rest = task.garment->rest.row(i / 3);
        waves(i, c) = std::cos(a * rest(0) + b * rest(1) + phase + turn * (i % 3)) + 0.01 * random.normal();
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
    m.scale.assign(latent, 1.0f);
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
  m.calibration = {1.0f, 0.9f, 1.3f, 1.4f, 1.1f, 1.0f, 1.2f, 1.5f};  // arbitrary, so that tests notice them
  m.calibration_added = {0.0f, 0.01f, 0.02f, 0.05f, 0.0f, 0.0f, 0.03f, 0.02f};
  return m;
}

}  // namespace weft::emd
