// Sessions, datasets and models: sound HDF5 files with hostile contents.
#include <hdf5.h>

#include "apps/weft/exports.hpp"
#include "fuzz.hpp"
#include "hdf5_edits.hpp"
#include "identity/identity.hpp"
#include "learning/dataset_files.hpp"
#include "learning/generate.hpp"
#include "predictor/emd/model_file.hpp"
#include "report/page.hpp"
#include "session/session.hpp"
#include "session/session_file.hpp"
#include "weft/config.hpp"
#include "weft/predictor.hpp"
#include "weft/trainable.hpp"

namespace weft::fuzz {
namespace {

namespace fs = std::filesystem;

Vector start_state() { return world().task.trajectory->initial_state(world().task.manipulation); }

Example example(std::int64_t index, Index segments) {
  const Task& task = world().task;
  Example e;
  e.index = index;
  e.q.setConstant(0.5);
  e.controls = task.trajectory->default_controls(segments);
  e.states.resize(segments + 1, start_state().size());
  e.states.row(0) = start_state().transpose();
  e.states.bottomRows(segments) = task.trajectory->segment_states(task.manipulation, start_state(), e.controls);
  e.targets.resize(segments + 1, 3 * task.trajectory->hands());
  for (Index j = 0; j <= segments; ++j) {
    const Positions targets = task.trajectory->targets(task.manipulation, e.states.row(j).transpose());
    e.targets.row(j) = Eigen::Map<const Vector>(targets.data(), targets.size()).transpose();
    const auto& shape = task.garment->positions;
    for (Index i = 0; i < shape.size(); ++i) e.shapes.push_back(static_cast<float>(shape.data()[i]));
  }
  return e;
}

const char* const kProvenance =
    R"({"weft": "0.1.0", "identity": {"schema": "weft identity 1", "weft": "0.1.0", "config": {"seed": 1, "a": {"b": 2}},)"
    R"( "plugins": {"trajectory/arc": {"version": "1.0.0", "sha256": "0123456789abcdef"}}}})";

/// The reason for which a file is refused, or empty.
template <class Use>
std::string refusal_of(const fs::path& file, Use&& use) {
  const auto open = [] { return H5Fget_obj_count(static_cast<hid_t>(H5F_OBJ_ALL), H5F_OBJ_ALL); };
  const ssize_t before = open();
  const std::string reason = refusal([&] { use(file); });
  if (open() != before) finding(file.string() + ": weft leaves it open in libhdf5");
  return reason;
}

/// Opens an edited copy. A checksum that does not fit ends reading early, so it is then corrected once.
template <class Use>
void edited(const EditedFile& valid, std::string_view edits, const std::string& name, Use&& use) {
  const fs::path file = world().file(name);
  valid.write(edits, file);
  const std::string reason = refusal_of(file, use);
  static constexpr std::string_view kSaid = "has the checksum ";
  const auto said = reason.find(kSaid);
  if (said == std::string::npos) return;
  const std::string rest = reason.substr(said + kSaid.size());
  EditedFile::replace_text(file, "checksum", rest.substr(0, rest.find_first_not_of("0123456789abcdef")));
  refusal_of(file, use);
}

}  // namespace

void make_session(const fs::path& file) {
  const Task& task = world().task;
  SessionResult result;
  result.start = result.goal = result.final_shape = result.default_shape = task.garment->positions;
  result.goal_counts.assign(static_cast<std::size_t>(result.goal.rows()), true);
  result.true_material = MaterialProperties::Constant(0.5);
  result.goal_controls = task.trajectory->default_controls(1);
  std::vector<float> frame(static_cast<std::size_t>(result.start.size()), 0.25f);
  result.frames.assign(2 * kFramesPerSegment + 3, frame);
  for (int r = 0; r < 2; ++r) {
    SessionRound round;
    round.plan.controls = task.trajectory->default_controls(2 - r);
    round.plan.losses = {1.0, 2.0};
    round.plan.curves = {{3.0, 3.0}, {1.0, 2.0}};
    round.plan.shapes.assign(static_cast<std::size_t>(2 - r), {result.start, Positions::Constant(9, 3, 0.01)});
    round.state = start_state();
    round.observed = result.start;
    result.rounds.push_back(std::move(round));
    result.estimates.emplace_back();
  }
  result.released = true;
  write_session(file, result, task, ConfigNode::parse("{seed: 1}", "config"), kProvenance);
}

void use_session(const fs::path& file) {
  const SessionRecord record = read_session(file);
  session_page("<html><!--weft-data--></html>", record);
  refusal([&] { app::export_csv(world().file("csv"), record, app::every_nth(record, 10)); });
  refusal([&] { identity_in(record.provenance, "provenance"); });
  for (Index j = 0; j < record.segments(); ++j) {
    if (record.rounds[static_cast<std::size_t>(j)].controls.rows() < 1) finding("a round without controls");
    if (record.shape_after(j).rows() != record.vertex_count()) finding("a shape of another size");
  }
}

void make_dataset(const fs::path& file) {
  Shard shard;
  shard.header = make_dataset_header(world().task, {}, 1, ConfigNode::parse("{seed: 1}", "config"), kProvenance);
  shard.examples = {example(0, 2), example(3, 1)};
  Example failed;
  failed.index = 4;
  failed.failure = "diverged";
  failed.controls.resize(0, shard.header.controls);
  failed.states.resize(0, shard.header.states);
  failed.targets.resize(0, 3 * shard.header.hands);
  shard.examples.push_back(failed);
  write_shard(file, shard);
}

void use_dataset(const fs::path& file) {
  static const Identity own = identity_in(kProvenance, "own");
  Dataset dataset;
  Shard shard = read_shard(file);
  dataset.header = shard.header;
  dataset.examples = std::move(shard.examples);
  refusal([&] { own.changes_since(identity_in(dataset.header.provenance, file.string())); });
  refusal([&] { identity_in(dataset.header.provenance, file.string()).changes_since(own); });
  for (const std::size_t i : dataset.select(std::nullopt)) {
    for (Index s = 0; s <= dataset.examples[i].segments(); ++s) dataset.shape(i, s);
  }
  dataset.require_task(world().task);
}

void make_model(const fs::path& file) {
  emd::Architecture a;
  a.latent = 6;
  a.memory = 2;
  a.layers = 2;
  a.hidden = a.encoder_hidden = a.decoder_hidden = 4;
  emd::Model model = emd::untrained_model(a, world().task, 1);
  model.provenance = kProvenance;
  model.training = "{}";
  model.datasets = {{"0123", 1, 0.1, 0.1}};
  emd::save_model(file, model, false);
}

/// Loads a model and predicts with it.
void use_model(const fs::path& file) {
  World& w = world();
  static const auto predictor = w.host->create<Predictor>(ConfigNode::quoted("emd"));  // finding a plugin takes long
  predictor->trainable()->load(file);
  predictor->bind(w.task);
  predictor->control_range();
  const auto shape = std::make_shared<const Positions>(w.task.garment->positions);
  PredictionCase one;
  one.shape = shape;
  one.previous = shape;
  one.state = start_state();
  one.controls = w.task.trajectory->default_controls(2);
  one.segments = {1, 2};
  predictor->predict({one}, {});
}

void session(std::string_view edits) {
  static const EditedFile valid = [] {
    make_session(world().file("valid.h5"));
    return EditedFile(world().file("valid.h5"));
  }();
  edited(valid, edits, "session.h5", use_session);
}

void dataset(std::string_view edits) {
  static const EditedFile valid = [] {
    make_dataset(world().file("valid.h5"));
    return EditedFile(world().file("valid.h5"));
  }();
  edited(valid, edits, "shard-00000.h5", use_dataset);
}

void model(std::string_view edits) {
  static const EditedFile valid = [] {
    make_model(world().file("valid.h5"));
    return EditedFile(world().file("valid.h5"));
  }();
  edited(valid, edits, "model.h5", use_model);
}

}  // namespace weft::fuzz
