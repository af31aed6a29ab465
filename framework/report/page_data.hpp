#pragma once
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "weft/types.hpp"

namespace weft {

/// The data of a page: a JSON text and arrays. The JSON refers to an array by {array, type, shape, step}. An array is
/// stored by the significance of bytes (all lowest bytes, then all second bytes, ...), deflated, in base64. In int16
/// and int32 arrays every row after the first is the difference to the row before, modulo 2^16 or 2^32.
class PageData {
 public:
  /// Finest step of quantised positions, m. A step of 0.05 mm is far below what a page can show, and compresses well.
  static constexpr double kStep = 5e-5;

  nlohmann::ordered_json json = {{"schema", "weft report 1"}};

  /// Stores [rows.size(), V, 3] as int16 multiples of `finest`, or of a larger step if coordinates are large.
  /// @return the reference to the array for `json`, as the functions below.
  nlohmann::ordered_json shapes(const std::vector<Positions>& rows, double finest = kStep);
  nlohmann::ordered_json faces(const Faces& faces);       ///< [F, 3], int32
  nlohmann::ordered_json matrix(const Controls& matrix);  ///< float32

  /// The template with the data in its place. @throws ConfigError if the text is not a template of weft.
  std::string fill(const std::string& page_template) const;

 private:
  template <class Word>
  nlohmann::ordered_json store(const char* type, const std::vector<Index>& shape, const std::vector<Word>& values,
                               double step);
  std::vector<std::string> arrays_;
};

}  // namespace weft
