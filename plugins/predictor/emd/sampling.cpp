#include "sampling.hpp"

#include <algorithm>

namespace weft::emd {

MaterialKnowledge sample_knowledge(const MaterialProperties& q, double certain_share, double unknown_share,
                                   RandomStream& random) {
  const double kind = random.uniform();
  MaterialKnowledge k;
  for (Index p = 0; p < 4; ++p) {
    const double u = random.uniform(), v = random.uniform(-1.0, 1.0);
    k.width[p] = u * u;
    k.centre[p] = std::clamp(q[p] + 0.5 * k.width[p] * v, 0.0, 1.0);
  }
  if (kind < certain_share) return MaterialKnowledge::certain(q);
  return kind < certain_share + unknown_share ? MaterialKnowledge::none() : k;
}

Sequence sample_sequence(std::size_t position, const Example& example, const Training& training, RandomStream& random) {
  Sequence s;
  s.example = position;
  const bool from_start = random.uniform() < training.start_share;
  const Index start = random.below(static_cast<std::uint64_t>(example.segments()));
  s.start = from_start ? 0 : start;
  s.steps = std::min<Index>(example.segments() - s.start, training.max_steps);
  s.knowledge = sample_knowledge(example.q, training.certain_share, training.unknown_share, random);
  std::vector<Index> others;
  for (Index j = 1; j < s.steps; ++j) others.push_back(j);
  for (std::size_t i = 0; i < others.size(); ++i) std::swap(others[i], others[i + random.below(others.size() - i)]);
  others.resize(std::min(others.size(), static_cast<std::size_t>(training.decoded_steps - 1)));
  others.push_back(s.steps);
  std::sort(others.begin(), others.end());
  s.decoded = others;
  return s;
}

}  // namespace weft::emd
