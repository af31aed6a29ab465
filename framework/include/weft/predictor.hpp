#pragma once
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "weft/material.hpp"
#include "weft/task.hpp"
#include "weft/types.hpp"

namespace weft {

class TrainablePredictor;

/// One instance of a batch: where it starts, what is done, what is known, which shapes are wanted.
struct PredictionCase {
  std::shared_ptr<const Positions> shape;     ///< [V, 3] m: s_i, the shape at the start; never null
  std::shared_ptr<const Positions> previous;  ///< [V, 3] m: one segment earlier, or null at the start of a session
  Vector state;                               ///< [S] control state at the start
  Controls controls;                          ///< [k, C]
  MaterialKnowledge knowledge;
  std::vector<Index> segments;  ///< ascending, in [1, k]: shapes wanted after that many segments; may be empty
};

enum class Moments { mean, mean_and_sigma };

struct PredictionRequest {
  Moments moments = Moments::mean_and_sigma;
  bool gradients = false;  ///< keep what pullback() needs
  // Which inputs pullback() differentiates. Controls and knowledge that were not asked for come back as zeros: matters
  // to predictors whose gradients cost one simulation per input.
  bool control_gradients = true;
  bool knowledge_gradients = true;
  // By capability; empty unless asked for. Planning and estimation do not ask.
  bool state_gradients = false;
  bool shape_gradients = false;
};

/// s-hat: independent normal distribution per vertex and axis (section 2.3). sigma is a standard deviation.
struct ShapeDistribution {
  Positions mean;   ///< [V, 3] m
  Positions sigma;  ///< [V, 3] m, > 0; [0, 3] when only the mean was asked for
};

/// dL/d(mean, sigma) of one shape; an array with 0 rows stands for zero.
struct ShapeCotangent {
  Positions mean;
  Positions sigma;
};

/// dL/d(inputs) of one case.
struct CaseGradient {
  Controls controls;  ///< [k, C]
  PropertyVector centre = PropertyVector::Zero();
  PropertyVector width = PropertyVector::Zero();
  Vector state;     ///< [S] with state_gradients, else empty
  Positions shape;  ///< [V, 3] with shape_gradients, else [0, 3]
};

/// One direction in the space of a case's inputs, for jvp().
struct CaseDirection {
  Controls controls;  ///< [k, C]
  PropertyVector centre = PropertyVector::Zero();
  PropertyVector width = PropertyVector::Zero();
};

/// Result of one batched prediction, with what is needed to differentiate it. Owns everything: several are alive at
/// once.
class WEFT_API Prediction {
 public:
  virtual ~Prediction() = default;
  /// [cases][case.segments]: in the order asked for.
  virtual const std::vector<std::vector<ShapeDistribution>>& shapes() const = 0;
  /// Empty, or why case i has no result (its simulation diverged). Its shapes are empty then.
  virtual const std::string& failure(std::size_t i) const = 0;
  /// Gradient of a loss L on the shapes: cotangents [cases][case.segments]. @return [cases].
  /// @throws Unsupported unless the prediction was made with `gradients`; the default always.
  virtual std::vector<CaseGradient> pullback(const std::vector<std::vector<ShapeCotangent>>& cotangents) const;
  /// Directional derivatives: [cases][directions of that case][case.segments].
  /// @throws Unsupported as pullback(), and without the capability jvp; the default always.
  virtual std::vector<std::vector<std::vector<ShapeCotangent>>> jvp(
      const std::vector<std::vector<CaseDirection>>& directions) const;
};

/// Shapes and failures in two vectors, and no derivatives: all that a predictor without gradients returns. One with
/// gradients derives from it and overrides pullback(), and jvp() by capability.
class WEFT_API PlainPrediction : public Prediction {
 public:
  /// @param shapes [cases][case.segments]; @param failures [cases], or left out when no case failed.
  explicit PlainPrediction(std::vector<std::vector<ShapeDistribution>> shapes, std::vector<std::string> failures = {});
  const std::vector<std::vector<ShapeDistribution>>& shapes() const override { return shapes_; }
  const std::string& failure(std::size_t i) const override { return failures_.at(i); }

 protected:
  /// For a derived class that fills in the vectors: no shapes yet, no failures.
  explicit PlainPrediction(std::size_t cases) : shapes_(cases), failures_(cases) {}
  std::vector<std::vector<ShapeDistribution>> shapes_;  // [cases][case.segments]
  std::vector<std::string> failures_;                   // [cases]
};

struct PredictorCapabilities {
  bool gradients = false;        ///< pullback with respect to controls and knowledge
  bool state_gradients = false;  ///< ... and, when asked for, control state
  bool shape_gradients = false;  ///< ... and, when asked for, start shape
  bool jvp = false;
  bool deterministic = true;  ///< same input, same bits, whatever else is in the batch
  bool needs_binding = true;  ///< bind() must come before predict()
};

/// Predicts shapes from a start shape, controls and material knowledge (section 2.3). Thread-safe after bind().
class WEFT_API Predictor {
 public:
  static constexpr const char* kKind = "predictor";
  static constexpr int kVersion = 6;  // bump on any change to this class, the types above or trainable.hpp
  virtual ~Predictor() = default;

  virtual PredictorCapabilities capabilities() const = 0;
  /// Called once, before any predict(). @throws ConfigError if it was trained for another garment, trajectory or
  /// manipulation than the task's.
  virtual void bind(const Task& task) = 0;
  /// @throws what check_cases() throws. A case that fails numerically is recorded as failed.
  virtual std::unique_ptr<Prediction> predict(const std::vector<PredictionCase>& cases,
                                              const PredictionRequest& request) const = 0;
  /// Range of the controls that it is good for (a trained model: of those it has seen), [C] each; plans stay inside.
  /// After bind(). nullopt: as far as the trajectory goes.
  virtual std::optional<Box> control_range() const { return std::nullopt; }
  /// This predictor's learning side (trainable.hpp), or null when it does not learn.
  virtual TrainablePredictor* trainable() { return nullptr; }
  /// Most segments, >= 1, that the controls of a case may have; predict() refuses more. Plans and the
  /// histories that estimates are made from are no longer than that. After bind(). nullopt: no limit.
  virtual std::optional<Index> max_segments() const { return std::nullopt; }
};

/// What every predictor demands of its input; predict() calls it first. `who` starts the messages.
/// @param task the one that was bound; without a garment or a trajectory: not bound yet.
/// @param max_segments of the predictor.
/// @throws Error before bind(), and for a shape, previous shape, state, control or knowledge that is not finite;
/// ShapeError for a case without a shape, for sizes other than the task's, for more than `max_segments` rows of
/// controls, and for segments that do not ascend within [1, k].
WEFT_API void check_cases(const std::string& who, const Task& task, const std::vector<PredictionCase>& cases,
                          std::optional<Index> max_segments = std::nullopt);

}  // namespace weft
