#include "experiments/benchmark/frames.hpp"

#include <cmath>
#include <numbers>

#include "experiments/benchmark/clock.hpp"
#include "experiments/physics/sheets.hpp"
#include "weft/config.hpp"

namespace weft::benchmark {
namespace {

constexpr double kSide = 0.6;                      // m
constexpr Index kLyingBefore = 30, kResting = 60;  // frames
constexpr Index kMoving = 90, kHanging = 60, kAfterFold = 60;

/// Where the two held corners, at y = 0, are when a motion is done by this part, [2, 3] m.
Positions held_corners(bool is_fold, double part, double thickness) {
  Positions targets(2, 3);
  if (is_fold) {
    // Without a jerk at the ends, and nearer to each other on the way: the edge between them sags, and must not be stretched.
    const double angle = std::numbers::pi * part * part * (3.0 - 2.0 * part), radius = 0.5 * kSide;
    const double x = 0.1 * std::sin(angle);
    const double y = radius * (1.0 - std::cos(angle)), z = thickness * (1.0 + part) + radius * std::sin(angle);
    targets << x, y, z, kSide - x, y, z;
  } else {
    const double z = thickness + 0.5 * part;
    targets << 0.15 * part, 0.0, z, kSide - 0.15 * part, 0.0, z;
  }
  return targets;
}

}  // namespace

nlohmann::ordered_json measure_frames(const Row& row, const std::filesystem::path& fabrics, Host& host) {
  const ConfigNode file = ConfigNode::load(fabrics / (row.at("fabric").get<std::string>() + ".yaml"));
  const Fabric fabric = read_fabric(file.has("nominal") ? file.at("nominal") : file);
  const auto side = std::lround(std::sqrt(row.at("vertices").get<double>()));
  const physics::Sheet sheet =
      physics::strip(kSide, kSide, kSide / static_cast<double>(side - 1), physics::Pattern::regular);
  const auto garment = sheet.garment();
  const auto motion = row.at("motion").get<std::string>();
  const auto simulator = host.create<Simulator>(
      ConfigNode::mapping({{"plugin", ConfigNode::scalar(row.at("simulator").get<std::string>())}}));

  Clock clock;
  simulator->reset(garment, fabric, Scene());
  nlohmann::ordered_json numbers{{"reset_cpu_ms", clock.cpu_ms()}};
  const auto step = [&](const Positions& targets) {
    if (host.cancelled()) throw Error("cancelled");
    simulator->step(targets);
  };
  Index frames = 0;
  if (motion == "resting") {
    for (Index k = 0; k < kLyingBefore; ++k) step(physics::kNothing);
    clock.restart();
    for (; frames < kResting; ++frames) step(physics::kNothing);
  } else {
    const bool is_fold = motion == "folding";
    simulator->grasp(std::vector<Index>{0, side - 1});
    clock.restart();
    for (; frames < kMoving; ++frames)
      step(held_corners(is_fold, static_cast<double>(frames + 1) / kMoving, fabric.thickness_m));
    if (is_fold) simulator->release();
    const Positions still = is_fold ? physics::kNothing : held_corners(false, 1.0, fabric.thickness_m);
    for (; frames < kMoving + (is_fold ? kAfterFold : kHanging); ++frames) step(still);
  }
  numbers["cpu_ms"] = clock.cpu_ms() / static_cast<double>(frames);
  numbers["wall_ms"] = clock.wall_ms() / static_cast<double>(frames);
  numbers["frames"] = frames;
  if (const std::string warning = simulator->diagnostics().warning; !warning.empty()) numbers["note"] = warning;
  return numbers;
}

}  // namespace weft::benchmark
