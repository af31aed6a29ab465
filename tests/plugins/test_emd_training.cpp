// Training: its draws, learning, resuming, stopping, and its optimisers.
#include <array>
#include <nlohmann/json.hpp>

#include "plugins/emd_fixture.hpp"
#include "predictor/emd/sampling.hpp"

namespace weft::emd {
namespace {

// eq. 3: w = u^2, so that E w = 1/3 and E w^2 = 1/5; c - q = w v / 2 with v uniform in [-1, 1], so that its mean is 0
// and its variance E w^2 / 12.
TEST(EmdSampling, KnowledgeHasTheMomentsOfEquation3) {
  constexpr int kDraws = 20000;
  const double root = std::sqrt(kDraws);
  const MaterialProperties q(0.5, 0.02, 0.5, 1.0);
  RandomStream random(8);
  PropertyVector w = PropertyVector::Zero(), ww = w, d = w, dd = w, clipped = w;
  double ww01 = 0.0, dd02 = 0.0;
  for (int i = 0; i < kDraws; ++i) {
    const MaterialKnowledge k = sample_knowledge(q, 0.0, 0.0, random);
    ASSERT_TRUE((k.width.array() >= 0.0).all() && (k.width.array() <= 1.0).all());
    ASSERT_TRUE((k.centre.array() >= 0.0).all() && (k.centre.array() <= 1.0).all());
    const PropertyVector off = k.centre - q;
    ASSERT_TRUE((off.array().abs() <= 0.5 * k.width.array() + 1e-15).all());  // the interval holds the truth
    w += k.width;
    ww += k.width.cwiseAbs2();
    d += off;
    dd += off.cwiseAbs2();
    clipped.array() += (k.centre.array() == 0.0).cast<double>() + (k.centre.array() == 1.0).cast<double>();
    ww01 += (k.width[0] - 1.0 / 3.0) * (k.width[1] - 1.0 / 3.0);
    dd02 += off[0] * off[2];
  }
  for (Index p = 0; p < 4; ++p) {
    EXPECT_NEAR(w[p] / kDraws, 1.0 / 3.0, 5.0 * 0.3 / root);
    EXPECT_NEAR(ww[p] / kDraws, 0.2, 5.0 * 0.27 / root);
  }
  for (const Index p : {0, 2}) {  // in the middle nothing is clipped
    EXPECT_EQ(clipped[p], 0.0);
    EXPECT_NEAR(d[p] / kDraws, 0.0, 5.0 * std::sqrt(1.0 / 60.0) / root);
    EXPECT_NEAR(dd[p] / kDraws, 1.0 / 60.0, 5.0 * 0.034 / root);
  }
  EXPECT_NEAR(clipped[3], 0.5 * kDraws, 5.0 * 0.5 * root);  // at the edge half of the draws are
  EXPECT_GT(clipped[1], 0.3 * kDraws);
  EXPECT_LT(clipped[1], 0.5 * kDraws);
  EXPECT_NEAR(ww01 / kDraws, 0.0, 5.0 * 0.09 / root);  // each property has its own
  EXPECT_NEAR(dd02 / kDraws, 0.0, 5.0 / 60.0 / root);
}

TEST(EmdSampling, SharesOfKnowledgeStartsAndShapesAreThoseAskedFor) {
  constexpr int kDraws = 20000;
  Training t;
  t.start_share = 0.35;
  t.certain_share = 0.15;
  t.unknown_share = 0.1;
  t.max_steps = 6;
  t.decoded_steps = 3;
  Example e;
  e.q = MaterialProperties(0.2, 0.4, 0.6, 0.8);
  e.controls = Controls::Zero(10, 5);
  RandomStream random(9);
  std::array<int, 10> starts{};
  std::array<int, 7> decoded{};
  int certain = 0, unknown = 0, long_ones = 0;
  for (int i = 0; i < kDraws; ++i) {
    const Sequence s = sample_sequence(4, e, t, random);
    ASSERT_EQ(s.example, 4u);
    ++starts.at(s.start);
    ASSERT_EQ(s.steps, std::min<Index>(10 - s.start, 6));
    ASSERT_EQ(s.decoded.size(), std::min<std::size_t>(3, static_cast<std::size_t>(s.steps)));
    ASSERT_EQ(s.decoded.back(), s.steps);
    ASSERT_GE(s.decoded.front(), 1);
    ASSERT_EQ(std::adjacent_find(s.decoded.begin(), s.decoded.end(), std::greater_equal<>()), s.decoded.end());
    if (s.steps == 6) {
      ++long_ones;
      for (const Index j : s.decoded) ++decoded.at(j);
    }
    certain += s.knowledge.width.isZero(0.0) && s.knowledge.centre == e.q;
    unknown += s.knowledge.width.isOnes(0.0) && s.knowledge.centre.isConstant(0.5, 0.0);
  }
  const auto expect_share = [](int count, double share, int of) {
    EXPECT_NEAR(count, share * of, 5.0 * std::sqrt(of * share * (1.0 - share)));
  };
  expect_share(starts[0], 0.35 + 0.65 / 10.0, kDraws);
  for (std::size_t k = 1; k < 10; ++k) expect_share(starts[k], 0.65 / 10.0, kDraws);
  expect_share(certain, 0.15, kDraws);
  expect_share(unknown, 0.1, kDraws);
  for (std::size_t j = 1; j < 6; ++j) expect_share(decoded[j], 2.0 / 5.0, long_ones);  // besides the last, 2 of 5
}

#if WEFT_HAS_TORCH
TEST(EmdTraining, LearnsTheSameBitsOnAnyNumberOfThreads) {
  const Folder folder;
  const Task task = patch_task();
  const Dataset data = toy_dataset(task, 60);
  TestHost host(1);
  Params params = small_and_quick();
  params.training.iterations = 200;
  std::vector<double> losses;
  const auto fit = [&](const std::string& name, Host& on) {
    EmdPredictor predictor(params, on);
    return predictor.trainable()->fit(data, task, {.seed = 4, .model = folder / name}, [&](const FitProgress& p) {
      losses.push_back(p.validation_loss);
      return true;
    });
  };
  const FitReport report = fit("a.h5", host);
  EXPECT_TRUE(report.finished);
  EXPECT_EQ(report.iterations, 200);
  const auto recorded = load_model(folder / "a.h5").datasets;
  ASSERT_EQ(recorded.size(), 1u);
  EXPECT_EQ(recorded[0].identity, data.header.identity);
  EXPECT_EQ(recorded[0].seed, data.header.seed);
  EXPECT_EQ(recorded[0].test_fraction, 0.15);
  EXPECT_LT(losses.back(), losses.front() - 0.5);
  TestHost more(3);
  fit("b.h5", more);
  EXPECT_EQ(bytes_of(folder / "a.h5"), bytes_of(folder / "b.h5"));

  // It has learned something: its prediction is better than the shape it starts from.
  params.model = folder / "a.h5";
  EmdPredictor predictor(params, host);
  predictor.bind(task);
  double error = 0.0, still = 0.0;
  for (const auto i : data.select(Split::test)) {
    const auto& e = data.examples[i];
    PredictionCase one = whole_example(data, i);
    one.segments = {e.segments()};
    const Positions truth = data.shape(i, e.segments());
    error += mean_distance_mm(predictor.predict({one}, {})->shapes()[0][0].mean, truth);
    still += mean_distance_mm(*one.shape, truth);
  }
  EXPECT_LT(error, 0.4 * still);
}

TEST(EmdTraining, TheBestModelSoFarCanBeUsedMeanwhile) {
  const Folder folder;
  const Task task = patch_task();
  TestHost host(1);
  Params params = small_and_quick();
  int loaded = 0;
  EmdPredictor(params, host)
      .fit(toy_dataset(task, 40), task, {.seed = 4, .model = folder / "model.h5"}, [&](const FitProgress& p) {
        if (p.iteration < params.training.iterations && std::filesystem::exists(folder / "model.h5")) {
          Params with_model = params;
          with_model.model = folder / "model.h5";
          EmdPredictor(with_model, host).bind(task);
          ++loaded;
        }
        return true;
      });
  EXPECT_GT(loaded, 0);
}

TEST(EmdTraining, AStoppedFitGoesOnToTheSameBits) {
  const Folder folder;
  const Task task = patch_task();
  const Dataset data = toy_dataset(task, 40);
  TestHost host(1);
  for (const char* optimiser : {"adam", "signsgd"}) {
    Params params = small_and_quick();
    params.training.optimiser = optimiser;
    if (params.training.optimiser == "signsgd") params.training.rate = 1e-3;
    const auto fit = [&](const std::string& name, std::int64_t stop_at) {
      EmdPredictor predictor(params, host);
      FitOptions options{.seed = 4, .model = folder / (name + ".h5"), .checkpoint = folder / (name + ".checkpoint.h5")};
      return predictor.fit(data, task, options, [&](const FitProgress& p) { return p.iteration < stop_at; });
    };
    fit("whole", 1000);
    const FitReport first = fit("parts", 20);
    EXPECT_FALSE(first.finished);
    EXPECT_EQ(first.iterations, 20);
    const FitReport second = fit("parts", 1000);
    EXPECT_TRUE(second.finished);
    EXPECT_TRUE(second.resumed);
    EXPECT_EQ(bytes_of(folder / "whole.h5"), bytes_of(folder / "parts.h5")) << optimiser;
    EXPECT_FALSE(std::filesystem::exists(folder / "parts.checkpoint.h5"));

    fit("other", 20);
    params.training.rate *= 2;
    EXPECT_THAT(message_of<ConfigError>([&] { fit("other", 1000); }),
                HasSubstr("belongs to a fit with other settings"));
    std::filesystem::remove(folder / "other.checkpoint.h5");
  }
}

// One iteration moves every weight by the rate, one way or the other, or not at all. With two voters both must agree:
// then they move it as their summed gradient would, and else it stays. Of three, two can outvote the sum.
TEST(EmdTraining, SignSgdMovesByTheMajorityOfSigns) {
  const Folder folder;
  const Task task = patch_task();
  const Dataset data = toy_dataset(task, 40);
  TestHost host(1);
  Params params = small_and_quick();
  auto& t = params.training;
  t.optimiser = "signsgd";
  t.iterations = 1;
  t.rate = 1.0 / 1024.0;
  t.average = 0.0;
  t.half_precision = false;
  const auto moves = [&](std::int64_t votes) {
    t.votes = votes;
    EmdPredictor(params, host).fit(data, task, {.seed = 4, .model = folder / "m.h5"}, {});
    const Model model = load_model(folder / "m.h5");
    std::vector<float> before;
    draw_weights(Layout(model.architecture, model.dimensions), 4, before);
    std::vector<int> moved;
    for (std::size_t i = 0; i < before.size(); ++i) {
      const float step = (model.weights[i] - before[i]) * 1024.0f;
      moved.push_back(static_cast<int>(std::lround(step)));
      EXPECT_NEAR(step, static_cast<float>(moved.back()), 1e-3f);
      EXPECT_LE(std::abs(moved.back()), 1);
    }
    return moved;
  };
  const auto one = moves(1), two = moves(2), three = moves(3);
  std::size_t moving = 0, undecided = 0, turned = 0, outvoted = 0;
  for (std::size_t i = 0; i < one.size(); ++i) {
    if (one[i] == 0) continue;
    ++moving;
    undecided += two[i] == 0;
    turned += two[i] == -one[i];
    outvoted += three[i] == -one[i];
  }
  const auto share = [&](std::size_t n) { return static_cast<double>(n) / static_cast<double>(moving); };
  EXPECT_GT(moving, one.size() / 2);
  EXPECT_GT(share(undecided), 0.05);
  EXPECT_LT(share(undecided), 0.95);
  EXPECT_LT(share(turned), 1e-3);  // the sums of two and of one differ by rounding
  EXPECT_GT(share(outvoted), 0.01);
  EXPECT_LT(share(outvoted), 0.5);
}

// Over-fitted to three examples, the loss on others soon rises. Then the rate is halved and the fit ends early. The
// best model is kept, not the last one.
TEST(EmdTraining, SignSgdHalvesItsRateStopsEarlyAndKeepsTheBest) {
  const Folder folder;
  const Task task = patch_task();
  const Dataset data = toy_dataset(task, 40);
  TestHost host(1);
  Params params = small_and_quick();
  auto& t = params.training;
  t.optimiser = "signsgd";
  t.iterations = 2000;
  t.max_examples = 3;
  t.evaluate_every = 4;
  t.rate = 2e-3;
  t.average = 0.0;
  t.patience = 2;
  t.stop_after = 5;
  const auto fit = [&](const std::string& name) {
    return EmdPredictor(params, host).fit(data, task, {.seed = 4, .model = folder / name}, {});
  };
  const FitReport report = fit("early.h5");
  EXPECT_TRUE(report.finished);
  const auto json = nlohmann::json::parse(report.json);
  EXPECT_EQ(json.at("stopped_by"), "early_stop");
  ASSERT_LT(report.iterations, 2000);

  // The best model, the halvings and the end that follow from its curve.
  double best = std::numeric_limits<double>::infinity(), rate = t.rate;
  std::int64_t best_iteration = 0, without = 0, halvings = 0;
  for (const auto& point : json.at("curve")) {
    EXPECT_LT(without, t.stop_after);
    const double loss = point.at("validation_loss");
    if (loss < best) {
      best = loss;
      best_iteration = point.at("iteration");
      without = 0;
    } else if (++without % t.patience == 0) {
      rate *= 0.5;
      ++halvings;
    }
    EXPECT_DOUBLE_EQ(point.at("rate").get<double>(), rate) << point;
  }
  EXPECT_EQ(without, t.stop_after);
  EXPECT_GE(halvings, 2);
  EXPECT_EQ(json.at("best").at("iteration"), best_iteration);
  EXPECT_EQ(json.at("best").at("validation_loss"), best);
  EXPECT_EQ(report.best_loss, best);
  EXPECT_EQ(report.iterations, best_iteration + t.stop_after * t.evaluate_every);

  // SignSGD does not know the planned length: a fit that ends there gives the same file.
  t.iterations = best_iteration;
  fit("until_best.h5");
  EXPECT_EQ(bytes_of(folder / "early.h5"), bytes_of(folder / "until_best.h5"));
}

TEST(EmdTraining, RefusesDataThatDoNotDo) {
  const Task task = patch_task();
  TestHost host(1);
  Params params;
  params.training = quick();
  EmdPredictor predictor(params, host);
  const Dataset data = toy_dataset(task, 40);
  EXPECT_THAT(message_of<ConfigError>([&] { predictor.fit(data, task, {}, {}); }),
              HasSubstr("architecture.latent = 192"));
  Dataset none = data;
  none.examples.clear();
  EXPECT_THAT(message_of<ConfigError>([&] { predictor.fit(none, task, {}, {}); }), HasSubstr("train split"));
}

#else
TEST(EmdTraining, SaysWhatIsMissing) {
  EXPECT_THAT(message_of<Unsupported>([] { training_function("weft_emd_fit"); }), HasSubstr("without libtorch"));
}
#endif

}  // namespace
}  // namespace weft::emd
