#include "simulation/hand_limits.hpp"

#include <Eigen/Cholesky>
#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>

namespace weft {
namespace {

constexpr double kClear = 1e-4;  // m inside the box, so that the way between two places is inside as well
constexpr Index kPlacesPerFrame = 3;
constexpr double kRounding = 1e-9;     // of a limit
constexpr double kPenaltyUnit = 0.01;  // m
constexpr Index kMostParts = 1000;
constexpr Index kMostIterations = 8;

/// Hands, ascending.
using HandList = std::vector<Index>;

HandList all_hands(Index count) {
  HandList hands(count);
  std::iota(hands.begin(), hands.end(), Index{0});
  return hands;
}

/// Of the rows of these hands.
double largest_norm(const Positions& vectors, const HandList& hands) {
  double largest = 0.0;
  for (const Index hand : hands) largest = std::max(largest, vectors.row(hand).norm());
  return largest;
}

/// Speed and acceleration limits, m per frame and m per frame^2.
double step_limit(const HandLimits& hands) { return hands.speed * kFrameSeconds * (1.0 + kRounding); }
double change_limit(const HandLimits& hands) {
  return hands.acceleration * kFrameSeconds * kFrameSeconds * (1.0 + kRounding);
}

/// By how much targets leave the box, or the hands come too close, m; 0 where they do not: [7 G] entries.
/// @param closed the hands that hold: only they count.
Vector place_excess(const HandLimits& hands, const Positions& targets, const HandList& closed, double clear) {
  Vector excess = Vector::Zero(7 * targets.rows());
  for (const Index g : closed) {
    const Vec3 target = targets.row(g).transpose();
    excess.segment<3>(7 * g) = (hands.lower - target).array() + clear;
    excess.segment<3>(7 * g + 3) = (target - hands.upper).array() + clear;
    for (const Index other : closed)
      if (other > g && hands.distance > 0.0)
        excess(7 * g + 6) =
            std::max(excess(7 * g + 6), hands.distance + clear - (targets.row(g) - targets.row(other)).norm());
  }
  return excess.cwiseMax(0.0);
}

/// Its gradient with respect to one entry that is above 0, [G, 3].
Positions place_gradient(const Positions& targets, const HandList& closed, Index entry) {
  Positions gradient = Positions::Zero(targets.rows(), 3);
  const Index g = entry / 7, kind = entry % 7;
  if (kind < 3) {
    gradient(g, kind) = -1.0;
  } else if (kind < 6) {
    gradient(g, kind - 3) = 1.0;
  } else {
    Index nearest = g;
    for (const Index other : closed)
      if (other > g && (nearest == g ||
                        (targets.row(g) - targets.row(other)).norm() < (targets.row(g) - targets.row(nearest)).norm()))
        nearest = other;
    const Eigen::RowVector3d away = (targets.row(g) - targets.row(nearest)).normalized();
    gradient.row(g) = -away;
    gradient.row(nearest) = away;
  }
  return gradient;
}

/// A row of controls as its hands move, divided into so many parts.
struct RowMotion {
  Positions first, last;            // [G, 3] m per frame
  HandList closed;                  // those that hold; they alone count
  double step = 0.0, change = 0.0;  // largest, within the row
};

class Limiter {
 public:
  Limiter(const Task& task, const Positions& step) : task_(task), trajectory_(*task.trajectory), hands_(task.hands) {
    step_ = step.rows() > 0 ? step : Positions(Positions::Zero(trajectory_.hands(), 3));
  }

  LimitedControls run(ConstVec state, const Controls& controls) {
    const Index horizon = controls.rows();
    Controls placed = controls;
    std::vector<Vector> before{Vector(state)};  // state before each row
    Index used = 0;
    for (; used < horizon; ++used) {
      if (hands_.bounds_place()) placed.row(used) = inside(before.back(), controls.row(used).transpose()).transpose();
      before.push_back(trajectory_.segment(task_.manipulation, before.back(), placed.row(used).transpose()).end_state);
      if (trajectory_.released(before.back())) {
        ++used;
        break;
      }
    }
    LimitedControls result;
    const std::vector<Index> parts = divided(before, placed.topRows(used), result.kept);
    result.controls.resize(horizon, controls.cols());
    for (Index j = 0; j < horizon && std::ssize(result.rows) < horizon; ++j) {
      const Index count = j < used ? parts[j] : 1;
      for (Index part = 0; part < count && std::ssize(result.rows) < horizon; ++part) {
        result.controls.row(std::ssize(result.rows)) = placed.row(j) / static_cast<double>(count);
        result.rows.push_back(j);
        result.parts.push_back(count);
      }
    }
    return result;
  }

