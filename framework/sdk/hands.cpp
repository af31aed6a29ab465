#include "weft/hands.hpp"

#include <algorithm>

#include "weft/error.hpp"

namespace weft {

std::vector<Index> vertices_of(const Manipulation& manipulation, const std::vector<Index>& hands) {
  std::vector<Index> vertices;
  for (const Index hand : hands) vertices.push_back(manipulation.grasp_vertices.at(hand));
  return vertices;
}

void move_hands(Simulator& simulator, const Manipulation& manipulation, const Positions& targets) {
  const auto& hands = manipulation.grasp_vertices;
  require_shape("move_hands: rows of targets", targets.rows(), std::ssize(hands));
  const auto held = simulator.grasped();
  if (held == hands) {
    simulator.step(targets);
    return;
  }
  Positions rows(std::ssize(held), 3);
  for (Index k = 0; k < rows.rows(); ++k) {
    const auto hand = std::find(hands.begin(), hands.end(), held[k]) - hands.begin();
    if (hand == std::ssize(hands))
      throw ShapeError("move_hands: vertex " + std::to_string(held[k]) +
                       " is held, but by no hand of the manipulation");
    rows.row(k) = targets.row(hand);
  }
  simulator.step(rows);
}

void open_hands(Simulator& simulator, const Manipulation& manipulation, const std::vector<Index>& hands) {
  if (hands.empty()) return;
  const auto held = simulator.grasped();
  auto vertices = vertices_of(manipulation, hands);
  std::erase_if(vertices, [&](Index vertex) { return std::find(held.begin(), held.end(), vertex) == held.end(); });
  simulator.release(vertices);
}

}  // namespace weft
