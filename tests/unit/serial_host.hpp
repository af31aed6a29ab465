#pragma once
#include "weft/host.hpp"

namespace weft::test {

/// A host without a loader: one thread, seed 1, no messages. A test that needs a plugin overrides create_erased().
class SerialHost : public Host {
 public:
  int threads() const override { return 1; }
  void parallel_for(std::int64_t count, const std::function<void(std::int64_t)>& body) override {
    for (std::int64_t i = 0; i < count; ++i) body(i);
  }
  bool cancelled() const override { return false; }
  void log(LogLevel, const std::string&) override {}
  std::uint64_t seed() const override { return 1; }

 protected:
  std::shared_ptr<void> create_erased(const std::string&, const ConfigNode&) override { return nullptr; }
};

}  // namespace weft::test
