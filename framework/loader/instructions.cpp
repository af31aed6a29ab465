#include "loader/instructions.hpp"

#include <elf.h>

#include <cstring>
#include <fstream>
#include <vector>

#include "weft/plugin.hpp"

namespace weft {
namespace {

constexpr std::size_t kMostHeaders = 1000, kLongestNotes = 1 << 16;

struct Instruction {
  unsigned bit;
  const char* name;
  bool is_here;
};

std::vector<Instruction> known_instructions() {
#if defined(__x86_64__)
#define WEFT_INSTRUCTION_(name) static_cast<bool>(__builtin_cpu_supports(name))
#else
#define WEFT_INSTRUCTION_(name) false
#endif
  return {{kAvx, "AVX", WEFT_INSTRUCTION_("avx")},
          {kAvx2, "AVX2", WEFT_INSTRUCTION_("avx2")},
          {kFma, "FMA", WEFT_INSTRUCTION_("fma")},
          {kBmi2, "BMI2", WEFT_INSTRUCTION_("bmi2")},
          {kAvx512f, "AVX-512F", WEFT_INSTRUCTION_("avx512f")},
          {kAvx512bw, "AVX-512BW", WEFT_INSTRUCTION_("avx512bw")},
          {kAvx512dq, "AVX-512DQ", WEFT_INSTRUCTION_("avx512dq")},
          {kAvx512vl, "AVX-512VL", WEFT_INSTRUCTION_("avx512vl")}};
}

/// The bits of the note among the notes of a segment; 0 if it is not there.
unsigned instructions_in(const std::vector<char>& notes) {
  const auto aligned = [](std::size_t size) { return (size + 3) & ~std::size_t{3}; };
  for (std::size_t at = 0; at + sizeof(Elf64_Nhdr) <= notes.size();) {
    Elf64_Nhdr head;
    std::memcpy(&head, notes.data() + at, sizeof(head));
    const std::size_t name = at + sizeof(head), description = name + aligned(head.n_namesz);
    at = description + aligned(head.n_descsz);
    if (at > notes.size()) return 0;
    if (head.n_namesz != sizeof(WeftInstructionsNote::name) || head.n_descsz != sizeof(unsigned)) continue;
    if (std::memcmp(notes.data() + name, kInstructionsNoteName, head.n_namesz) != 0) continue;
    unsigned bits = 0;
    std::memcpy(&bits, notes.data() + description, sizeof(bits));
    return bits;
  }
  return 0;
}

/// The bits of the note in a file; 0 if it is no ELF file of this machine, or has no such note.
unsigned instructions_of(const std::filesystem::path& library) {
  std::ifstream stream(library, std::ios::binary);
  Elf64_Ehdr head;
  if (!stream.read(reinterpret_cast<char*>(&head), sizeof(head))) return 0;
  if (std::memcmp(head.e_ident, ELFMAG, SELFMAG) != 0 || head.e_ident[EI_CLASS] != ELFCLASS64) return 0;
  if (head.e_phentsize != sizeof(Elf64_Phdr) || head.e_phnum > kMostHeaders) return 0;
  std::vector<Elf64_Phdr> segments(head.e_phnum);
  stream.seekg(static_cast<std::streamoff>(head.e_phoff));
  if (!stream.read(reinterpret_cast<char*>(segments.data()),
                   static_cast<std::streamsize>(segments.size() * sizeof(Elf64_Phdr))))
    return 0;
  for (const auto& segment : segments) {
    if (segment.p_type != PT_NOTE || segment.p_filesz > kLongestNotes) continue;
    std::vector<char> notes(segment.p_filesz);
    stream.clear();
    stream.seekg(static_cast<std::streamoff>(segment.p_offset));
    if (!stream.read(notes.data(), static_cast<std::streamsize>(notes.size()))) continue;
    if (const unsigned bits = instructions_in(notes); bits != 0) return bits;
  }
  return 0;
}

}  // namespace

std::string missing_instructions(const std::filesystem::path& library) {
  unsigned bits = instructions_of(library);
  std::string missing;
  const auto add = [&](const std::string& name) { missing += (missing.empty() ? "" : ", ") + name; };
  for (const auto& one : known_instructions()) {
    if ((bits & one.bit) != 0 && !one.is_here) add(one.name);
    bits &= ~one.bit;
  }
  if (bits != 0) add("some that this weft does not know");
  return missing;
}

}  // namespace weft
