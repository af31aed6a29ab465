#pragma once
#include <unistd.h>

#include <atomic>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <iostream>
#include <limits>
#include <map>
#include <string>
#include <thread>

#include "weft/params.hpp"

/// The toys: one small plugin per kind that obeys every law, and breaks the law named in `mutation`.
namespace weft::toy {

struct Params {
  std::string mutation = "none";
  std::string spoil = "none";
  std::string result = "all";
  std::string fault = "none";
  bool declare = true;
  bool accept = false;

  template <class Visitor>
  void visit(Visitor& v) {
    v("mutation", mutation, "The law to break, or none.");
    v("spoil", spoil, "What is wrong with `result`: nan, empty or long (an entry too many); none: nothing.");
    v("result", result, "Which result is spoilt, such as targets; all: every one.");
    v("fault", fault, "What happens in the toy's main call: exit, null_pointer, spin, throw_42, ...; none: nothing.");
    v("declare", declare, "Declare the optional abilities that the toy has.");
    v("accept", accept, "Do not refuse what is not declared: a mutant of its own.");
  }
};

/// 0 for the first thread (or object) that asks, 1 for the next, ...
inline int thread_ordinal() {
  static std::atomic<int> next{0};
  thread_local const int mine = next++;
  return mine;
}
inline int object_ordinal() {
  static std::atomic<int> next{0};
  return next++;
}

/// Whether this result is spoilt in this way.
inline bool spoils(const Params& p, const char* how, const char* result) {
  return p.spoil == how && (p.result == result || p.result == "all");
}
/// A result of a toy, spoilt if that is the mutation: all of it NaN, no rows, or a row too many.
template <class Array>
Array spoilt(const Params& p, const char* result, Array values) {
  if (spoils(p, "nan", result)) values.setConstant(std::numeric_limits<double>::quiet_NaN());
  if (spoils(p, "empty", result)) values.resize(0, values.cols());
  if (spoils(p, "long", result)) {
    Array longer = Array::Zero(values.rows() + 1, values.cols());
    longer.topRows(values.rows()) = values;
    return longer;
  }
  return values;
}
inline double spoilt(const Params& p, const char* result, double value) {
  return spoils(p, "nan", result) ? std::numeric_limits<double>::quiet_NaN() : value;
}

/// What plugins do wrong besides returning nonsense. A function of its own, which the report of a crash can name.
[[gnu::noinline]] inline void misbehave(const Params& p) {
  const std::string& fault = p.fault;
  if (fault == "none") return;
  if (fault == "exit") std::exit(0);
  if (fault == "_exit") ::_exit(0);
  if (fault == "_Exit") std::_Exit(0);
  if (fault == "quick_exit") std::quick_exit(0);
  if (fault == "abort") std::abort();
  if (fault == "throw_42") throw 42;
  if (fault == "throw_map_at") std::map<int, int>().at(1);
  if (fault == "throw_in_thread") std::thread([] { throw 42; }).join();
  if (fault == "print") {
    std::printf("printf of a plugin\n");
    std::fflush(stdout);
    std::cout << "cout of a plugin" << std::endl;
  }
  if (fault == "null_pointer") {
    int* volatile nowhere = nullptr;
    *nowhere = 1;
  }
  if (fault == "spin") {
    // An endless loop without a side effect may be taken for unreachable.
    for (std::atomic<long> i{0};;) i.fetch_add(1, std::memory_order_relaxed);
  }
  if (fault == "sleep") std::this_thread::sleep_for(std::chrono::hours(24));
}

}  // namespace weft::toy
