// Calibration: sigma is fitted to the errors of held-out examples.
#include <nlohmann/json.hpp>

#include "learning/held_out.hpp"
#include "plugins/emd_fixture.hpp"
#include "predictor/emd/training/sigma_tally.hpp"

namespace weft::emd {
namespace {

/// Shapes of 900 coordinates, two thirds with a sigma of 5 mm and one third, which lies on the ground, with 0.4 mm.
/// @param truth ratio of the errors to sigma. @param buckles share of the shapes where a twentieth of the ground stands
/// 8 mm off.
struct DrawnErrors {
  DrawnErrors(double truth, double buckles) {
    RandomStream random(17, 1);
    for (int shape = 0; shape < 500; ++shape) {
      const bool buckle = random.uniform() < buckles;
      for (Index c = 0; c < kCoordinates; ++c) {
        const bool ground = c % 3 == 2;
        const double s = ground ? 0.4e-3 : 5e-3;
        sigma.push_back(static_cast<float>(s) / kLength);
        const double e = buckle && ground && c % 60 == 2 ? 8e-3 : truth * s * random.normal();
        error.push_back(static_cast<float>(e) / kLength);
      }
      tally.add(&error[error.size() - kCoordinates], &sigma[sigma.size() - kCoordinates], kCoordinates);
    }
  }
  /// Mean normalised squared error and share within one sigma.
  std::pair<double, double> rate(const SigmaTally::Choice& choice) const {
    double square = 0.0, inside = 0.0;
    for (std::size_t k = 0; k < error.size(); ++k) {
      const double z = std::abs(error[k]) / (choice.factor * std::hypot(sigma[k], choice.added));
      square += z * z;
      inside += z < 1.0;
    }
    return {square / static_cast<double>(error.size()), inside / static_cast<double>(error.size())};
  }
  static constexpr Index kCoordinates = 900;
  std::vector<float> error, sigma;
  SigmaTally tally;
};

TEST(EmdCalibration, NormalErrorsGetTheirFactorAlone) {
  for (const double truth : {0.7, 1.0, 1.6}) {
    const SigmaTally::Choice choice = DrawnErrors(truth, 0.0).tally.choose();
    EXPECT_NEAR(choice.factor, truth, 0.04 * truth);
    EXPECT_EQ(choice.added, 0.0f);
  }
}

TEST(EmdCalibration, TailsThatNoFactorMendsAreTakenByALength) {
  const DrawnErrors drawn(1.0, 0.1);
  const SigmaTally::Choice choice = drawn.tally.choose();
  EXPECT_GT(choice.added, 0.0f);
  const auto [nse, coverage] = drawn.rate(choice);
  EXPECT_GT(nse, 0.8);
  EXPECT_LT(nse, 1.25);
  EXPECT_GT(coverage, 0.62);
  EXPECT_LT(coverage, 0.74);
  for (float factor = 0.8f; factor < 2.0f; factor *= 1.05f) {
    const auto [square, inside] = drawn.rate({factor, 0.0f});
    EXPECT_TRUE(square > 1.25 || inside > 0.74) << factor << ": " << square << ", " << inside;
  }
}

TEST(EmdCalibration, OneFoldThatEndedUpElsewhereDecidesNothing) {
  DrawnErrors drawn(1.0, 0.0);
  const SigmaTally::Choice before = drawn.tally.choose();
  std::vector<float> elsewhere(drawn.error.begin(), drawn.error.begin() + DrawnErrors::kCoordinates);
  for (float& e : elsewhere) e *= 20.0f;  // alone it adds 0.8 to the mean squared error over sigma
  drawn.tally.add(elsewhere.data(), drawn.sigma.data(), DrawnErrors::kCoordinates);
  const SigmaTally::Choice after = drawn.tally.choose();
  EXPECT_NEAR(after.factor, before.factor, 0.06);
  EXPECT_EQ(after.added, before.added);
}

#if WEFT_HAS_TORCH
// Sigma fitted to few examples is too small for others. The factors from the validation split correct that on the test
// split.
TEST(EmdTraining, CalibrationBringsSigmaToTheErrorsOfUnseenExamples) {
  const Folder folder;
  const Task task = patch_task();
  const Dataset data = toy_dataset(task, 200);
  TestHost host;
  Params params = small_and_quick();
  params.training.iterations = 600;
  params.training.max_examples = 20;
  params.training.average = 0.0;
  params.training.evaluate_every = 600;  // the last weights, over-fitted as they are, and not the best ones
  struct Rating {
    double nse = 0.0, coverage = 0.0;
  };
  const auto rate = [&](bool calibrate) {
    Params one = params;
    one.training.calibrate = calibrate;
    const auto model = folder / (calibrate ? "with.h5" : "without.h5");
    EmdPredictor(one, host).fit(data, task, {.seed = 4, .model = model}, [](const FitProgress&) { return true; });
    one.model = model;
    EmdPredictor predictor(one, host);
    predictor.bind(task);
    Rating rating;
    double count = 0.0;
    for (const auto i : data.select(Split::test)) {
      const auto& e = data.examples[i];
      PredictionCase start = whole_example(data, i);
      for (Index j = 1; j <= e.segments(); ++j) start.segments.push_back(j);
      const auto prediction = predictor.predict({start}, {});
      for (Index j = 1; j <= e.segments(); ++j) {
        const auto& shape = prediction->shapes()[0][static_cast<std::size_t>(j) - 1];
        const auto z = ((data.shape(i, j) - shape.mean).array() / shape.sigma.array()).abs().eval();
        rating.nse += z.square().mean();
        rating.coverage += (z < 1.0).cast<double>().mean();
        ++count;
      }
    }
    return Rating{rating.nse / count, rating.coverage / count};
  };
  const Rating without = rate(false), with = rate(true);
  EXPECT_GT(without.nse, 1.6);
  EXPECT_LT(std::abs(std::log(with.nse)), 0.5 * std::abs(std::log(without.nse)));
  EXPECT_LT(std::abs(with.coverage - 0.683), std::abs(without.coverage - 0.683));
}

/// A model fitted to toy_dataset(task, 60), in folder/fitted.h5, and a predictor's parameters with it.
Params fitted(const Folder& folder, const Task& task, std::int64_t iterations = 60, bool half_precision = true) {
  TestHost host;
  Params params = small_and_quick();
  params.training.iterations = iterations;
  params.training.half_precision = half_precision;
  EmdPredictor(params, host)
      .fit(toy_dataset(task, 60), task, {.seed = 4, .model = folder / "fitted.h5"},
           [](const FitProgress&) { return true; });
  params.training.half_precision = true;
  params.training.sigma_passes = 0;  // the sigma layer's own fit has tests of its own
  params.model = folder / "fitted.h5";
  return params;
}

// A model has a sigma three times too small, and 40 mm too large within sessions. Calibration on held-out examples of
// another seed restores it. Nothing but the calibration changes.
TEST(EmdRecalibration, BringsAWrongSigmaToTheErrorsOfUnseenExamples) {
  const Folder folder;
  const Task task = patch_task();
  TestHost host;
  Params params = fitted(folder, task, 300);
  Model wrong = load_model(params.model);
  const std::size_t half = wrong.calibration.size() / 2;
  for (std::size_t i = 0; i < 2 * half; ++i) {
    wrong.calibration[i] *= i < half ? 0.33f : 1.0f;
    wrong.calibration_added[i] = i < half ? 0.0f : 0.4f;
  }
  params.model = folder / "wrong.h5";
  save_model(params.model, wrong, true);
  const Dataset fresh = toy_dataset(task, 300, 2);

  struct Rating {
    double nse = 0.0, coverage = 0.0, count = 0.0;
  };
  const auto rate = [&](const std::filesystem::path& file, bool within, bool known) {
    Params one = params;
    one.model = file;
    EmdPredictor predictor(one, host);
    predictor.bind(task);
    Rating rating;
    for (const auto i : fresh.select(Split::test)) {
      const auto& e = fresh.examples[i];
      for (Index start = within ? 1 : 0; start < (within ? e.segments() : 1); ++start) {
        PredictionCase from = whole_example(fresh, i);
        if (!known) from.knowledge = MaterialKnowledge::none();
        from.controls = e.controls.bottomRows(e.segments() - start);
        from.state = e.states.row(start).transpose();
        from.shape = std::make_shared<const Positions>(fresh.shape(i, start));
        if (within) from.previous = std::make_shared<const Positions>(fresh.shape(i, start - 1));
        for (Index j = 1; j <= e.segments() - start; ++j) from.segments.push_back(j);
        const auto prediction = predictor.predict({from}, {});
        for (Index j = 1; j <= e.segments() - start; ++j, ++rating.count) {
          const auto& shape = prediction->shapes()[0][static_cast<std::size_t>(j) - 1];
          const auto z = ((fresh.shape(i, start + j) - shape.mean).array() / shape.sigma.array()).abs().eval();
          rating.nse += z.square().mean();
          rating.coverage += (z < 1.0).cast<double>().mean();
        }
      }
    }
    return Rating{rating.nse / rating.count, rating.coverage / rating.count, rating.count};
  };

  EmdPredictor predictor(params, host);
  predictor.bind(task);
  const auto examples = unseen_examples(fresh, predictor.trained_on());
  EXPECT_EQ(examples.size(), 300 - fresh.select(Split::test).size());
  const CalibrationReport report =
      predictor.calibrate(fresh, examples, task, {.seed = 5, .model = folder / "right.h5"});
  EXPECT_EQ(report.examples, static_cast<std::int64_t>(examples.size()));
  ASSERT_EQ(report.rows.size(), 4u);
  for (const bool within : {false, true}) {
    for (const bool known : {true, false}) {
      const Rating before = rate(params.model, within, known), after = rate(folder / "right.h5", within, known);
      SCOPED_TRACE(std::to_string(within) + std::to_string(known) + " " + std::to_string(before.nse) + " -> " +
                   std::to_string(after.nse) + ", " + std::to_string(before.coverage) + " -> " +
                   std::to_string(after.coverage) + ", " + std::to_string(after.count));
      EXPECT_TRUE(before.nse < 0.3 || before.nse > 4.0);
      EXPECT_GT(after.nse, 0.7);
      EXPECT_LT(after.nse, 1.4);
      EXPECT_GT(after.coverage, 0.6);
      EXPECT_LT(after.coverage, 0.83);  // the toy's errors have tails that no length takes
    }
  }
  // The predictor holds the written model, and only its calibration has changed.
  const Model right = load_model(folder / "right.h5");
  EXPECT_NE(right.calibration, wrong.calibration);
  ASSERT_EQ(right.calibrated.size(), 1u);
  EXPECT_EQ(right.calibrated[0].identity, fresh.header.identity);
  ASSERT_EQ(predictor.calibrated_on().size(), 1u);
  ASSERT_EQ(right.datasets.size(), 1u);
  EXPECT_EQ(right.datasets[0].identity, wrong.datasets[0].identity);
  Model back = right;
  back.calibration = wrong.calibration;
  back.calibration_added = wrong.calibration_added;
  back.calibrated.clear();
  save_model(folder / "back.h5", back, true);
  EXPECT_EQ(bytes_of(folder / "back.h5"), bytes_of(folder / "wrong.h5"));
  // The calibration depends on the examples only, not on the earlier calibration.
  params.model = folder / "fitted.h5";
  EmdPredictor(params, host).calibrate(fresh, examples, task, {.seed = 5, .model = folder / "again.h5"});
  EXPECT_EQ(bytes_of(folder / "again.h5"), bytes_of(folder / "right.h5"));
}

TEST(EmdRecalibration, WeightsOfFullPrecisionStayWhole) {
  const Folder folder;
  const Task task = patch_task();
  TestHost host;
  const Params params = fitted(folder, task, 60, false);
  const Model before = load_model(params.model);
  ASSERT_FALSE(fits_half(before));
  const Dataset fresh = toy_dataset(task, 20, 2);
  EmdPredictor predictor(params, host);
  predictor.calibrate(fresh, unseen_examples(fresh, before.datasets), task, {.seed = 5, .model = folder / "new.h5"});
  const Model after = load_model(folder / "new.h5");
  EXPECT_EQ(after.weights, before.weights);
  EXPECT_EQ(after.basis, before.basis);
}

// A prediction within a session starts where there is an earlier shape, so never with the first one.
TEST(EmdRecalibration, StartsWithinASessionAreNeverItsFirstShape) {
  const Folder folder;
  const Task task = patch_task();
  TestHost host;
  const Params params = fitted(folder, task);
  Dataset fresh = toy_dataset(task, 40, 2);
  const auto width = static_cast<std::size_t>(3 * fresh.header.vertices);
  for (auto& e : fresh.examples) {  // a third of one segment, the others of two
    const Index k = e.index % 3 == 0 ? 1 : 2;
    e.controls = e.controls.topRows(k).eval();
    e.states = e.states.topRows(k + 1).eval();
    e.targets = e.targets.topRows(k + 1).eval();
    e.shapes.resize(static_cast<std::size_t>(k + 1) * width);
    e.released = false;
  }
  EmdPredictor predictor(params, host);
  predictor.bind(task);
  const auto examples = unseen_examples(fresh, predictor.trained_on());
  const auto longer =
      std::count_if(examples.begin(), examples.end(), [&](std::size_t i) { return fresh.examples[i].segments() == 2; });
  const auto report = predictor.calibrate(fresh, examples, task, {.seed = 5});
  for (const auto& row : report.rows) {
    if (row.from_start) {
      EXPECT_EQ(row.predictions, static_cast<std::int64_t>(examples.size()));
      EXPECT_EQ(row.shapes, (std::vector<std::int64_t>{row.predictions, longer}));
    } else {
      EXPECT_EQ(row.predictions, 4 * longer);
      EXPECT_EQ(row.shapes, (std::vector<std::int64_t>{4 * longer}));
    }
  }
}

TEST(EmdRecalibration, TheFirstDatasetDecidesAndOthersFillIn) {
  const Folder folder;
  const Task task = patch_task();
  TestHost host;
  const Params params = fitted(folder, task);
  const Dataset calm = toy_dataset(task, 200, 2);
  Dataset wild = toy_dataset(task, 200, 3);
  RandomStream random(6);
  for (auto& e : wild.examples) {
    for (float& x : e.shapes) x += static_cast<float>(0.05 * random.normal());
  }
  const auto rows = [&](const Dataset& first, const Dataset* second) {
    Dataset all = first;
    if (second != nullptr) append_dataset(all, *second);
    EmdPredictor predictor(params, host);
    predictor.bind(task);
    return predictor.calibrate(all, unseen_examples(all, predictor.trained_on()), task, {.seed = 5}).rows;
  };
  const auto alone = rows(calm, nullptr), with_wild = rows(calm, &wild), wild_first = rows(wild, &calm);
  for (const std::size_t row : {0u, 1u}) {  // from the start: every example has one
    EXPECT_EQ(with_wild[row].factor[0], alone[row].factor[0]);
    EXPECT_EQ(with_wild[row].added_m[0], alone[row].added_m[0]);
    EXPECT_EQ(with_wild[row].shapes[0], alone[row].shapes[0]);
    EXPECT_GT(wild_first[row].factor[0] * (1e-3 + wild_first[row].added_m[0]),
              2.0 * alone[row].factor[0] * (1e-3 + alone[row].added_m[0]));
  }
  // Few sequences have the most segments: there the wild ones count.
  const auto& longest = with_wild[0];
  EXPECT_LT(longest.shapes.back(), 20);
  EXPECT_GT(longest.factor.back() * (1e-3 + longest.added_m.back()),
            alone[0].factor.back() * (1e-3 + alone[0].added_m.back()));
}

/// Mean and sigma of every shape of the test split, from its start with exact knowledge, without any calibration.
struct Predicted {
  std::vector<Positions> mean, sigma;
  Predicted(const std::filesystem::path& file, const Params& params, const Dataset& data, const Task& task) {
    TestHost host;
    const Folder folder;
    Model model = load_model(file);
    model.calibration.assign(4, 1.0f);
    model.calibration_added.clear();
    save_model(folder / "plain.h5", model, false);
    Params plain = params;
    plain.model = folder / "plain.h5";
    EmdPredictor predictor(plain, host);
    predictor.bind(task);
    for (const auto i : data.select(Split::test)) {
      PredictionCase start = whole_example(data, i);
      for (Index j = 1; j <= data.examples[i].segments(); ++j) start.segments.push_back(j);
      const auto prediction = predictor.predict({start}, {});
      for (Index j = 1; j <= data.examples[i].segments(); ++j) {
        const auto& shape = prediction->shapes()[0][static_cast<std::size_t>(j) - 1];
        mean.push_back(shape.mean);
        sigma.push_back(shape.sigma);
      }
    }
  }
  /// Mean log sigma of an axis over all vertices and shapes.
  double log_sigma(Index axis) const {
    double sum = 0.0;
    for (const auto& s : sigma) sum += s.col(axis).array().log().mean();
    return sum / static_cast<double>(sigma.size());
  }
};

// Sigma is wrong in a way that no factor corrects: too small along x and too large along z. The refit restores it.
// Every mean and every other weight stays the same bit for bit.
TEST(EmdSigmaLayer, IsFittedAnewAndNoMeanMoves) {
  const Folder folder;
  const Task task = patch_task();
  TestHost host(1), more(3);
  Params params = fitted(folder, task, 300);
  Model wrong = load_model(params.model);
  const Layout layout(wrong.architecture, wrong.dimensions);
  const auto& bias = layout.weights[layout.sigma_bias];
  for (std::size_t c = 0; c < bias.size(); ++c)
    wrong.weights[bias.offset + c] = round_to_half(wrong.weights[bias.offset + c] + (c % 3 == 0   ? -0.5f
                                                                                     : c % 3 == 2 ? 0.5f
                                                                                                  : 0.0f));
  params.model = folder / "wrong.h5";
  save_model(params.model, wrong, true);
  const Dataset fresh = toy_dataset(task, 150, 2);
  params.training.sigma_passes = 100;
  EmdPredictor predictor(params, host);
  predictor.bind(task);
  const auto examples = unseen_examples(fresh, predictor.trained_on());
  const CalibrationReport report =
      predictor.calibrate(fresh, examples, task, {.seed = 5, .model = folder / "right.h5"});
  const auto told = nlohmann::json::parse(report.json).at("sigma_layer");
  EXPECT_TRUE(told.at("fitted").get<bool>());
  EXPECT_LT(told.at("held_out_loss").at("after").get<double>(),
            told.at("held_out_loss").at("before").get<double>() - 0.1);

  const Predicted before(params.model, params, fresh, task), after(folder / "right.h5", params, fresh, task),
      truth(folder / "fitted.h5", params, fresh, task);
  ASSERT_GT(before.mean.size(), 100u);
  EXPECT_EQ(before.mean, after.mean);
  const auto slant = [](const Predicted& p) { return p.log_sigma(2) - p.log_sigma(0); };
  EXPECT_GT(slant(before) - slant(truth), 0.7);  // 1, but for sigma's floor
  EXPECT_NEAR(slant(after), slant(truth), 0.2);
  Model back = load_model(folder / "right.h5");
  EXPECT_TRUE(fits_half(back));
  const auto& matrix = layout.weights[layout.sigma];
  for (const auto* of : {&bias, &matrix})
    std::copy_n(wrong.weights.begin() + static_cast<std::ptrdiff_t>(of->offset), of->size(),
                back.weights.begin() + static_cast<std::ptrdiff_t>(of->offset));
  EXPECT_EQ(back.weights, wrong.weights);
  // The same bits on any number of threads.
  EmdPredictor(params, more).calibrate(fresh, examples, task, {.seed = 5, .model = folder / "again.h5"});
  EXPECT_EQ(bytes_of(folder / "again.h5"), bytes_of(folder / "right.h5"));
}

// Some heights are far off now and then. The more the fourth moment counts, the wider is their sigma, and only theirs.
TEST(EmdSigmaLayer, TailsMakeSigmaWiderWhereTheyAre) {
  const Folder folder;
  const Task task = patch_task();
  TestHost host;
  Params params = fitted(folder, task, 300);
  Dataset fresh = toy_dataset(task, 100, 2);
  RandomStream random(6);
  for (auto& e : fresh.examples) {
    for (std::size_t c = 0; c < e.shapes.size(); ++c)
      e.shapes[c] += static_cast<float>(random.normal() * (c % 3 == 2 && random.uniform() < 0.02 ? 0.1 : 0.005));
  }
  double log_sigma[2][2];
  for (const bool has_tails : {false, true}) {
    params.training.sigma_passes = 400;
    params.training.sigma_tails = has_tails ? 0.3 : 0.0;
    EmdPredictor predictor(params, host);
    predictor.bind(task);
    predictor.calibrate(fresh, unseen_examples(fresh, predictor.trained_on()), task,
                        {.seed = 5, .model = folder / "new.h5"});
    const Predicted now(folder / "new.h5", params, fresh, task);
    for (const int axis : {0, 1}) log_sigma[has_tails][axis] = now.log_sigma(axis == 0 ? 0 : 2);
  }
  const double x = log_sigma[true][0] - log_sigma[false][0], z = log_sigma[true][1] - log_sigma[false][1];
  SCOPED_TRACE(std::to_string(x) + " " + std::to_string(z));
  EXPECT_NEAR(x, 0.0, 0.12);
  EXPECT_GT(z, x + 0.1);
}

// A refit that makes held-out examples no likelier is dropped, and so is one with hardly any examples.
TEST(EmdSigmaLayer, StaysWhenItsFitIsNoBetter) {
  const Folder folder;
  const Task task = patch_task();
  TestHost host;
  Params params = fitted(folder, task, 300);
  const auto weights = load_model(params.model).weights;
  const Dataset fresh = toy_dataset(task, 60, 2);
  const auto fitted_to = [&](std::size_t count) {
    EmdPredictor predictor(params, host);
    predictor.bind(task);
    auto examples = unseen_examples(fresh, predictor.trained_on());
    examples.resize(count);
    const auto report = predictor.calibrate(fresh, examples, task, {.seed = 5, .model = folder / "new.h5"});
    EXPECT_EQ(load_model(folder / "new.h5").weights, weights);
    return nlohmann::json::parse(report.json).at("sigma_layer");
  };
  params.training.sigma_passes = 4000;  // six examples, again and again
  const auto told = fitted_to(6);
  EXPECT_FALSE(told.at("fitted").get<bool>());
  EXPECT_GT(told.at("held_out_loss").at("after").get<double>(), told.at("held_out_loss").at("before").get<double>());
  EXPECT_FALSE(fitted_to(5).contains("held_out_loss"));
  params.training.sigma_passes = 0;
  EXPECT_FALSE(fitted_to(40).at("fitted").get<bool>());
}

TEST(EmdRecalibration, WhatCannotBeCalibratedIsRefused) {
  const Folder folder;
  const Task task = patch_task();
  TestHost host;
  const Dataset fresh = toy_dataset(task, 20, 2);
  const auto refusal = [&](const Params& params, const Task& on, const std::vector<std::size_t>& examples) {
    const std::string message = message_of<ConfigError>(
        [&] { EmdPredictor(params, host).calibrate(fresh, examples, on, {.seed = 5, .model = folder / "none.h5"}); });
    EXPECT_FALSE(std::filesystem::exists(folder / "none.h5"));
    return message;
  };
  Params params = small_and_quick();
  EXPECT_THAT(refusal(params, task, {0}), HasSubstr("needs a model file"));
  params.untrained = true;
  EXPECT_THAT(refusal(params, task, {0}), HasSubstr("random weights"));
  params = fitted(folder, task);
  EXPECT_THAT(refusal(params, task, {}), HasSubstr("no example"));
  EXPECT_THAT(refusal(params, patch_task(6), {0}), HasSubstr("the garment"));
  /// One that learns and cannot do that.
  struct Plain final : TrainablePredictor {
    FitReport fit(const Dataset&, const Task&, const FitOptions&, const FitObserver&) override { return {}; }
    void save(const std::filesystem::path&) const override {}
    void load(const std::filesystem::path&) override {}
  } plain;
  EXPECT_THAT(message_of<ConfigError>([&] { plain.calibrate(fresh, {0}, task, {}); }), HasSubstr("cannot recalibrate"));
}

#endif  // WEFT_HAS_TORCH

}  // namespace
}  // namespace weft::emd
