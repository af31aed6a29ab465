#pragma once
#include <cstddef>
#include <cstdint>
#include <string>

namespace weft {

/// What a thread is doing: one entry of a list on its stack, newest first. Entering and leaving is two stores, so that
/// every call into a plugin can be recorded. A signal handler may read the list of its own thread.
class Where {
 public:
  Where(const Where&) = delete;
  Where& operator=(const Where&) = delete;

  /// The newest entry of this thread; null: none. Another thread may work on behalf of it while it exists.
  static const Where* here() { return head_; }

 protected:
  enum class Kind : std::uint8_t { step, plugin, program };
  Where(Kind kind, const char* name, const char* call, std::int64_t number)
      : name_(name), call_(call), number_(number), kind_(kind), outer_(head_) {
    head_ = this;
  }
  ~Where() { head_ = outer_; }

 private:
  friend class OnBehalfOf;
  friend std::size_t write_entries(char* buffer, std::size_t size, bool with_call) noexcept;

  static inline constinit thread_local const Where* head_ = nullptr;
  const char* name_;
  const char* call_;
  std::int64_t number_;
  Kind kind_;
  const Where* outer_;
};

/// A step of the work, from construction to destruction: Step("planning"), Step("segment", 3). Texts must outlive it.
class Step : Where {
 public:
  explicit Step(const char* name, std::int64_t number = -1) : Where(Kind::step, name, nullptr, number) {}
};

/// A call into a plugin: PluginCall("optimiser adam", "minimise()"). Texts must outlive it.
class PluginCall : Where {
 public:
  PluginCall(const char* plugin, const char* call) : Where(Kind::plugin, plugin, call, -1) {}
};

/// A call back from a plugin into the program. What fails in it is not the plugin's fault.
class ProgramCall : Where {
 public:
  ProgramCall() : Where(Kind::program, "weft", nullptr, -1) {}
};

/// This thread works for another one, whose entries it continues: a thread pool. That thread must wait for it.
class OnBehalfOf {
 public:
  explicit OnBehalfOf(const Where* other) : before_(Where::head_) { Where::head_ = other; }
  ~OnBehalfOf() { Where::head_ = before_; }
  OnBehalfOf(const OnBehalfOf&) = delete;
  OnBehalfOf& operator=(const OnBehalfOf&) = delete;

 private:
  const Where* before_;
};

/// Writes the innermost plugin call and all steps of this thread: "optimiser adam, minimise(), planning, segment 3".
/// Neither allocates nor locks, so a signal handler may call it (crash_report.hpp).
/// @param buffer gets at most `size` - 1 characters and a null.
/// @return the number of characters; 0 if the thread does nothing that is recorded.
std::size_t write_where(char* buffer, std::size_t size) noexcept;
/// The same as a string. The call is left out where a step says when it was: "optimiser adam, planning, segment 3", but
/// "predictor emd, bind()".
std::string where_text();

}  // namespace weft
