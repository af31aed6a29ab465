#include "learning/example_bytes.hpp"

#include <algorithm>
#include <cstring>
#include <type_traits>

#include "weft/error.hpp"

namespace weft {
namespace {

constexpr std::uint64_t kMark = 0x7765667465783031;  // "weftex01"

/// Writes values one after the other; read() of the other class takes them in the same order.
class Writer {
 public:
  template <class Value>
  void add(const Value& value) {
    static_assert(std::is_trivially_copyable_v<Value>);
    add(&value, 1);
  }
  template <class Value>
  void add(const Value* values, std::size_t count) {
    const auto* bytes = reinterpret_cast<const unsigned char*>(values);
    const std::size_t at = hex_.size(), size = count * sizeof(Value);
    hex_.resize(at + 2 * size);
    char* hex = hex_.data() + at;
    for (std::size_t i = 0; i < size; ++i) {
      constexpr const char* kDigits = "0123456789abcdef";
      hex[2 * i] = kDigits[bytes[i] >> 4];
      hex[2 * i + 1] = kDigits[bytes[i] & 15];
    }
  }
  void add(const Controls& matrix) {
    add(matrix.rows());
    add(matrix.cols());
    add(matrix.data(), static_cast<std::size_t>(matrix.size()));
  }
  std::string take() { return std::move(hex_); }

 private:
  std::string hex_;
};

class Reader {
 public:
  explicit Reader(std::string_view hex) : hex_(hex) {}
  template <class Value>
  void read(Value& value) {
    read(&value, 1);
  }
  template <class Value>
  void read(Value* values, std::size_t count) {
    require(count, sizeof(Value));
    auto* bytes = reinterpret_cast<unsigned char*>(values);
    const char* hex = hex_.data() + at_;
    const std::size_t size = count * sizeof(Value);
    unsigned seen = 0;
    for (std::size_t i = 0; i < size; ++i) {
      const unsigned high = digit(hex[2 * i]), low = digit(hex[2 * i + 1]);
      seen |= high | low;
      bytes[i] = static_cast<unsigned char>(high << 4 | low);
    }
    if (seen > 15) fail();
    at_ += 2 * size;
  }
  void read(Controls& matrix) {
    Index rows = 0, columns = 0;
    read(rows);
    read(columns);
    if (rows < 0 || columns < 0 || (columns > 0 && rows > static_cast<Index>(hex_.size()) / columns)) fail();
    require(static_cast<std::size_t>(rows * columns), sizeof(double));
    matrix.resize(rows, columns);
    read(matrix.data(), static_cast<std::size_t>(matrix.size()));
  }
  /// The number of values that follow. @param size of one.
  std::size_t count(std::size_t size) {
    std::uint64_t number = 0;
    read(number);
    require(number, size);
    return number;
  }
  void end() const {
    if (at_ != hex_.size()) fail();
  }

 private:
  [[noreturn]] static void fail() { throw ConfigError("is no example of this version of weft"); }
  void require(std::size_t count, std::size_t size) const {
    if (count > (hex_.size() - at_) / (2 * size)) fail();
  }
  /// Without branches, so that a loop over digits becomes vectors. Above 15: it is no digit.
  static unsigned digit(char c) {
    const unsigned decimal = static_cast<unsigned char>(c) - unsigned{'0'};
    const unsigned letter = static_cast<unsigned char>(c) - unsigned{'a'};
    const unsigned value = letter < 6 ? letter + 10 : 16;
    return decimal < 10 ? decimal : value;
  }
  std::string_view hex_;
  std::size_t at_ = 0;
};

}  // namespace

std::string no_example_line(const WorkFailure& failure) {
  std::string line = std::string(kNoExample) + to_string(failure.status) + ": " + failure.message;
  std::replace(line.begin(), line.end(), '\n', ' ');
  return line;
}

WorkFailure read_no_example(std::string_view line) {
  line.remove_prefix(kNoExample.size());
  const auto colon = std::min(line.find(": "), line.size());
  const WorkStatus status = work_status_named(std::string(line.substr(0, colon)));
  return {status, std::string(line.substr(std::min(colon + 2, line.size())))};
}

std::string example_to_hex(const Example& e) {
  Writer out;
  out.add(kMark);
  out.add(e.index);
  out.add(e.q.data(), 4);
  out.add(e.controls);
  out.add(e.states);
  out.add(e.targets);
  out.add(std::uint64_t{e.shapes.size()});
  out.add(e.shapes.data(), e.shapes.size());
  out.add(static_cast<char>(e.released));
  out.add(e.settle.frames);
  out.add(e.settle.max_speed);
  out.add(static_cast<char>(e.settle.settled));
  out.add(e.max_grasp_strain);
  out.add(std::uint64_t{e.failure.size()});
  out.add(e.failure.data(), e.failure.size());
  return out.take();
}

Example example_from_hex(std::string_view hex) {
  Reader in(hex);
  Example e;
  std::uint64_t mark = 0;
  char flag = 0;
  in.read(mark);
  in.read(e.index);
  in.read(e.q.data(), 4);
  in.read(e.controls);
  in.read(e.states);
  in.read(e.targets);
  e.shapes.resize(in.count(sizeof(float)));
  in.read(e.shapes.data(), e.shapes.size());
  in.read(flag);
  e.released = flag != 0;
  in.read(e.settle.frames);
  in.read(e.settle.max_speed);
  in.read(flag);
  e.settle.settled = flag != 0;
  in.read(e.max_grasp_strain);
  e.failure.resize(in.count(1));
  in.read(e.failure.data(), e.failure.size());
  in.end();
  if (mark != kMark) throw ConfigError("is no example of this version of weft");
  return e;
}

}  // namespace weft
