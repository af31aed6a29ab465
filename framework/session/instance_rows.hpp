#pragma once
#include <memory>
#include <vector>

#include "weft/predictor.hpp"

namespace weft {

/// predict() for instances of a search, such that what an instance gets does not depend on which others still run.
/// A `deterministic` predictor gets the cases as they are. With any other, instance i keeps its row of a batch that is
/// padded to all instances: rows that nobody asks for hold a copy of the first case without segments. So a search is
/// equal bit for bit to one that runs its instances one after the other and pads likewise.
/// @param instances [cases]: whose case it is, ascending, in [0, count). Where instances have several cases (samples of
/// a population), each gets as many rows as the one with most.
/// @return of `cases`, in their order.
/// @throws ShapeError, Error for other `instances`; what predict() throws.
std::unique_ptr<Prediction> predict_in_rows(const Predictor& predictor, const std::vector<PredictionCase>& cases,
                                            const std::vector<Index>& instances, Index count,
                                            const PredictionRequest& request);

}  // namespace weft
