#pragma once
#include <atomic>
#include <string>

#include "weft/params.hpp"

/// The toys: one small plugin per kind that obeys every law, and breaks the law named in `mutation`.
namespace weft::toy {

struct Params {
  std::string mutation = "none";
  bool declare = true;
  bool accept = false;

  template <class Visitor>
  void visit(Visitor& v) {
    v("mutation", mutation, "The law to break, or none.");
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

}  // namespace weft::toy
