#pragma once
#include <filesystem>
#include <string>
#include <vector>

#include "weft/garment.hpp"
#include "weft/hdf5_file.hpp"

namespace weft {

/// Creates cases.h5, the shapes of an experiment's cases for the page (docs/report.md), and writes the garment to it.
/// The caller adds the shapes and commits the file.
Hdf5File create_cases_file(const std::filesystem::path& file, const Garment& garment);
/// Writes shapes of equal size as [n, V, 3] in single precision.
void write_shapes(Hdf5File& file, const std::string& path, const std::vector<Positions>& shapes);

}  // namespace weft
