#pragma once
#include <cmath>
#include <cstring>
#include <limits>
#include <memory>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "conformance/conformance.hpp"
#include "loader/checked.hpp"
#include "weft/predictor.hpp"

/// Shared by the laws of all kinds. Internal to the conformance kit.
namespace weft::conformance {

/// The plugin under check, and the host and task for it.
struct Bench {
  Host& host;
  ConfigNode slot;  ///< {plugin, params}
  ConfigNode task;  ///< `task:` of the tolerances; null: the kit's own

  template <class Interface>
  std::shared_ptr<Interface> make() const {
    return host.create<Interface>(slot);
  }
};

struct Outcome {
  double measured = 0.0;
  std::string detail;
};

struct Law {
  const char* name;
  const char* text;
  double bound;
  Outcome (*check)(const Bench&);
};

const std::vector<Law>& simulator_laws();
const std::vector<Law>& predictor_laws();
const std::vector<Law>& trajectory_laws();
const std::vector<Law>& optimiser_laws();

// One valid use of a plugin of each kind, before a law. A law that only looks at refusals then fails too for a plugin
// whose results are empty or not finite.
void probe_simulator(const Bench& bench);
void probe_predictor(const Bench& bench);
void probe_trajectory(const Bench& bench);
void probe_optimiser(const Bench& bench);

/// The task that predictors are bound to: `task:` of the tolerances if given, else the kit's towel fold.
Task predictor_task(const Bench& bench);

inline Outcome failed(std::string why) { return {std::numeric_limits<double>::infinity(), std::move(why)}; }
/// The capability is not declared, and the call for it was refused.
inline Outcome undeclared() { return {0.0, "not declared; throws Unsupported"}; }
/// The capability is not declared, and the interface has no call for it.
inline Outcome undeclared_without_call() { return {0.0, "not declared; there is no call to refuse"}; }

/// Counts the calls that were not refused but should have been.
class Refusals {
 public:
  /// Runs `call`, which must throw one of Wanted... (or something derived from it).
  template <class... Wanted, class Call>
  void wants(const std::string& what, Call&& call) {
    try {
      call();
      miss(what + " was accepted");
    } catch (const WrongResult& error) {
      miss(what + " was accepted: " + error.what());
    } catch (const std::exception& error) {
      if (!(... || (dynamic_cast<const Wanted*>(&error) != nullptr)))
        miss(what + " threw the wrong kind of error: " + error.what());
    }
  }
  void miss(const std::string& what) {
    ++missed_;
    if (detail_.size() < 400) detail_ += (detail_.empty() ? "" : "; ") + what;
  }
  Outcome outcome() const { return {static_cast<double>(missed_), detail_}; }

 private:
  int missed_ = 0;
  std::string detail_;
};

/// The largest value that a law measures, at least 0. A NaN stays, so that the law fails; std::max() and Eigen's
/// maxCoeff() would ignore it.
class Worst {
 public:
  void add(double value) {
    if (!std::isnan(worst_) && !(value <= worst_)) worst_ = value;
  }
  /// Each entry of an array.
  template <class Derived>
  void add(const Eigen::DenseBase<Derived>& values) {
    for (Index c = 0; c < values.cols(); ++c)
      for (Index r = 0; r < values.rows(); ++r) add(values.derived().coeff(r, c));
  }
  double value() const { return worst_; }
  Outcome outcome() const { return {worst_, ""}; }

 private:
  double worst_ = 0.0;
};

/// The number of entries that differ in at least one bit; all of them if the shapes differ.
template <class A, class B>
double differing(const A& a, const B& b) {
  if (a.rows() != b.rows() || a.cols() != b.cols()) return static_cast<double>(std::max(a.size(), b.size()));
  double count = 0;
  for (Index r = 0; r < a.rows(); ++r) {
    for (Index c = 0; c < a.cols(); ++c) {
      const double x = a(r, c), y = b(r, c);
      if (std::memcmp(&x, &y, sizeof x) != 0) ++count;
    }
  }
  return count;
}

/// A square towel of n x n vertices in the plane z, corner at the origin, named corners; vertex row * n + column, x =
/// column.
std::shared_ptr<const Garment> towel(Index n, double size, double z = 0.0);
/// Isotropic, undamped.
Fabric plain_fabric();
/// Runs both at the same time on two threads; rethrows what they throw.
template <class First, class Second>
void on_two_threads(First&& first, Second&& second) {
  std::exception_ptr errors[2];
  std::thread a([&] {
    try {
      first();
    } catch (...) {
      errors[0] = std::current_exception();
    }
  });
  std::thread b([&] {
    try {
      second();
    } catch (...) {
      errors[1] = std::current_exception();
    }
  });
  a.join();
  b.join();
  for (const auto& error : errors)
    if (error) std::rethrow_exception(error);
}

}  // namespace weft::conformance
