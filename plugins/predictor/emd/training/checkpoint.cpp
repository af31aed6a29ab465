#include "checkpoint.hpp"

#include "../training_library.hpp"
#include "weft/hdf5_file.hpp"

namespace weft::emd {
namespace {

constexpr const char* kSchema = "weft emd checkpoint 1";

/// Everything that the result of a fit depends on.
std::string identity_of(const FitJob& job, std::size_t train, std::size_t validation) {
  std::string text = job.dataset.header.identity + " " + std::to_string(train) + " " + std::to_string(validation) +
                     " " + std::to_string(job.options.seed);
  struct Writer {
    std::string& out;
    void operator()(const char*, double& v, const Range&, const char*, Decides = Decides::results) {
      out += " " + ConfigNode::number(v).as_string();
    }
    void operator()(const char*, std::int64_t& v, const Range&, const char*, Decides = Decides::results) {
      out += " " + std::to_string(v);
    }
    void operator()(const char*, bool& v, const char*) { out += v ? " 1" : " 0"; }
    void operator()(const char*, std::string& v, const Choice&, const char*) { out += " " + v; }
  } writer{text};
  Architecture architecture = job.architecture;
  Training training = job.training;
  training.time_limit_s = 0;  // may be raised from one run to the next
  training.checkpoint_every = 1;
  architecture.visit(writer);
  training.visit(writer);
  return text;
}

}  // namespace

Checkpoint::Checkpoint(const FitJob& job, std::size_t train, std::size_t validation)
    : path_(job.options.checkpoint),
      identity_(identity_of(job, train, validation)),
      accept_changed_(job.options.accept_changed),
      has_second_moment_(job.training.optimiser == "adam") {}

void Checkpoint::save(const FitState& state, const Model& model) const {
  if (path_.empty()) return;
  auto file = Hdf5File::create(path_);
  file.write("/schema", std::string(kSchema));
  file.write("/identity", identity_);
  const auto write = [&](const char* name, const auto& v) {
    if (!v.empty()) file.write(name, {static_cast<Index>(v.size())}, v.data());
  };
  write("/weights", state.weights);
  write("/first_moment", state.first_moment);
  write("/second_moment", state.second_moment);
  write("/average", state.average);
  write("/best_weights", state.best_weights);
  write("/mean", model.mean);
  write("/basis", model.basis);
  write("/scale", model.scale);
  write("/input_mean", model.input_mean);
  write("/input_sd", model.input_sd);
  write("/control_low", model.control_low);
  write("/control_high", model.control_high);
  const double numbers[] = {state.rate,          state.loss_sum,        state.best_loss,
                            state.best_error_mm, state.validation_loss, state.validation_error_mm,
                            state.training_loss, state.seconds,         state.time_used};
  file.write("/numbers", {9}, numbers);
  const std::int64_t counts[] = {state.iteration, state.loss_count, state.best_iteration, state.without_best};
  file.write("/counts", {4}, counts);
  std::vector<double> curve;
  for (const auto& c : state.curve) {
    curve.insert(curve.end(),
                 {static_cast<double>(c.iteration), c.training_loss, c.validation_loss, c.validation_error_mm, c.rate});
  }
  file.write("/curve", {static_cast<Index>(state.curve.size()), 5}, curve.data());
  file.commit();
}

std::optional<FitState> Checkpoint::load(Model& model) const {
  if (path_.empty() || !std::filesystem::exists(path_)) return std::nullopt;
  const auto refuse = [&](const std::string& reason) { throw ConfigError(path_.string() + ": " + reason); };
  const auto file = Hdf5File::open(path_);
  if (!file.has("/schema") || file.read_text("/schema") != kSchema) refuse("is not a checkpoint of the predictor emd");
  if (!accept_changed_ && file.read_text("/identity") != identity_) {
    refuse("belongs to a fit with other settings or data; remove it to start again");
  }
  const auto read = [&](const std::string& name, std::size_t size) {
    auto v = file.read_float(name, size + 1);
    if (v.size() != size) refuse(name + " has the wrong size");
    return v;
  };
  FitState state;
  const std::size_t weights = Layout(model.architecture, model.dimensions).size;
  state.weights = read("/weights", weights);
  state.first_moment = read("/first_moment", weights);
  if (has_second_moment_) state.second_moment = read("/second_moment", weights);
  state.average = read("/average", weights);
  if (file.has("/best_weights")) state.best_weights = read("/best_weights", weights);
  const std::size_t n = model.dimensions.coordinates(), latent = model.architecture.latent;
  model.mean = read("/mean", n);
  if (model.needs_basis()) {
    model.basis = read("/basis", n * latent);
    model.scale = read("/scale", latent);
  }
  model.input_mean = read("/input_mean", model.dimensions.inputs());
  model.input_sd = read("/input_sd", model.dimensions.inputs());
  model.control_low = file.read("/control_low", 64);
  model.control_high = file.read("/control_high", 64);
  const auto numbers = file.read("/numbers", 9);
  const auto counts = file.read_int("/counts", 4);
  if (numbers.size() != 9 || counts.size() != 4) refuse("is damaged");
  state.rate = numbers[0];
  state.loss_sum = numbers[1];
  state.best_loss = numbers[2];
  state.best_error_mm = numbers[3];
  state.validation_loss = numbers[4];
  state.validation_error_mm = numbers[5];
  state.training_loss = numbers[6];
  state.seconds = numbers[7];
  state.time_used = numbers[8];
  state.iteration = counts[0];
  state.loss_count = counts[1];
  state.best_iteration = counts[2];
  state.without_best = counts[3];
  const auto curve = file.read("/curve");
  for (std::size_t i = 0; i + 5 <= curve.size(); i += 5) {
    state.curve.push_back(
        {static_cast<std::int64_t>(curve[i]), curve[i + 1], curve[i + 2], curve[i + 3], curve[i + 4]});
  }
  return state;
}

void Checkpoint::remove() const {
  std::error_code ignored;
  if (!path_.empty()) std::filesystem::remove(path_, ignored);
}

}  // namespace weft::emd
