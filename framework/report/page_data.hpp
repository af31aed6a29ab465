#pragma once
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "weft/types.hpp"

namespace weft {

/// The data of a page: a JSON text, and arrays that it names by {array, type, shape, step}. An array is stored as its
/// elements' bytes by significance (all lowest bytes, then all second bytes, ...), deflated, in base64. Rows of int16
/// and int32 arrays after the first are differences to the row before, modulo 2^16 or 2^32.
class PageData {
 public:
  /// Finest step of quantised positions, m. A step of 0.05 mm is far below what a page can show, and compresses well.
  static constexpr double kStep = 5e-5;

  nlohmann::ordered_json json = {{"schema", "weft report 1"}};

  /// [rows.size(), V, 3], as int16 multiples of `finest` or, where coordinates are large, of more.
  /// @return what stands for the array in `json`; so do the others.
  nlohmann::ordered_json shapes(const std::vector<Positions>& rows, double finest = kStep);
  nlohmann::ordered_json faces(const Faces& faces);       ///< [F, 3], int32
  nlohmann::ordered_json matrix(const Controls& matrix);  ///< float32

  /// The template with the data in its place. @throws ConfigError for a template that is none.
  std::string fill(const std::string& page_template) const;

 private:
  template <class Word>
  nlohmann::ordered_json store(const char* type, const std::vector<Index>& shape, const std::vector<Word>& values,
                               double step);
  std::vector<std::string> arrays_;
};

}  // namespace weft
