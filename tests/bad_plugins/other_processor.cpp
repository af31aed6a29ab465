// Says that it was compiled for instructions that no processor has. Loading it would end the program.
#include <cstdlib>

#include "bad_plugins/bad_plugin.hpp"

namespace {

[[gnu::section(".note.weft"), gnu::used]] alignas(4) const weft::WeftInstructionsNote note{.instructions = weft::kAvx2 |
                                                                                                           1u << 31};
[[gnu::constructor]] void runs_what_the_processor_lacks() { std::abort(); }

}  // namespace

EXPORT_INFO(GOOD_INFO("other_processor"))
EXPORT_FUNCTIONS(weft::test::Toy, weft::test::NoParams)
