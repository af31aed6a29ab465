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
  std::shared_ptr<const Positions> shape;     ///< [V, 3] m: s_i, the shape at the start
  std::shared_ptr<const Positions> previous;  ///< [V, 3] m: one segment earlier, or null at the start of a session
  Vector state;                               ///< [S] control state at the start
  Controls controls;                          ///< [k, C]
  MaterialKnowledge knowledge;
  std::vector<Index> segments;  ///< ascending, in [1, k]: shapes wanted after that many segments
};

enum class Moments { mean, mean_and_sigma };

struct PredictionRequest {
  Moments moments = Moments::mean_and_sigma;
  bool gradients = false;  ///< keep what pullback() needs
  // Which inputs pullback() is to differentiate; the others come back as zeros. Matters to predictors whose gradients
  // cost one simulation per input.
  bool control_gradients = true;
  bool knowledge_gradients = true;
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
  Vector state;     ///< [S] by capability, else empty
  Positions shape;  ///< [V, 3] by capability, else [0, 3]
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
  /// Gradient of a loss L on the shapes: cotangents [cases][case.segments]. @throws Unsupported unless asked for.
  virtual std::vector<CaseGradient> pullback(const std::vector<std::vector<ShapeCotangent>>& cotangents) const = 0;
  /// Directional derivatives: [cases][directions of that case][case.segments]. By capability; @throws Unsupported.
  WEFT_API virtual std::vector<std::vector<std::vector<ShapeCotangent>>> jvp(
      const std::vector<std::vector<CaseDirection>>& directions) const;
};

struct PredictorCapabilities {
  bool gradients = false;        ///< pullback with respect to controls and knowledge
  bool state_gradients = false;  ///< ... and control state
  bool shape_gradients = false;  ///< ... and start shape
  bool jvp = false;
  bool deterministic = true;  ///< same input, same bits, whatever else is in the batch
  bool needs_binding = true;  ///< bind() must come before predict()
};

/// Predicts shapes from a start shape, controls and material knowledge (section 2.3). Thread-safe after bind().
class WEFT_API Predictor {
 public:
  static constexpr const char* kKind = "predictor";
  static constexpr int kVersion = 5;  // bump on any change to this class, the types above or trainable.hpp
  virtual ~Predictor() = default;

  virtual PredictorCapabilities capabilities() const = 0;
  /// Called once, before any predict(). @throws ConfigError if it was trained for another garment, trajectory or
  /// manipulation than the task's.
  virtual void bind(const Task& task) = 0;
  /// @throws ShapeError for wrong sizes, Error for non-finite input. A case that fails numerically is recorded as
  /// failed.
  virtual std::unique_ptr<Prediction> predict(const std::vector<PredictionCase>& cases,
                                              const PredictionRequest& request) const = 0;
  /// Range of the controls that it is good for (a trained model: of those it has seen), [C] each; plans stay inside.
  /// After bind(). nullopt: as far as the trajectory goes.
  virtual std::optional<Box> control_range() const { return std::nullopt; }
  /// This predictor's learning side (trainable.hpp), or null when it does not learn.
  virtual TrainablePredictor* trainable() { return nullptr; }
  /// Most segments, >= 1, that the controls of a case may have; predict() refuses more with ShapeError. Plans and the
  /// histories that estimates are made from are no longer than that. After bind(). nullopt: no limit.
  virtual std::optional<Index> max_segments() const { return std::nullopt; }
};

}  // namespace weft
