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

/// One instance of a batch: start, controls, knowledge of the material, and the segments whose shapes are requested.
struct PredictionCase {
  std::shared_ptr<const Positions> shape;     ///< [V, 3] m: s_i, the shape at the start; never null
  std::shared_ptr<const Positions> previous;  ///< [V, 3] m: one segment earlier, or null at the start of a session
  Vector state;                               ///< [S] control state at the start
  Controls controls;                          ///< [k, C]
  MaterialKnowledge knowledge;
  std::vector<Index> segments;  ///< ascending, in [1, k]: request the shapes after that many segments; may be empty
};

enum class Moments { mean, mean_and_sigma };

struct PredictionRequest {
  Moments moments = Moments::mean_and_sigma;
  bool gradients = false;  ///< keep what pullback() needs
  // The inputs that pullback() differentiates. If false, their gradients are zero. This saves time in predictors whose
  // gradients cost one simulation per input.
  bool control_gradients = true;
  bool knowledge_gradients = true;
  // Need a capability. If false, the gradient is empty. Planning and estimation leave them false.
  bool state_gradients = false;
  bool shape_gradients = false;
};

/// s-hat: independent normal distribution per vertex and axis (section 2.3). sigma is a standard deviation.
struct ShapeDistribution {
  Positions mean;   ///< [V, 3] m
  Positions sigma;  ///< [V, 3] m, > 0; [0, 3] if only the mean was requested
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

/// Result of one batched prediction, with the data needed to differentiate it. Owns all of it: several predictions can
/// be alive at once.
class WEFT_API Prediction {
 public:
  virtual ~Prediction() = default;
  /// [cases][case.segments], in the order of case.segments.
  virtual const std::vector<std::vector<ShapeDistribution>>& shapes() const = 0;
  /// Why case i has no result (such as: its simulation diverged), or empty. A failed case has no shapes.
  virtual const std::string& failure(std::size_t i) const = 0;
  /// Gradient of a loss L on the shapes: cotangents [cases][case.segments]. @return [cases].
  /// @throws Unsupported unless made with `gradients` (the default: always); Diverged if one is not finite: weft asks case by case then.
  virtual std::vector<CaseGradient> pullback(const std::vector<std::vector<ShapeCotangent>>& cotangents) const;
  /// Directional derivatives: [cases][directions of that case][case.segments].
  /// @throws as pullback(); Unsupported without the capability jvp. The default always throws.
  virtual std::vector<std::vector<std::vector<ShapeCotangent>>> jvp(
      const std::vector<std::vector<CaseDirection>>& directions) const;
};

/// Shapes and failures in two vectors, without derivatives. Predictors without gradients return this class. Predictors
/// with gradients derive from it and override pullback(), and jvp() if they declare it.
class WEFT_API PlainPrediction : public Prediction {
 public:
  /// @param shapes [cases][case.segments]; @param failures [cases], or empty if no case failed.
  explicit PlainPrediction(std::vector<std::vector<ShapeDistribution>> shapes, std::vector<std::string> failures = {});
  const std::vector<std::vector<ShapeDistribution>>& shapes() const override { return shapes_; }
  const std::string& failure(std::size_t i) const override { return failures_.at(i); }

 protected:
  /// Starts without shapes and failures; the derived class fills them in.
  explicit PlainPrediction(std::size_t cases) : shapes_(cases), failures_(cases) {}
  std::vector<std::vector<ShapeDistribution>> shapes_;  // [cases][case.segments]
  std::vector<std::string> failures_;                   // [cases]
};

struct PredictorCapabilities {
  bool gradients = false;        ///< pullback with respect to controls and knowledge
  bool state_gradients = false;  ///< ... and, if requested, control state
  bool shape_gradients = false;  ///< ... and, if requested, start shape
  bool jvp = false;
  bool deterministic = true;  ///< the same case gives the same bits in every batch
  bool needs_binding = true;  ///< bind() must come before predict()
  bool obstacles = false;     ///< Scene::obstacles of the task take part; else the session warns
  /// Manipulation::opens_at takes part, or bind() refuses a task that it was not trained for; else the session warns.
  bool opening_hands = false;
};

/// Predicts shapes from a start shape, controls and material knowledge (section 2.3). Thread-safe after bind().
class WEFT_API Predictor {
 public:
  static constexpr const char* kKind = "predictor";
  static constexpr int kVersion = 11;  // bump on any change to this class, the types above or trainable.hpp
  static constexpr TypeSize kCrossing[] = {{"Task", sizeof(Task)},
                                           {"PredictionCase", sizeof(PredictionCase)},
                                           {"PredictionRequest", sizeof(PredictionRequest)},
                                           {"ShapeDistribution", sizeof(ShapeDistribution)},
                                           {"ShapeCotangent", sizeof(ShapeCotangent)},
                                           {"CaseGradient", sizeof(CaseGradient)},
                                           {"CaseDirection", sizeof(CaseDirection)},
                                           {"PredictorCapabilities", sizeof(PredictorCapabilities)}};
  virtual ~Predictor() = default;

  virtual PredictorCapabilities capabilities() const = 0;
  /// Called once, before any predict().
  /// @throws ConfigError if the predictor was trained for another garment, trajectory or manipulation than the task's.
  virtual void bind(const Task& task) = 0;
  /// A case that fails numerically is recorded as failed. @throws what check_cases() throws.
  virtual std::unique_ptr<Prediction> predict(const std::vector<PredictionCase>& cases,
                                              const PredictionRequest& request) const = 0;
  /// Bounds [C] of the controls that this predictor handles: for a trained model, of those in its training set. Plans
  /// stay inside. nullopt: the trajectory's bounds. Call after bind().
  virtual std::optional<Box> control_range() const { return std::nullopt; }
  /// The training interface of this predictor (trainable.hpp), or null if it does not learn.
  virtual TrainablePredictor* trainable() { return nullptr; }
  /// The largest number of segments, >= 1, in the controls of a case; predict() refuses more. It limits plans, and the
  /// histories that estimates use. nullopt: no limit. Call after bind().
  virtual std::optional<Index> max_segments() const { return std::nullopt; }
};

/// Checks of the input that every predict() makes first. Messages start with `who`.
/// @param task the bound task; one without garment or trajectory counts as not bound.
/// @param max_segments Predictor::max_segments().
/// @throws Error before bind(), and for a non-finite shape, previous shape, state, control or knowledge.
/// @throws ShapeError for a case without a shape, sizes that differ from the task's, more than `max_segments` rows of
/// controls, or segments that do not ascend within [1, k].
WEFT_API void check_cases(const std::string& who, const Task& task, const std::vector<PredictionCase>& cases,
                          std::optional<Index> max_segments = std::nullopt);

}  // namespace weft