 private:
  /// Several times a frame: divided rows stop at places between the frames of the whole one.
  std::vector<Positions> targets(const Vector& state, const Vector& control) const {
    const Vector part = control / static_cast<double>(kPlacesPerFrame);
    std::vector<Positions> places;
    Vector current = state;
    for (Index i = 0; i < kPlacesPerFrame * kFramesPerSegment; ++i) {
      current = trajectory_.advance(task_.manipulation, current, part);
      places.push_back(trajectory_.targets(task_.manipulation, current));
    }
    return places;
  }

  Vector excess(const Vector& state, const Vector& control, double clear) const {
    const auto path = targets(state, control);
    const Index each = 7 * trajectory_.hands();
    const HandList closed = trajectory_.holding(task_.manipulation, state);
    Vector all(each * std::ssize(path));
    for (Index t = 0; t < std::ssize(path); ++t)
      all.segment(each * t, each) = place_excess(hands_, path[t], closed, clear);
    return all;
  }

  /// The control nearest to the given one whose segment stays inside, by Gauss-Newton steps of least length.
  Vector inside(const Vector& state, const Vector& control) const {
    if (excess(state, control, 0.0).maxCoeff() <= 0.0) return control;
    const auto variables = trajectory_.controls();
    Vector found = control;
    for (Index iteration = 0; iteration < kMostIterations; ++iteration) {
      const Vector exceeds = excess(state, found, kClear);
      std::vector<Index> active;
      for (Index i = 0; i < exceeds.size(); ++i)
        if (exceeds(i) > 0.0) active.push_back(i);
      if (active.empty()) return found;
      Matrix jacobian(std::ssize(active), found.size());  // per scale
      for (Index c = 0; c < found.size(); ++c) {
        Vector moved = found;
        const double step = 1e-3 * variables[c].scale;
        moved(c) += step;
        const Vector there = excess(state, moved, kClear);
        for (Index i = 0; i < std::ssize(active); ++i) jacobian(i, c) = (there(active[i]) - exceeds(active[i])) / 1e-3;
      }
      const Matrix normal = jacobian.transpose() * jacobian;
      const double damping = 1e-6 * normal.trace() + 1e-20;
      const Vector correction = (normal + damping * Matrix::Identity(normal.rows(), normal.cols()))
                                    .ldlt()
                                    .solve(jacobian.transpose() * Vector(exceeds(active)));
      for (Index c = 0; c < found.size(); ++c)
        found(c) = std::clamp(found(c) - correction(c) * variables[c].scale, std::min(variables[c].lower, control(c)),
                              std::max(variables[c].upper, control(c)));
    }
    if (excess(state, found, 0.0).maxCoeff() <= 0.0) return found;
    // Nothing near it stays inside: the hands go as far as they can.
    double share = 0.0;
    for (double step = 0.5; step > 1e-3; step *= 0.5)
      if (excess(state, (share + step) * control, 0.0).maxCoeff() <= 0.0) share += step;
    return share * control;
  }

  RowMotion motion(const Vector& state, const Vector& control, Index parts) const {
    RowMotion motion;
    motion.closed = trajectory_.holding(task_.manipulation, state);
    const Vector part = control / static_cast<double>(parts);
    Vector current = state;
    Positions at = trajectory_.targets(task_.manipulation, state), step;
    for (Index frame = 0; frame < parts * kFramesPerSegment; ++frame) {
      current = trajectory_.advance(task_.manipulation, current, part);
      const Positions next = trajectory_.targets(task_.manipulation, current);
      const Positions moved = next - at;
      if (frame == 0)
        motion.first = moved;
      else
        motion.change = std::max(motion.change, largest_norm(moved - step, motion.closed));
      motion.step = std::max(motion.step, largest_norm(moved, motion.closed));
      step = moved;
      at = next;
    }
    motion.last = step;
    return motion;
  }

