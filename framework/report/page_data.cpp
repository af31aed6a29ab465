#include "report/page_data.hpp"

#include <zlib.h>

#include <algorithm>
#include <cmath>
#include <cstring>

#include "weft/error.hpp"

namespace weft {
namespace {

using nlohmann::ordered_json;

// The mark in the template for the data. apps/report/build.mjs writes the same mark.
constexpr const char* kPlaceholder = "<!--weft-data-->";

std::string base64(const std::string& bytes) {
  static constexpr char kDigits[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string text;
  text.reserve((bytes.size() + 2) / 3 * 4);
  for (std::size_t i = 0; i < bytes.size(); i += 3) {
    std::uint32_t word = 0;
    const std::size_t count = std::min<std::size_t>(3, bytes.size() - i);
    for (std::size_t k = 0; k < 3; ++k) word = word << 8 | (k < count ? static_cast<unsigned char>(bytes[i + k]) : 0u);
    for (std::size_t k = 0; k < 4; ++k) text += k <= count ? kDigits[word >> (18 - 6 * k) & 63] : '=';
  }
  return text;
}

template <class Word>
void append_difference(std::vector<Word>& values, const std::vector<Word>& now, const std::vector<Word>& before) {
  for (std::size_t i = 0; i < now.size(); ++i)
    values.push_back(static_cast<Word>(now[i] - (before.empty() ? 0 : before[i])));
}

}  // namespace

template <class Word>
ordered_json PageData::store(const char* type, const std::vector<Index>& shape, const std::vector<Word>& values,
                             double step) {
  std::string planes;
  planes.reserve(values.size() * sizeof(Word));
  for (std::size_t byte = 0; byte < sizeof(Word); ++byte) {
    for (const Word value : values) planes += static_cast<char>(value >> (8 * byte) & 0xff);
  }
  uLongf size = compressBound(planes.size());
  std::string packed(size, '\0');
  if (compress2(reinterpret_cast<Bytef*>(packed.data()), &size, reinterpret_cast<const Bytef*>(planes.data()),
                planes.size(), 9) != Z_OK) {
    throw Error("report: an array cannot be compressed");
  }
  packed.resize(size);
  arrays_.push_back(base64(packed));
  return {{"array", arrays_.size() - 1}, {"type", type}, {"shape", shape}, {"step", step}};
}

ordered_json PageData::shapes(const std::vector<Positions>& rows, double finest) {
  double largest = 0.0;
  for (const auto& row : rows) largest = std::max(largest, row.size() > 0 ? row.cwiseAbs().maxCoeff() : 0.0);
  const double step = std::max(finest, largest / 32767.0);
  std::vector<std::uint16_t> values, before;
  for (const auto& row : rows) {
    std::vector<std::uint16_t> now(row.size());
    for (std::size_t i = 0; i < now.size(); ++i) {
      now[i] = static_cast<std::uint16_t>(static_cast<std::int16_t>(std::lround(row.data()[i] / step)));
    }
    append_difference(values, now, before);
    before = std::move(now);
  }
  const Index vertices = rows.empty() ? 0 : rows.front().rows();
  return store("i16", {static_cast<Index>(rows.size()), vertices, 3}, values, step);
}

ordered_json PageData::faces(const Faces& faces) {
  std::vector<std::uint32_t> values, before;
  for (Index f = 0; f < faces.rows(); ++f) {
    std::vector<std::uint32_t> now(faces.row(f).begin(), faces.row(f).end());
    append_difference(values, now, before);
    before = std::move(now);
  }
  return store("i32", {faces.rows(), 3}, values, 1.0);
}

ordered_json PageData::matrix(const Controls& matrix) {
  std::vector<std::uint32_t> values(matrix.size());
  const Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> single = matrix.cast<float>();
  if (!values.empty()) std::memcpy(values.data(), single.data(), values.size() * sizeof(float));
  return store("f32", {matrix.rows(), matrix.cols()}, values, 1.0);
}

std::string PageData::fill(const std::string& page_template) const {
  const auto place = page_template.find(kPlaceholder);
  if (place == std::string::npos)
    throw ConfigError("report template: has no place for data; it is not a template of weft");
  std::string text = json.dump(-1, ' ', false, ordered_json::error_handler_t::replace);
  for (std::size_t at = 0; (at = text.find('<', at)) != std::string::npos;) text.replace(at, 1, "\\u003c");
  std::string data = "<script type=\"application/json\" id=\"weft-data\">" + text + "</script>\n";
  for (std::size_t i = 0; i < arrays_.size(); ++i) {
    data += "<script type=\"text/plain\" id=\"weft-array-" + std::to_string(i) + "\">" + arrays_[i] + "</script>\n";
  }
  std::string page = page_template;
  return page.replace(place, std::strlen(kPlaceholder), data);
}

}  // namespace weft
