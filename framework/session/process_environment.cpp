#include "session/process_environment.hpp"

#include <algorithm>
#include <cmath>
#include <csignal>
#include <limits>
#include <nlohmann/json.hpp>
#include <optional>

#include "processes/child_process.hpp"
#include "sdk/json_text.hpp"
#include "weft/config.hpp"

namespace weft {
namespace {

using json = nlohmann::json;

constexpr const char* kProtocol = "weft environment";
constexpr double kGraceSeconds = 2.0;  ///< wait for the process to end by itself, and once more after SIGTERM

/// The beginning of a process's output, for a message.
std::string excerpt(const std::string& text) {
  constexpr std::size_t kMost = 80;
  std::string shown = text.substr(0, kMost);
  for (char& c : shown) {
    if (c < ' ' || c > '~') c = '?';
  }
  return "'" + shown + (text.size() > kMost ? "...'" : "'");
}

std::string seconds_text(double seconds) { return ConfigNode::number(seconds).as_string() + " s"; }

json rows_of(const auto& matrix) {
  auto rows = json::array();
  for (Index r = 0; r < matrix.rows(); ++r) {
    auto row = json::array();
    for (Index c = 0; c < matrix.cols(); ++c) row.push_back(matrix(r, c));
    rows.push_back(std::move(row));
  }
  return rows;
}

/// A process that does not know that hands open one by one would hold on, so such a task has a version of its own.
int protocol_version(const Task& task) {
  return task.manipulation.opens_at.size() > 0 ? ProcessEnvironment::kOpeningProtocolVersion
                                               : ProcessEnvironment::kProtocolVersion;
}

/// The first request: all that the process must know about the task.
json greeting(const Task& task) {
  const auto& garment = *task.garment;
  json hello{{"type", "hello"},
             {"protocol", kProtocol},
             {"version", protocol_version(task)},
             {"garment",
              {{"name", garment.name},
               {"vertices", garment.vertex_count()},
               {"positions_m", rows_of(garment.positions)},
               {"rest_positions_m", rows_of(garment.rest)},
               {"faces", rows_of(garment.faces)}}},
             {"grasp_vertices", task.manipulation.grasp_vertices},
             {"grasp_points_m", rows_of(task.manipulation.grasp_points)},
             {"frame_s", kFrameSeconds},
             {"frames_per_segment", kFramesPerSegment},
             {"settle",
              {{"speed_m_per_s", task.settle.speed},
               {"hold_s", task.settle.hold_frames * kFrameSeconds},
               {"timeout_s", task.settle.max_frames * kFrameSeconds}}}};
  if (garment.has_frames()) hello["garment"]["rest_frames_m"] = rows_of(garment.form.frames);
  if (!garment.form.layers.empty()) hello["garment"]["layers"] = garment.form.layers;
  return hello;
}

}  // namespace

/// The process and its two pipes, which carry lines.
class ProcessEnvironment::Link {
 public:
  Link(const ProcessOptions& options, Index vertices) : timeout_s_(options.timeout_s) {
    for (const auto& word : options.command) name_ += (name_.empty() ? "" : " ") + word;
    longest_line_ = 1'000'000 + 1'000 * static_cast<std::size_t>(vertices);
    if (!std::filesystem::is_directory(options.folder))
      throw ConfigError("the working folder " + options.folder.string() + " does not exist");
    // Its own process group: ^C ends a session after the current segment, and must not reach the robot's process.
    process_.emplace(ChildOptions{.command = options.command, .folder = options.folder, .own_group = true});
  }
  ~Link() {
    if (!process_) return;
    process_->close_input();
    process_->close_output();
    for (const int signal : {SIGTERM, SIGKILL}) {
      if (process_->wait_until(seconds_from_now(kGraceSeconds))) break;
      process_->kill(signal);
    }
  }

  [[noreturn]] void fail(const std::string& message) const { throw Error("environment `" + name_ + "` " + message); }

  /// Sends a request and reads its answer. @param wanted type of the answer.
  json ask(const json& request, const std::string& wanted) {
    const auto asked = request.at("type").get<std::string>();
    const auto deadline = seconds_from_now(timeout_s_);
    send(asked, request.dump() + "\n", deadline);
    const json answer = parsed(asked, receive(asked, deadline));
    if (!answer.is_object() || !answer.contains("type") || !answer["type"].is_string())
      fail("answered " + asked + " with " + excerpt(answer.dump()) + ", must be an object with a type");
    const auto type = answer["type"].get<std::string>();
    if (type == "error") fail("refuses " + asked + ": " + text(answer, "message"));
    if (type != wanted) fail("answered " + asked + " with type " + excerpt(type) + ", must be '" + wanted + "'");
    if (answer.contains("warning")) {
      const std::string warning = text(answer, "warning");
      if (std::find(warnings_.begin(), warnings_.end(), warning) == warnings_.end()) warnings_.push_back(warning);
    }
    return answer;
  }

  std::string text(const json& answer, const char* key) const {
    if (!answer.contains(key) || !answer[key].is_string()) fail("sent no `" + std::string(key) + "`, must be a text");
    return answer[key].get<std::string>();
  }
  /// A number >= 0; `otherwise` if the key is missing.
  double number(const json& answer, const char* key, double otherwise) const {
    if (!answer.contains(key)) return otherwise;
    const json& value = answer[key];
    if (!value.is_number() || value.get<double>() < 0.0)
      fail("answered `" + std::string(key) + "` = " + excerpt(value.dump()) + ", must be a number >= 0");
    return value.get<double>();
  }

  const std::vector<std::string>& warnings() const { return warnings_; }