  /// Into how many parts each row is divided. @param kept set to false if no number of them helps in the first frame.
  std::vector<Index> divided(const std::vector<Vector>& before, const Controls& rows, bool& kept) const {
    const double most = step_limit(hands_), change = change_limit(hands_);
    std::vector<Index> parts(rows.rows(), 1);
    std::vector<RowMotion> motions(rows.rows());
    // At least into so many. More parts can bring a frame closer to a kink of the path, so each number is measured.
    const auto divide = [&](Index j, Index count) {
      while (true) {
        parts[j] = std::min(count, kMostParts);
        motions[j] = motion(before[j], rows.row(j).transpose(), parts[j]);
        if ((motions[j].step <= most && motions[j].change <= change) || parts[j] == kMostParts) return;
        const double factor = std::max(motions[j].step / most, std::sqrt(motions[j].change / change));
        count = std::max(parts[j] + 1, static_cast<Index>(std::floor(factor * static_cast<double>(parts[j]))));
      }
    };
    for (Index j = 0; j < rows.rows(); ++j) divide(j, 1);
    const auto jump = [&](Index j) {
      return largest_norm(motions[j].first - (j == 0 ? step_ : motions[j - 1].last), motions[j].closed);
    };
    for (Index j = 0; j < rows.rows();) {
      if (jump(j) <= change) {
        ++j;
        continue;
      }
      // The faster one goes more slowly; that may make the change before it too large.
      const double here = largest_norm(motions[j].first, motions[j].closed);
      const double there = largest_norm(j == 0 ? step_ : motions[j - 1].last, motions[j].closed);
      const bool is_later = j == 0 || here >= there;
      const Index slowed = is_later ? j : j - 1;
      if (parts[slowed] == kMostParts || (j == 0 && here < there)) {
        kept = false;
        return parts;
      }
      divide(slowed, parts[slowed] + 1);
      j = slowed;
    }
    return parts;
  }

