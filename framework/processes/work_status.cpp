#include "processes/work_status.hpp"

#include <algorithm>
#include <array>
#include <exception>
#include <new>
#include <system_error>

#include "sdk/machine_failure.hpp"
#include "sdk/wrong_result.hpp"
#include "weft/error.hpp"

namespace weft {
namespace {

constexpr std::array kNames = {"done", "refused", "diverged", "crashed", "hung", "lost"};

}  // namespace

const char* to_string(WorkStatus status) { return kNames.at(static_cast<std::size_t>(status)); }

WorkStatus work_status_named(const std::string& name) {
  if (name == "failed") return WorkStatus::refused;
  const auto* found = std::find(kNames.begin(), kNames.end(), name);
  if (found == kNames.end()) throw ConfigError("'" + name + "' is not a status of a cell");
  return static_cast<WorkStatus>(found - kNames.begin());
}

WorkFailure current_failure() {
  const auto failure = [](WorkStatus status, std::string message) {
    if (message.empty()) message = "failed without a message";
    return WorkFailure{status, std::move(message)};
  };
  try {
    throw;
  } catch (const Diverged& error) {
    return failure(WorkStatus::diverged, error.what());
  } catch (const NotFinite& error) {
    return failure(WorkStatus::diverged, error.what());
  } catch (const std::bad_alloc&) {
    return failure(WorkStatus::lost, "there was not enough memory");
  } catch (const OutOfMemory& error) {
    return failure(WorkStatus::lost, error.what());
  } catch (const ReadError& error) {
    return failure(WorkStatus::lost, error.what());
  } catch (const std::system_error& error) {  // no thread, no file, no pipe: what the machine refused
    return failure(WorkStatus::lost, error.what());
  } catch (const std::exception& error) {
    return failure(WorkStatus::refused, error.what());
  } catch (...) {
    return failure(WorkStatus::refused, "threw something that is not a std::exception");
  }
}

bool tries_again(Retry retry, WorkStatus status) {
  switch (status) {
    case WorkStatus::done:
      return false;
    case WorkStatus::refused:
    case WorkStatus::diverged:
      return retry == Retry::all;
    case WorkStatus::crashed:
    case WorkStatus::hung:
    case WorkStatus::lost:
      return retry != Retry::none;
  }
  return false;
}

std::string failures_text(const std::vector<WorkStatus>& statuses) {
  std::string text;
  for (std::size_t i = 1; i < kNames.size(); ++i) {
    const auto count = std::count(statuses.begin(), statuses.end(), static_cast<WorkStatus>(i));
    if (count > 0) text += (text.empty() ? "" : ", ") + std::to_string(count) + " " + kNames.at(i);
  }
  return text;
}

}  // namespace weft
