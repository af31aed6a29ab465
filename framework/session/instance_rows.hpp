#pragma once
#include <memory>
#include <vector>

#include "weft/predictor.hpp"

namespace weft {

/// predict() for the instances of a search. The result of an instance does not depend on which others still run.
/// A `deterministic` predictor gets the cases unchanged. For any other, the batch is padded to all instances, and
/// instance i keeps its row. A padding row holds a copy of the first case without segments. So a search is equal bit
/// for bit to one that runs its instances one after the other with the same padding.
/// @param instances [cases]: the instance of each case, ascending, in [0, count). If instances have several cases
/// (samples of a population), each gets as many rows as the one with the most.
/// @return the predictions of `cases`, in their order.
/// @throws ShapeError, Error for other `instances`; what predict() throws.
std::unique_ptr<Prediction> predict_in_rows(const Predictor& predictor, const std::vector<PredictionCase>& cases,
                                            const std::vector<Index>& instances, Index count,
                                            const PredictionRequest& request);

}  // namespace weft
