#pragma once
#include <filesystem>
#include <string>
#include <vector>

#include "weft/garment.hpp"
#include "weft/hdf5_file.hpp"

namespace weft {

/// cases.h5: shapes of an experiment's cases for the page (docs/report.md), with its garment in it. Not committed yet.
Hdf5File create_cases_file(const std::filesystem::path& file, const Garment& garment);
/// All of one size, as [n, V, 3] in single precision.
void write_shapes(Hdf5File& file, const std::string& path, const std::vector<Positions>& shapes);

}  // namespace weft
