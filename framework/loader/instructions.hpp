#pragma once
#include <filesystem>
#include <string>

namespace weft {

/// The instructions that a plugin library was compiled for and this processor has not: "AVX2, FMA". Reads the note that
/// WEFT_PLUGIN leaves in the file, and executes nothing of it. Empty: none are missing, or the file has no such note.
std::string missing_instructions(const std::filesystem::path& library);

}  // namespace weft
