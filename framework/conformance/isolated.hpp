#pragma once
#include <string>
#include <vector>

#include "conformance/conformance.hpp"
#include "weft/error.hpp"

namespace weft {

/// CPU time that a law may use, and time that it may spend without using any, s.
constexpr double kLawLimitSeconds = 60.0;

/// Checks a law in a child process, so that a crash, a call of exit() or an endless loop costs this law alone. The
/// child's limit is tenfold with the address, thread or memory sanitizer.
/// @param command of the child, which writes answer_of() as one line and ends; "--law" and the law's name are appended.
/// @param law as from planned_laws(). @param limit_s see kLawLimitSeconds.
/// @return the outcome. If the child did not answer, the law failed and `detail` says what the plugin did, and where.
/// @throws ConfigError or PluginError, as the child did.
LawResult check_in_child(std::vector<std::string> command, LawResult law, double limit_s);

/// What the child writes: the outcome of its law.
std::string answer_of(const LawResult& law);
/// What the child writes if the user's input is wrong.
std::string answer_of(const ConfigError& error);
std::string answer_of(const PluginError& error);

}  // namespace weft
