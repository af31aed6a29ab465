#include "report/cases_file.hpp"

namespace weft {

Hdf5File create_cases_file(const std::filesystem::path& path, const Garment& garment) {
  auto file = Hdf5File::create(path);
  file.write("/garment/name", garment.name);
  file.write("/garment/rest", garment.rest);
  const Eigen::Matrix<std::int64_t, Eigen::Dynamic, 3, Eigen::RowMajor> faces = garment.faces.cast<std::int64_t>();
  file.write("/garment/faces", faces);
  return file;
}

void write_shapes(Hdf5File& file, const std::string& path, const std::vector<Positions>& shapes) {
  const Index vertices = shapes.empty() ? 0 : shapes.front().rows();
  std::vector<float> values;
  for (const auto& shape : shapes) {
    for (Index i = 0; i < shape.size(); ++i) values.push_back(static_cast<float>(shape.data()[i]));
  }
  file.write(path, {static_cast<Index>(shapes.size()), vertices, 3}, values.data());
}

}  // namespace weft
