// Files with damaged bytes, which libhdf5 reads in a child process: its crashes are not weft's (docs/trust.md).
#include <algorithm>
#include <cstdlib>
#include <fstream>
#include <iterator>
#include <sstream>
#include <utility>

#include "fuzz.hpp"
#include "processes/child_process.hpp"

namespace weft::fuzz {
namespace {

namespace fs = std::filesystem;

struct Kind {
  const char* name;
  void (*make)(const fs::path&);
};
constexpr Kind kKinds[] = {{"session", make_session}, {"dataset", make_dataset}, {"model", make_model}};

std::string bytes_of(const fs::path& file) {
  std::ifstream stream(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), {}};
}

/// Opens files of other processes: this program's neighbour (replay.cpp). What is too large to allocate is null to libhdf5, as
/// without a sanitizer; operator new, which weft's own code uses, ends the process all the same.
/// @param names whether its reports name functions; to find them takes a second.
std::unique_ptr<ChildProcess> start_reader(bool names) {
  ChildOptions options;
  options.command = {(fs::read_symlink("/proc/self/exe").parent_path() / "weft_fuzz_inputs").string(), "--serve"};
  options.environment = {
      {"ASAN_OPTIONS",
       "detect_leaks=0:max_allocation_size_mb=256:allocator_may_return_null=1:handle_abort=1:malloc_context_size=2:"
       "quarantine_size_mb=16:allocator_release_to_os_interval_ms=-1:symbolize=" +
           std::to_string(static_cast<int>(names))}};
  options.own_group = true;
  options.keep_errors = true;
  return std::make_unique<ChildProcess>(options);
}

struct Reading {
  std::string ill;       ///< how its process ended; empty: the file was read or refused
  std::string report;    ///< of the sanitizer
  bool is_over = false;  ///< the reader does not open any more files
};

Reading read_with(ChildProcess& reader, const std::string& kind, const fs::path& file) {
  constexpr double kMostCpu = 20.0, kMostIdle = 300.0, kLook = 1.0;  // s; an input takes a millisecond
  Reading reading;
  std::string answer;
  reader.write(kind + " " + file.string() + "\n", seconds_from_now(kMostIdle));
  auto outcome = reader.read_line(answer, seconds_from_now(kLook));
  if (outcome == ChildProcess::Outcome::late) {
    HangWatch watch(kMostCpu, kMostIdle);
    watch.start(reader.cpu_seconds());
    while (outcome == ChildProcess::Outcome::late && reading.ill.empty()) {
      outcome = reader.read_line(answer, seconds_from_now(kLook));
      if (outcome == ChildProcess::Outcome::late) reading.ill = watch.check(reader.cpu_seconds());
    }
  }
  if (outcome == ChildProcess::Outcome::done && !answer.starts_with(kDied)) return reading;
  if (outcome == ChildProcess::Outcome::done) {
    reading.ill = answer;
  } else {
    reading.is_over = true;
    if (!reading.ill.empty()) reader.kill(6);
    const auto end = reader.wait_until(seconds_from_now(10));
    if (reading.ill.empty()) reading.ill = end ? end->text() : "does not end";
  }
  reading.report = reader.errors();
  std::string& report = reading.report;
  if (!reading.is_over) report.resize(std::min(report.size(), report.rfind(kReportEnds)));
  if (const auto before = report.rfind(kReportEnds); before != std::string::npos)
    report.erase(0, before + kReportEnds.size());
  return reading;
}

/// Whether a sanitizer's report begins in libhdf5. @param names whether functions have names in it. Without, the first frame
/// decides: another one in the program of weft may be the sanitizer's own malloc().
bool begins_in_libhdf5(const std::string& report, bool names) {
  std::istringstream lines(report);
  for (std::string line; std::getline(lines, line);) {
    if (line.find("    #") == std::string::npos) continue;
    if (line.find("libhdf5") != std::string::npos) return true;
    if (!names || line.find("weft::") != std::string::npos) return false;
  }
  return false;
}

/// Notes a crash of libhdf5 for whoever counts them.
void note(const std::string& text) {
  if (const char* file = std::getenv("WEFT_FUZZ_LIBHDF5")) std::ofstream(file, std::ios::app) << text << "\n";
}

}  // namespace

/// The first byte chooses a valid file, and the others damage it in places of four bytes: place, place, how, value.
/// Or they are the file.
void damaged(std::string_view bytes) {
  static std::string valid[std::size(kKinds)];
  if (valid[0].empty()) {
    for (std::size_t k = 0; k < std::size(kKinds); ++k) {
      kKinds[k].make(world().file("valid.h5"));
      valid[k] = bytes_of(world().file("valid.h5"));
    }
  }
  const unsigned choice = bytes.empty() ? 0 : static_cast<unsigned char>(bytes[0]);
  const std::size_t kind = choice % std::size(kKinds);
  if (!bytes.empty()) bytes.remove_prefix(1);
  std::string content(bytes);
  if (choice < 250) {
    content = valid[kind];
    for (; bytes.size() >= 4; bytes.remove_prefix(4)) {
      const auto byte = [&](int i) { return static_cast<unsigned char>(bytes[static_cast<std::size_t>(i)]); };
      const std::size_t at = static_cast<std::size_t>(byte(0) * 256 + byte(1)) % content.size();
      switch (byte(2) % 4) {
        case 0:
          content[at] = static_cast<char>(byte(3));
          break;
        case 1:
          content[at] = static_cast<char>(content[at] ^ (1 << byte(3) % 8));
          break;
        case 2:
          content.replace(at, 4, 4, static_cast<char>(byte(3)));
          break;
        default:
          content[at] = static_cast<char>(content[at] + byte(3));
      }
    }
    if (bytes.size() == 1) content.resize(content.size() * static_cast<unsigned char>(bytes[0]) / 256);
  }
  static std::unique_ptr<ChildProcess> reader;
  if (!reader) reader = start_reader(false);
  const fs::path file = world().write(kind == 1 ? "shard-00000.h5" : "damaged.h5", content);
  Reading reading = read_with(*reader, kKinds[kind].name, file);
  if (reading.is_over) reader.reset();
  if (reading.ill.empty()) return;
  bool is_of_libhdf5 = begins_in_libhdf5(reading.report, false);
  if (!is_of_libhdf5) {
    Reading named = read_with(*start_reader(true), kKinds[kind].name, file);
    if (!named.ill.empty()) reading = std::move(named);
    is_of_libhdf5 = begins_in_libhdf5(reading.report, true);
  }
  const std::string what = std::string(kKinds[kind].name) + " " + reading.ill + "\n" + reading.report;
  if (!is_of_libhdf5) finding("opening a damaged " + what);
  note("== " + what);
}

}  // namespace weft::fuzz
