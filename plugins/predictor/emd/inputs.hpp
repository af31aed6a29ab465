#pragma once
#include "model.hpp"
#include "weft/predictor.hpp"

namespace weft::emd {

/// Control states and grasp targets along a case's controls, and the inputs of the prediction module made from them.
/// States and targets are in the trajectory's own units. The network sees standardised inputs.
class CaseInputs {
 public:
  CaseInputs(const Task& task, const Dimensions& dimensions, const PredictionCase& one, Index steps);
  /// Standardised inputs of segment j (from 0), [inputs].
  void write(const Model& model, Index segment, float* to) const;
  /// @param d_inputs [steps, inputs]: cotangents of the standardised inputs. Adds to the gradient's controls, knowledge
  /// and state, which must have their sizes.
  void pullback(const Model& model, const std::vector<const float*>& d_inputs, CaseGradient& gradient) const;
  /// Derivative of the standardised inputs along a direction, [steps][inputs].
  void jvp(const Model& model, const CaseDirection& direction, std::vector<std::vector<float>>& to) const;

 private:
  const Task& task_;
  Dimensions dim_;
  Controls controls_;  ///< [steps, C]
  MaterialKnowledge knowledge_;
  RowMatrix states_;            ///< [steps + 1, S]
  RowMatrix targets_;           ///< [steps + 1, 3 G]
  std::vector<bool> released_;  ///< [steps]: at the end of segment j
};

/// The same row from recorded values, for training.
void write_inputs(const Dimensions& dimensions, const double* control, const double* state_before,
                  const double* state_after, const double* targets_before, const double* targets_after, bool released,
                  const PropertyVector& centre, const PropertyVector& width, double* to);

}  // namespace weft::emd