  const Task& task_;
  const Trajectory& trajectory_;
  const HandLimits& hands_;
  Positions step_;
};

}  // namespace

HandMotionMeter::HandMotionMeter(const HandLimits& limits, const Positions& start, const Positions& step)
    : limits_(limits),
      at_(start),
      step_(step.rows() > 0 ? step : Positions(Positions::Zero(start.rows(), 3))),
      closed_(all_hands(start.rows())) {
  place(start);
}

void HandMotionMeter::open(const std::vector<Index>& hands) {
  for (const Index hand : hands) std::erase(closed_, hand);
}

void HandMotionMeter::place(const Positions& targets) {
  for (const Index g : closed_) {
    const Vec3 target = targets.row(g).transpose();
    motion_.outside =
        std::max({motion_.outside, (limits_.lower - target).maxCoeff(), (target - limits_.upper).maxCoeff()});
    for (const Index other : closed_)
      if (other > g) motion_.distance = std::min(motion_.distance, (targets.row(g) - targets.row(other)).norm());
  }
}

void HandMotionMeter::add(const Positions& targets) {
  const Positions step = targets - at_;
  motion_.speed = std::max(motion_.speed, largest_norm(step, closed_) / kFrameSeconds);
  motion_.acceleration =
      std::max(motion_.acceleration, largest_norm(step - step_, closed_) / (kFrameSeconds * kFrameSeconds));
  place(targets);
  at_ = targets;
  step_ = step;
}

Positions last_step(const Task& task, ConstVec state, ConstVec control) {
  const auto path = task.trajectory->segment(task.manipulation, state, control).targets;
  return path.back() - path[path.size() - 2];
}

LimitedControls within_limits(const Task& task, ConstVec state, const Positions& step, const Controls& controls) {
  return Limiter(task, step).run(state, controls);
}

Vector limit_residuals(const Task& task, ConstVec state, const Positions& step, const Controls& controls, Index u,
                       std::vector<Controls>* gradients) {
  const auto& trajectory = *task.trajectory;
  const HandLimits& hands = task.hands;
  const Index frames = u * kFramesPerSegment, count = trajectory.hands();
  Vector residuals = Vector::Zero(4 * controls.rows());
  if (gradients) gradients->assign(residuals.size(), Controls());

  Matrix states(state.size(), frames + 1);
  std::vector<Positions> targets(frames + 1);
  states.col(0) = state;
  for (Index t = 0; t <= frames; ++t) {
    if (t > 0)
      states.col(t) = trajectory.advance(task.manipulation, states.col(t - 1),
                                         controls.row((t - 1) / kFramesPerSegment).transpose());
    targets[t] = trajectory.targets(task.manipulation, states.col(t));
  }
  const Positions rest = step.rows() > 0 ? step : Positions(Positions::Zero(count, 3));
  const auto moved = [&](Index t) -> Positions { return t == 0 ? rest : Positions(targets[t] - targets[t - 1]); };

  for (Index j = 0; j < u; ++j) {
    const HandList closed = trajectory.holding(task.manipulation, states.col(j * kFramesPerSegment));
    std::array<double, 4> squares{};
    // 1/2 d squares / d targets, of the frames up to the segment's last.
    std::array<std::vector<Positions>, 4> cotangents;
    if (gradients) cotangents.fill(std::vector<Positions>(frames + 1, Positions::Zero(count, 3)));
    const auto add_vector = [&](int kind, Index g, const Vec3& vector, double limit,
                                std::initializer_list<std::pair<Index, double>> parts) {
      const double excess = vector.norm() / limit - 1.0;
      if (!(excess > 0.0)) return;
      squares[kind] += excess * excess;
      if (!gradients) return;
      const Vec3 direction = excess / limit * vector.normalized();
      for (const auto& [t, factor] : parts)
        if (t >= 0) cotangents[kind][t].row(g) += factor * direction.transpose();
    };
    for (Index t = j * kFramesPerSegment + 1; t <= (j + 1) * kFramesPerSegment; ++t) {
      for (const Index g : closed) {
        if (hands.speed < HandLimits::kNone)
          add_vector(0, g, moved(t).row(g).transpose(), hands.speed * kFrameSeconds, {{t, 1.0}, {t - 1, -1.0}});
        if (hands.acceleration < HandLimits::kNone)
          add_vector(1, g, (moved(t) - moved(t - 1)).row(g).transpose(),
                     hands.acceleration * kFrameSeconds * kFrameSeconds,
                     {{t, 1.0}, {t - 1, t == 1 ? -1.0 : -2.0}, {t - 2, 1.0}});
      }
      const Vector outside = place_excess(hands, targets[t], closed, 0.0);
      for (Index i = 0; i < outside.size(); ++i) {
        if (!(outside(i) > 0.0)) continue;
        const int kind = i % 7 == 6 ? 2 : 3;
        const double excess = outside(i) / kPenaltyUnit;
        squares[kind] += excess * excess;
        if (gradients) cotangents[kind][t] += excess / kPenaltyUnit * place_gradient(targets[t], closed, i);
      }
    }
    for (int kind = 0; kind < 4; ++kind) {
      if (!(squares[kind] > 0.0)) continue;
      const double mean = squares[kind] / static_cast<double>(kFramesPerSegment * count);
      const double residual = std::sqrt(mean);
      residuals(4 * j + kind) = residual;
      if (!gradients) continue;
      Controls& gradient = (*gradients)[4 * j + kind];
      gradient = Controls::Zero(controls.rows(), controls.cols());
      Vector d_state = Vector::Zero(state.size()), d_before, d_control;
      for (Index t = (j + 1) * kFramesPerSegment; t > 0; --t) {
        if (!cotangents[kind][t].isZero(0.0))
          d_state += trajectory.targets_pullback(task.manipulation, states.col(t), cotangents[kind][t]);
        const Index row = (t - 1) / kFramesPerSegment;
        trajectory.advance_pullback(task.manipulation, states.col(t - 1), controls.row(row).transpose(), d_state,
                                    d_before, d_control);
        gradient.row(row) += d_control.transpose();
        d_state = d_before;
      }
      gradient /= residual * static_cast<double>(kFramesPerSegment * count);
    }
  }
  return residuals;
}

}  // namespace weft
