#include "session/twin.hpp"

#include <utility>

#include "simulation/start_shape.hpp"
#include "weft/hands.hpp"

namespace weft {

/// A simulator that nobody uses now, and the material it was last reset with.
struct Twin::Idle {
  std::shared_ptr<Simulator> simulator;
  std::optional<MaterialProperties> material;
};

class Twin::Lease {
 public:
  explicit Lease(const Twin& owner) : owner_(owner) {
    {
      const std::lock_guard lock(owner.mutex_);
      if (!owner.idle_.empty()) {
        mine_ = std::move(owner.idle_.back());
        owner.idle_.pop_back();
      }
    }
    if (!mine_.simulator) mine_.simulator = owner.host_.create<Simulator>(owner.simulator_);
  }
  ~Lease() {
    const std::lock_guard lock(owner_.mutex_);
    owner_.idle_.push_back(std::move(mine_));
  }
  Lease(const Lease&) = delete;
  Lease& operator=(const Lease&) = delete;

  Simulator& operator*() const { return *mine_.simulator; }
  Simulator* operator->() const { return mine_.simulator.get(); }
  /// The garment at the start, held by the hands.
  void reset(const MaterialProperties& material) {
    const Task& task = owner_.task_;
    mine_.material.reset();
    begin(*mine_.simulator, task, task.material.at(material));
    mine_.material = material;
  }
  bool has(const MaterialProperties& material) const { return mine_.material == material; }
  /// A run that diverged must be reset.
  void spoil() { mine_.material.reset(); }

 private:
  const Twin& owner_;
  Idle mine_;
};

Twin::Twin(const Task& task, const ConfigNode& simulator, Host& host)
    : task_(task), simulator_(simulator.is_null() ? task.simulator : simulator), host_(host) {
  const Lease first(*this);  // reports a wrong simulator now, not in the first correction
}

Twin::~Twin() = default;

void Twin::place(Lease& lease, const TwinState& from) const {
  if (!lease.has(from.material)) lease.reset(from.material);
  if (from.snapshot)
    lease->restore(*from.snapshot);
  else
    lease->set_state(from.positions, from.velocities, task_.held_at(from.state));
}

TwinState Twin::start(const MaterialProperties& material) const {
  Lease lease(*this);
  lease.reset(material);
  TwinState start;
  start.material = material;
  start.state = task_.trajectory->initial_state(task_.manipulation);
  read_state(lease, start);
  return start;
}

TwinState Twin::advance(const TwinState& from, ConstVec control) const {
  Lease lease(*this);
  place(lease, from);
  TwinState after = from;
  const SegmentPath path = task_.trajectory->segment(task_.manipulation, from.state, control);
  try {
    for (const auto& targets : path.targets) move_hands(*lease, task_.manipulation, targets);
    open_hands(*lease, task_.manipulation, path.opening);
  } catch (const Diverged&) {
    lease.spoil();
    throw;
  }
  after.state = path.end_state;
  read_state(lease, after);
  return after;
}

void Twin::read_state(Lease& lease, TwinState& state) {
  state.positions = lease->positions();
  state.velocities = lease->velocities();
  state.snapshot = lease->capabilities().snapshots ? lease->save() : nullptr;
}

FoldResult Twin::fold(const TwinState& from, const Controls& controls) const {
  Lease lease(*this);
  return fold(lease, from, controls);
}

TwinSequence Twin::sequence(const MaterialProperties& material, const Controls& controls) const {
  TwinSequence none;
  none.end = start(material);
  return longer(std::move(none), controls);
}

TwinSequence Twin::longer(TwinSequence so_far, const Controls& controls) const {
  Lease lease(*this);
  FoldResult fold = this->fold(lease, so_far.end, controls.bottomRows(controls.rows() - std::ssize(so_far.shapes)));
  for (auto& shape : fold.shapes) so_far.shapes.push_back(std::move(shape));
  so_far.released = fold.released;
  if (fold.segments > 0) so_far.end.state = fold.states.bottomRows(1).transpose();
  if (!fold.released) read_state(lease, so_far.end);
  return so_far;
}

FoldResult Twin::fold(Lease& lease, const TwinState& from, const Controls& controls) const {
  place(lease, from);
  FoldResult result;
  result.states.resize(0, from.state.size());
  try {
    continue_fold(*lease, task_, from.state, controls, result);
  } catch (const Diverged&) {
    lease.spoil();
    throw;
  }
  return result;
}

}  // namespace weft