 private:
  /// Reports a process that closed its pipe.
  [[noreturn]] void fail_ended(const std::string& asked) {
    const auto end = process_->wait_until(seconds_from_now(1.0));
    if (!end) fail("closed its pipe before it answered " + asked);
    fail(end->text() + " before it answered " + asked);
  }

  void send(const std::string& asked, const std::string& line, MonotonicTime deadline) {
    if (!process_->unread().empty()) fail("sent more than its answer: " + excerpt(process_->unread()));
    const auto outcome = process_->write(line, deadline);
    if (outcome == ChildProcess::Outcome::late)
      fail("did not read " + asked + " within " + seconds_text(timeout_s_) + " (environment.timeout_s)");
    if (outcome == ChildProcess::Outcome::ended) fail_ended(asked);
  }
  std::string receive(const std::string& asked, MonotonicTime deadline) {
    std::string line;
    const auto outcome = process_->read_line(line, deadline, longest_line_);
    if (outcome == ChildProcess::Outcome::too_long)
      fail("answered " + asked + " with a line of more than " + std::to_string(longest_line_) + " bytes");
    if (outcome == ChildProcess::Outcome::late)
      fail("did not answer " + asked + " within " + seconds_text(timeout_s_) + " (environment.timeout_s)");
    if (outcome == ChildProcess::Outcome::ended) fail_ended(asked);
    return line;
  }
  json parsed(const std::string& asked, const std::string& line) const {
    bool finite = true;
    try {
      return parse_json<json>(line);
    } catch (const json::out_of_range&) {  // 1e999
      finite = false;
    } catch (const json::exception&) {  // NaN and Infinity are not JSON, but many programs write them
      finite = line.find("NaN") == std::string::npos && line.find("Infinity") == std::string::npos;
    }
    if (!finite) fail("answered " + asked + " with a number that is not finite");
    fail("answered " + asked + " with " + excerpt(line) + ", must be one line of JSON");
  }

  std::string name_;
  double timeout_s_;
  std::size_t longest_line_;
  std::optional<ChildProcess> process_;
  std::vector<std::string> warnings_;
};

ProcessEnvironment::ProcessEnvironment(const ProcessOptions& options, const Task& task)
    : options_(options),
      vertices_(task.garment->vertex_count()),
      opens_early_(task.manipulation.opens_at.size() > 0),
      link_(std::make_unique<Link>(options, vertices_)) {
  const json answer = link_->ask(greeting(task), "hello");
  if (link_->text(answer, "protocol") != kProtocol)
    link_->fail("speaks another protocol, " + excerpt(link_->text(answer, "protocol")));
  const int version = protocol_version(task);
  if (!answer.contains("version") || answer["version"] != version)
    link_->fail("speaks version " + excerpt(answer.value("version", json()).dump()) +
                " of the protocol, this weft speaks version " + std::to_string(version) +
                (opens_early_ ? " where hands open one by one (manipulation.opens_at)" : ""));
}
ProcessEnvironment::~ProcessEnvironment() = default;

std::vector<std::string> ProcessEnvironment::warnings() const { return link_->warnings(); }

Observation ProcessEnvironment::observe() {
  const json answer = link_->ask({{"type", "observe"}}, "observation");
  if (!answer.contains("positions_m") || !answer["positions_m"].is_array())
    link_->fail("sent an observation without positions_m, must be a list with one entry per vertex");
  const json& positions = answer["positions_m"];
  if (positions.size() != static_cast<std::size_t>(vertices_))
    link_->fail("observed " + std::to_string(positions.size()) + " vertices, must be " + std::to_string(vertices_));
  Observation seen;
  seen.positions.resize(vertices_, 3);
  seen.sigma = link_->number(answer, "sigma_m", options_.sigma);
  seen.height_sigma = link_->number(answer, "height_sigma_m", options_.height_sigma);
  std::vector<bool> observed(positions.size());
  for (Index v = 0; v < vertices_; ++v) {
    const json& point = positions[v];
    observed[v] = !point.is_null();
    if (point.is_null()) {
      seen.positions.row(v).setConstant(std::numeric_limits<double>::quiet_NaN());
      continue;
    }
    const bool is_point = point.is_array() && point.size() == 3 &&
                          std::all_of(point.begin(), point.end(), [](const json& x) { return x.is_number(); });
    if (!is_point)
      link_->fail("observed vertex " + std::to_string(v) + " at " + excerpt(point.dump()) +
                  ", must be [x, y, z] in m, or null if it is not seen");
    for (Index c = 0; c < 3; ++c) seen.positions(v, c) = point[c].get<double>();
  }
  const auto count = std::count(observed.begin(), observed.end(), true);
  if (count == 0) link_->fail("observed no vertex, must observe at least one");
  if (count < vertices_) seen.observed = std::move(observed);  // empty: all are seen
  return seen;
}

void ProcessEnvironment::execute(const SegmentPath& path) {
  auto targets = json::array();
  for (const auto& points : path.targets) targets.push_back(rows_of(points));
  json request{{"type", "execute"}, {"targets_m", targets}};
  if (opens_early_) request["opening"] = path.opening;
  link_->ask(request, "executed");
}

SettleResult ProcessEnvironment::release() {
  const json answer = link_->ask({{"type", "release"}}, "released");
  if (!answer.contains("settled") || !answer["settled"].is_boolean())
    link_->fail("answered release without `settled`, must be true or false");
  SettleResult result;
  result.settled = answer["settled"].get<bool>();
  result.frames = std::lround(std::min(link_->number(answer, "settle_s", 0.0), 1e6) / kFrameSeconds);
  return result;
}

}  // namespace weft
