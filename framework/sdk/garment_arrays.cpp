#include "sdk/garment_arrays.hpp"

#include <cmath>

#include "weft/error.hpp"

namespace weft {

void write_garment_form(Hdf5File& file, const GarmentForm& form) {
  if (form.frames.rows() > 0) file.write("/garment/frames", {form.frames.rows(), 2, 2}, form.frames.data());
  if (!form.layers.empty()) file.write("/garment/layers", {static_cast<Index>(form.layers.size())}, form.layers.data());
  if (form.seams.rows() > 0) {
    const Eigen::Matrix<std::int64_t, Eigen::Dynamic, 2, Eigen::RowMajor> seams = form.seams.cast<std::int64_t>();
    file.write("/garment/seams", {seams.rows(), 2}, seams.data());
  }
}

GarmentForm read_garment_form(const Hdf5File& file, const std::string& name, Index vertices) {
  const auto fail = [&](const std::string& message) { throw ConfigError(name + ": " + message); };
  const auto require_finite = [&](const std::vector<double>& values, const std::string& path) {
    for (const double value : values)
      if (!std::isfinite(value)) fail(path + " holds a number that is not finite");
  };
  GarmentForm form;
  if (file.has("/garment/frames")) {
    const auto shape = file.shape("/garment/frames");
    if (shape.size() != 3 || shape[1] != 2 || shape[2] != 2) fail("/garment/frames must have the shape [faces, 2, 2]");
    const auto values = file.read("/garment/frames");
    require_finite(values, "/garment/frames");
    form.frames = Eigen::Map<const RestFrames>(values.data(), shape[0], 4);
  }
  if (file.has("/garment/layers")) {
    form.layers = file.read("/garment/layers");
    require_finite(form.layers, "/garment/layers");
    if (static_cast<Index>(form.layers.size()) != vertices) {
      fail("/garment/layers has " + std::to_string(form.layers.size()) + " numbers, must have one for each of " +
           std::to_string(vertices) + " vertices");
    }
  }
  if (file.has("/garment/seams")) {
    const auto shape = file.shape("/garment/seams");
    if (shape.size() != 2 || shape[1] != 2) fail("/garment/seams must have the shape [n, 2]");
    const auto ends = file.read_int("/garment/seams");
    form.seams.resize(shape[0], 2);
    for (std::size_t i = 0; i < ends.size(); ++i) {
      if (ends[i] < 0 || ends[i] >= vertices) fail("/garment/seams names vertex " + std::to_string(ends[i]));
      form.seams.data()[i] = static_cast<int>(ends[i]);
    }
  }
  return form;
}

}  // namespace weft
