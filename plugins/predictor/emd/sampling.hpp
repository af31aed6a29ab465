#pragma once
#include <vector>

#include "params.hpp"
#include "weft/dataset.hpp"
#include "weft/random.hpp"

namespace weft::emd {

/// A part of an example, to be predicted from its first shape on.
struct Sequence {
  std::size_t example = 0;  ///< position in the dataset
  Index start = 0, steps = 0;
  MaterialKnowledge knowledge;
  std::vector<Index> decoded;  ///< ascending, in [1, steps]: the shapes that enter the loss
};

/// Knowledge of eq. 3: w = R(0,1)^2, c = q + R(-w, w)/2, c clipped to [0, 1]; for a share of the examples exact
/// knowledge or none.
MaterialKnowledge sample_knowledge(const MaterialProperties& q, double certain_share, double unknown_share,
                                   RandomStream& random);

/// Draws the sub-sequence of an example for one iteration. It starts at the flat shape (`start_share`) or anywhere. It
/// runs to the example's end, or for `max_steps`. Draws also its knowledge and `decoded_steps` of its shapes, the last
/// one among them.
Sequence sample_sequence(std::size_t position, const Example& example, const Training& training, RandomStream& random);

}  // namespace weft::emd
