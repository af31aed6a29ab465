#pragma once
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "session/environment.hpp"

namespace weft {

struct ProcessOptions {
  std::vector<std::string> command;  ///< program, searched in PATH, and its arguments
  std::filesystem::path folder = ".";
  double timeout_s = 60.0;                     ///< for every message that the process must take or send
  double sigma = 0.0, height_sigma = 0.0;      ///< m, of an observation that does not say its own
  std::optional<MaterialProperties> material;  ///< q, where the user knows it
};

/// A child process as the environment: a robot, a camera, another simulator, a recording. It gets requests as lines of
/// JSON on its stdin and answers each with one line on its stdout; docs/environment-protocol.md is the contract. The
/// destructor closes its stdin, and kills a process that does not end then.
class ProcessEnvironment final : public Environment {
 public:
  static constexpr int kProtocolVersion = 1;

  /// Starts the process and greets it. @throws ConfigError when the command cannot be run. Every function throws Error
  /// naming the command when the process ends, takes longer than timeout_s, refuses, or breaks the protocol.
  ProcessEnvironment(const ProcessOptions& options, const Task& task);
  ~ProcessEnvironment() override;
  Observation observe() override;
  void execute(const SegmentPath& path) override;
  SettleResult release() override;
  std::vector<std::string> warnings() const override;
  std::optional<MaterialProperties> true_material() const override { return options_.material; }

 private:
  class Link;
  ProcessOptions options_;
  Index vertices_ = 0;
  std::unique_ptr<Link> link_;
};

}  // namespace weft
