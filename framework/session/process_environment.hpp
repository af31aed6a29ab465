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
  double timeout_s = 60.0;                     ///< for every message to or from the process
  double sigma = 0.0, height_sigma = 0.0;      ///< m, of observations that do not state their own
  std::optional<MaterialProperties> material;  ///< q, if the user knows it
};

/// A child process as the environment: a robot, a camera, another simulator, a recording. It reads requests as lines of
/// JSON from its stdin and answers each with one line on its stdout (docs/environment-protocol.md). The destructor
/// closes its stdin and kills the process if it does not end.
class ProcessEnvironment final : public Environment {
 public:
  static constexpr int kProtocolVersion = 1;
  static constexpr int kOpeningProtocolVersion = 2;  ///< of tasks with Manipulation::opens_at

  /// Starts the process and sends it the first request. @throws ConfigError if the command cannot be run.
  /// Every function throws Error naming the command if the process ends, exceeds timeout_s, refuses, or breaks the
  /// protocol.
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
  bool opens_early_ = false;  ///< hands may open one by one
  std::unique_ptr<Link> link_;
};

}  // namespace weft
