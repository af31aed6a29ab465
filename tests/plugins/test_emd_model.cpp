// The model: its files, the reasons to refuse them, and the task that it fits.
#include <string_view>

#include "plugins/emd_fixture.hpp"
#include "weft/hdf5_file.hpp"

namespace weft::emd {
namespace {

TEST(EmdPredictor, NeedsAModelAndRefusesOneOfAnotherTask) {
  const Folder folder;
  TestHost host;
  const Task task = patch_task();
  EmdPredictor without(Params{}, host);
  EXPECT_THAT(message_of<ConfigError>([&] { without.bind(task); }), HasSubstr("needs a model file"));
  EXPECT_THROW(without.predict({}, {}), Error);
  save_model(folder / "m.h5", untrained_model(small(), task, 1), true);
  Params params;
  params.model = folder / "m.h5";
  const auto refusal = [&](const Task& other) {
    EmdPredictor predictor(params, host);
    return message_of<ConfigError>([&] { predictor.bind(other); });
  };
  EXPECT_THAT(refusal(patch_task(6)), HasSubstr("trained for the garment 'patch'"));
  Task other = task;
  other.manipulation.displacement = {0.41, 0.0};
  EXPECT_THAT(refusal(other), HasSubstr("displacement [0.400000, 0.000000], the task has [0.410000"));
  other = task;
  other.manipulation.drop_height = 0.06;
  EXPECT_THAT(refusal(other), HasSubstr("drop height"));
  other = task;
  other.manipulation.opens_at = Vector(Eigen::Vector2d(0.5, 1.0));
  EXPECT_THAT(refusal(other),
              HasSubstr("hands that open at the progress [], all at the release, the task has [0.500000"));
  params.model = folder / "opening.h5";
  save_model(params.model, untrained_model(small(), other, 1), true);
  EXPECT_THAT(refusal(task), HasSubstr("the task has [], all at the release"));
  EmdPredictor trained_for_it(params, host);
  trained_for_it.bind(other);
  params.model = folder / "m.h5";
  other = task;
  other.manipulation.grasp_vertices[0] = 1;
  EXPECT_THAT(refusal(other), HasSubstr("grasp vertices"));
  other = task;
  other.material.ranges[0].high = 0.8;
  EXPECT_THAT(refusal(other), HasSubstr("another material space"));
  params.other_fabric = "warn";
  EmdPredictor warned(params, host);
  warned.bind(other);
  EXPECT_THAT(host.messages_, HasSubstr("another material space"));
}

TEST(EmdPredictor, NamesTheControlsThatItsModelHasSeen) {
  const Folder folder;
  TestHost host;
  const Task task = patch_task();
  Model model = untrained_model(small(), task, 1);
  model.control_low[2] = -0.25;
  model.control_high[2] = 0.125;
  save_model(folder / "m.h5", model, true);
  Params params;
  params.model = folder / "m.h5";
  EmdPredictor predictor(params, host);
  EXPECT_THROW(predictor.control_range(), Error);
  predictor.bind(task);
  const auto range = predictor.control_range();
  ASSERT_TRUE(range.has_value());
  EXPECT_EQ(range->lower(2), -0.25);
  EXPECT_EQ(range->upper(2), 0.125);
  const auto variables = task.trajectory->controls();
  ASSERT_EQ(range->dim(), static_cast<Index>(variables.size()));
  EXPECT_EQ(range->upper(0), variables[0].upper);
}

TEST(EmdModel, ComesBackAsItWasAndDamageIsRefused) {
  const Folder folder;
  Model model = untrained_model(small(), patch_task(), 1);
  model.training = "{\"a\":1}";
  model.datasets = {{"first", 7, 0.04, 0.08}, {"second", ~0ull, 0.125, 0.25}};
  for (const bool half : {false, true}) {
    save_model(folder / "m.h5", model, half);
    const Model back = load_model(folder / "m.h5");
    Model rounded = model;
    if (half) {
      for (float& w : rounded.weights) w = round_to_half(w);
      for (float& w : rounded.basis) w = round_to_half(w);
    }
    EXPECT_EQ(back.weights, rounded.weights);
    EXPECT_EQ(back.basis, rounded.basis);
    EXPECT_EQ(back.control_names, model.control_names);
    EXPECT_EQ(back.material, model.material);
    EXPECT_EQ(back.training, model.training);
    ASSERT_EQ(back.datasets.size(), 2u);
    EXPECT_EQ(back.datasets[1].identity, "second");
    EXPECT_EQ(back.datasets[1].seed, ~0ull);
    EXPECT_EQ(back.datasets[1].test_fraction, 0.25);
    save_model(folder / "again.h5", back, half);
    EXPECT_EQ(bytes_of(folder / "m.h5"), bytes_of(folder / "again.h5"));
  }
  EXPECT_NEAR(round_to_half(0.1f), 0.1f, 3e-5f);
  EXPECT_EQ(round_to_half(1e6f), 65504.0f);

  const std::string good = bytes_of(folder / "m.h5");
  const auto weights = load_model(folder / "m.h5").weights;
  RandomStream random(2);
  int refused = 0;
  for (int trial = 0; trial < 150; ++trial) {
    std::string bad = good;
    if (trial % 3 == 0) {
      bad.resize(random.below(bad.size()));
    } else {
      for (int k = 0; k < 2; ++k) bad[random.below(bad.size())] ^= static_cast<char>(1 + random.below(255));
    }
    std::ofstream(folder / "bad.h5", std::ios::binary) << bad;
    try {
      EXPECT_EQ(load_model(folder / "bad.h5").weights, weights);
    } catch (const Error&) {
      ++refused;
    }
  }
  EXPECT_GT(refused, 60);
}

/// A model file with one bit changed, in the first byte of a value that it holds.
template <class T>
std::string with_changed_bit(std::string file, const T& value) {
  const std::string_view wanted(reinterpret_cast<const char*>(value.data()), value.size() * sizeof(value[0]));
  const auto at = file.find(wanted);
  EXPECT_NE(at, std::string::npos);
  EXPECT_EQ(file.find(wanted, at + 1), std::string::npos) << "not the only one";
  if (at != std::string::npos) file[at] ^= 1;
  return file;
}

// These entries decide plans, estimates and comparisons of data. Finite, plausible values of another model would do
// harm silently.
TEST(EmdModel, AChangeOfAnyValueIsRefused) {
  const Folder folder;
  Model model = untrained_model(small(), patch_task(), 1);
  model.dataset = "6f1d";
  model.provenance = "{\"commit\":\"5a\"}";
  model.training = "{\"iterations\":12}";
  model.datasets = {{"6f1c", 7171717, 0.04, 0.08}};
  model.calibrated = {{"6f1b", 8181818, 0.03, 0.07}};
  model.grasp_vertices = {3, 14};
  model.initial_state = {0.125, 0.2, 0.3, 0.4, 0.5};
  model.garment_name = "tablecloth";
  save_model(folder / "m.h5", model, false);
  ASSERT_NO_THROW(load_model(folder / "m.h5"));
  const std::string good = bytes_of(folder / "m.h5");
  const auto check = [&](const char* what, const auto& value) {
    SCOPED_TRACE(what);
    std::ofstream(folder / "bad.h5", std::ios::binary) << with_changed_bit(good, value);
    EXPECT_THAT(message_of<ConfigError>([&] { load_model(folder / "bad.h5"); }), HasSubstr("recorded checksum"));
  };
  check("control_low", model.control_low);
  check("control_high", model.control_high);
  check("initial_state", model.initial_state);
  check("initial_targets", model.initial_targets);
  check("displacement", model.displacement);
  check("heights", std::vector<double>{model.drop_height, model.contact_height});
  check("grasp_vertices", model.grasp_vertices);
  check("garment", model.garment_name);
  check("hash", std::to_string(model.garment_hash));
  check("controls", std::string("dtheta dr"));
  check("material", model.material);
  check("dataset", model.dataset);
  check("datasets", model.datasets[0].identity);
  check("seed", std::to_string(model.datasets[0].seed));
  check("fractions", std::vector<double>{0.04, 0.08});
  check("calibrated", model.calibrated[0].identity);
  check("calibrated seed", std::to_string(model.calibrated[0].seed));
  check("calibrated fractions", std::vector<double>{0.03, 0.07});
  check("provenance", model.provenance);
  check("training", model.training);
  check("input_mean", model.input_mean);
  check("calibration", model.calibration);
  check("calibration_added", model.calibration_added);
  check("scale", model.scale);
}

TEST(EmdModel, FilesOfEarlierSchemasAreRead) {
  const Folder folder;
  const auto old = WEFT_SOURCE_DIR "/tests/plugins/emd_model_1.h5";
  const Model model = load_model(old);
  EXPECT_EQ(model.dataset, "0123456789abcdef");
  EXPECT_TRUE(model.datasets.empty());
  TestHost host;
  Params params;
  params.model = old;
  EmdPredictor(params, host).bind(patch_task());
  save_model(folder / "new.h5", model, true);
  EXPECT_EQ(load_model(folder / "new.h5").weights, model.weights);
  const auto refusal = [&](const std::string& bytes) {
    std::ofstream(folder / "bad.h5", std::ios::binary) << bytes;
    return message_of<ConfigError>([&] { load_model(folder / "bad.h5"); });
  };
  EXPECT_THAT(refusal(with_changed_bit(bytes_of(old), model.mean)), HasSubstr("recorded checksum"));
  // An old file under the new schema's name lacks the new checksum.
  std::string renamed = bytes_of(old);
  renamed.replace(renamed.find("emd model 1"), 11, "emd model 4");
  EXPECT_THAT(refusal(renamed), HasSubstr("recorded checksum"));
  // The second one had no added lengths.
  Model second = model;
  second.calibration_added.clear();
  save_model(folder / "second.h5", second, false);
  renamed = bytes_of(folder / "second.h5");
  renamed.replace(renamed.find("emd model 4"), 11, "emd model 2");
  std::ofstream(folder / "second.h5", std::ios::binary) << renamed;
  EXPECT_TRUE(load_model(folder / "second.h5").calibration_added.empty());
  // The third schema had them, but did not record the data of a later calibration.
  save_model(folder / "third.h5", model, false);
  renamed = bytes_of(folder / "third.h5");
  renamed.replace(renamed.find("emd model 4"), 11, "emd model 3");
  std::ofstream(folder / "third.h5", std::ios::binary) << renamed;
  EXPECT_EQ(load_model(folder / "third.h5").calibration_added, model.calibration_added);
  EXPECT_TRUE(load_model(folder / "third.h5").calibrated.empty());
  EXPECT_GT(load_model(WEFT_SOURCE_DIR "/configs/models/tshirt.h5").weights.size(), 1000000u);  // whichever it has
}

TEST(EmdModel, HostileContentIsRefusedWithTheReason) {
  const Folder folder;
  const Task task = patch_task();
  const auto refusal = [&](auto change) {
    Model model = untrained_model(small(), task, 1);
    change(model);
    save_model(folder / "m.h5", model, false);
    return message_of<ConfigError>([&] { load_model(folder / "m.h5"); });
  };
  EXPECT_THAT(refusal([](Model& m) { m.weights[7] = std::nanf(""); }), HasSubstr("not finite"));
  EXPECT_THAT(refusal([](Model& m) { m.scale[0] = 0.0f; }), HasSubstr("/normalisation/scale must be positive"));
  EXPECT_THAT(refusal([](Model& m) { m.input_sd[0] = -1.0f; }), HasSubstr("input_sd"));
  EXPECT_THAT(refusal([](Model& m) { m.calibration = {1.0f, 1.0f, 1.0f, -1.0f}; }), HasSubstr("/calibration"));
  EXPECT_THAT(refusal([](Model& m) { m.calibration_added[0] = -1.0f; }), HasSubstr("/calibration_added must be in"));
  EXPECT_THAT(refusal([](Model& m) { m.control_names.pop_back(); }), HasSubstr("/trajectory/controls"));
  EXPECT_THAT(refusal([](Model& m) { std::swap(m.control_low, m.control_high); }),
              HasSubstr("control_low of dtheta lies above control_high"));
  EXPECT_THAT(refusal([](Model& m) { m.control_low[1] = -INFINITY; }), HasSubstr("not finite"));
  EXPECT_THAT(refusal([](Model& m) { m.control_high.pop_back(); }), HasSubstr("must have 5 entries"));
  EXPECT_THAT(refusal([](Model& m) { m.datasets = {{"two words", 1, 0.1, 0.1}}; }), HasSubstr("/datasets/identities"));
  EXPECT_THAT(refusal([](Model& m) { m.input_mean.pop_back(); }), HasSubstr("/normalisation/input_mean has a shape"));
  auto file = Hdf5File::create(folder / "other.h5");
  file.write("/schema", std::string("weft session 1"));
  file.commit();
  EXPECT_THAT(message_of<ConfigError>([&] { load_model(folder / "other.h5"); }), HasSubstr("has the schema"));
}

}  // namespace
}  // namespace weft::emd
