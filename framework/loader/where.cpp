#include "loader/where.hpp"

#include <array>

namespace weft {
namespace {

/// Appends to a fixed buffer without the C library's locale or allocator.
class Line {
 public:
  Line(char* buffer, std::size_t size) : buffer_(buffer), size_(size) {
    if (size_ > 0) buffer_[0] = 0;
  }
  void add(const char* text) {
    while (*text != 0 && length_ + 1 < size_) buffer_[length_++] = *text++;
    if (size_ > 0) buffer_[length_] = 0;
  }
  void item(const char* text) {
    if (length_ > 0) add(", ");
    add(text);
  }
  void number(std::int64_t value) {
    std::array<char, 24> digits{};
    std::size_t at = digits.size() - 1;
    do {
      digits[--at] = static_cast<char>('0' + value % 10);
      value /= 10;
    } while (value > 0);
    add(" ");
    add(&digits[at]);
  }
  std::size_t length() const { return length_; }

 private:
  char* buffer_;
  std::size_t size_;
  std::size_t length_ = 0;
};

}  // namespace

std::size_t write_entries(char* buffer, std::size_t size, bool with_call) noexcept {
  Line line(buffer, size);
  bool has_callee = false;  // only the innermost call is named; it is the one that is running
  for (const Where* at = Where::head_; at != nullptr; at = at->outer_) {
    if (at->kind_ == Where::Kind::step) {
      line.item(at->name_);
      if (at->number_ >= 0) line.number(at->number_);
    } else if (!has_callee) {
      has_callee = true;
      line.item(at->name_);
      if (with_call && at->call_ != nullptr) line.item(at->call_);
    }
  }
  return line.length();
}

std::size_t write_where(char* buffer, std::size_t size) noexcept { return write_entries(buffer, size, true); }

std::string where_text() {
  std::array<char, 512> buffer;
  const std::string text(buffer.data(), write_entries(buffer.data(), buffer.size(), false));
  if (text.find(", ") != std::string::npos) return text;
  return {buffer.data(), write_where(buffer.data(), buffer.size())};  // no step: the call says when it was
}

}  // namespace weft
