#pragma once
#include <Eigen/Core>
#include <string>

#include "loader/where.hpp"
#include "weft/types.hpp"

namespace weft {

/// Whether every number is finite. A sum of zeros is vectorised, and allFinite() is not.
inline bool all_finite(const double* numbers, Index count) {
  return (Eigen::Map<const Eigen::ArrayXd>(numbers, count) * 0.0).sum() == 0.0;
}
template <class Array>
bool all_finite(const Array& array) {
  return all_finite(array.data(), array.size());
}

/// Rethrows the current exception as one of weft's, with the same type if it has one, so that it names who failed and
/// where. An exception that a guard has named already passes unchanged.
/// @param name the plugin's name; a message that starts with it does not repeat it.
[[noreturn]] void rethrow_named(const std::string& name);
/// The same without the name: what failed is not the plugin that is being called. Outer guards let it pass.
[[noreturn]] void rethrow_unblamed();
/// As rethrow_named(), but a ConfigError passes as it is: it is about the user's input, and says where that stands.
[[noreturn]] void rethrow_named_but_config(const std::string& name);

/// Calls into one plugin, and checks of what it returns. Everything that a guard throws names the plugin and the steps
/// of the work: "optimiser adam, planning, segment 3: ...".
class Guard {
 public:
  /// @param callers_too false: what the plugin is given is its own to check.
  Guard(const std::string& kind, std::string name, bool callers_too)
      : name_(std::move(name)), label_(kind + " " + name_), callers_too_(callers_too) {}

  /// Returns body(), a call into the plugin and the checks of its result.
  /// @param call "minimise()", for the report of a crash.
  template <class Body>
  decltype(auto) call(const char* call, Body&& body) const {
    const PluginCall entry(label_.c_str(), call);
    try {
      return body();
    } catch (...) {
      rethrow_named(name_);
    }
  }
  /// For calls that check what the user wrote, such as reset() and bind().
  template <class Body>
  decltype(auto) set_up(const char* call, Body&& body) const {
    const PluginCall entry(label_.c_str(), call);
    try {
      return body();
    } catch (...) {
      rethrow_named_but_config(name_);
    }
  }

  // Checks, inside call(). `what` is the subject of a sentence: "the state from advance()".
  void want_size(const char* what, Index got, Index wanted) const {
    if (got != wanted) [[unlikely]]
      fail_size(what, got, wanted);
  }
  /// @param given to the plugin: where that is not finite, the result need not be.
  template <class Array, class... Given>
  void want_finite(const char* what, const Array& array, const Given&... given) const {
    if (!all_finite(array) && (all_finite(given) && ...)) [[unlikely]]
      fail_not_finite(what);
  }
  /// @throws NotFinite. @param what as above.
  [[noreturn]] void fail_not_finite(const std::string& what) const;
  /// @throws WrongResult: "optimiser adam, planning, segment 3: <problem>; ..."
  [[noreturn]] void fail(const std::string& problem) const;
  [[noreturn]] void fail_size(const char* what, Index got, Index wanted) const;

  // Checks of what a caller gives to the plugin, before call(): not the plugin is wrong, but who called it.
  void want_from_caller(const char* what, Index got, Index wanted) const {
    if (got != wanted && callers_too_) [[unlikely]]
      blame_caller_size(what, got, wanted);
  }
  /// @throws ShapeError: "predictor mine, planning, segment 3: gave trajectory arc <problem>"
  [[noreturn]] void blame_caller(const std::string& problem) const;
  [[noreturn]] void blame_caller_size(const char* what, Index got, Index wanted) const;

  bool callers_too() const { return callers_too_; }

 private:
  std::string wrong_result(const std::string& problem) const;
  std::string name_;   // "adam"
  std::string label_;  // "optimiser adam"
  bool callers_too_;
};

/// Returns body(), which a plugin calls back. What it throws is not the plugin's fault.
template <class Body>
decltype(auto) call_back(Body&& body) {
  const ProgramCall entry;
  try {
    return body();
  } catch (...) {
    rethrow_unblamed();
  }
}

}  // namespace weft
