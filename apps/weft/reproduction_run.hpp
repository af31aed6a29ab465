#pragma once
#include <chrono>
#include <map>
#include <set>
#include <string>
#include <vector>

#include "context.hpp"
#include "experiments/reproduction.hpp"
#include "progress_line.hpp"

namespace weft::app {

/// The options of `weft reproduce` that its commands get.
struct ReproduceOptions {
  std::string on;                    ///< --on
  std::string retry_failed;          ///< as WorkOptions has it
  std::vector<std::string> figures;  ///< svg, pdf
};

/// Runs the commands of parts as child processes of weft, one after the other, and makes measurements of their results.
class ReproductionRun {
 public:
  /// @param out folder of all results. All must outlive this object.
  ReproductionRun(Context& context, const Reproduction& all, const std::filesystem::path& out,
                  const ReproduceOptions& options);
  /// @return the exit code: 1 when something is missing or failed; 2 when a command refused its folder or its config.
  int run(const std::vector<const ReproductionPart*>& parts);

 private:
  using Clock = std::chrono::steady_clock;
  enum class End { done, failed, refused, interrupted };

  End run_step(const ReproductionStep& step, std::size_t number, std::size_t steps);
  End run_command(const ReproductionCommand& command, const std::string& label, const std::filesystem::path& log);
  End run_words(const std::vector<std::string>& words, const std::string& label, const std::filesystem::path& log);
  /// Whether a command that ended with code 1 has all that it was to measure: its results say what failed.
  bool has_results(const ReproductionCommand& command, std::filesystem::file_time_type begun) const;
  /// Writes NAME.json, NAME.md, NAME.tex and the pictures of a part whose steps are done. @return false if it cannot.
  bool measure(const ReproductionPart& part);
  void keep_seconds(const ReproductionStep& step, double seconds);
  double seconds_of(const ReproductionPart& part) const;
  void write_index() const;

  Context& context_;
  const Reproduction& all_;
  const std::filesystem::path out_;
  const ReproduceOptions& options_;
  ProgressLine line_;
  std::set<std::string> ended_;     ///< labels of steps whose results are there
  nlohmann::ordered_json seconds_;  ///< by label of the step, of all calls
  bool has_failures_ = false;       ///< of cases, in parts that are measured
};

}  // namespace weft::app
