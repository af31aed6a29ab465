#pragma once
#include <string>

#include "weft/export.hpp"
#include "weft/garment.hpp"
#include "weft/hdf5_file.hpp"

namespace weft {

/// Writes /garment/frames [F, 2, 2], /garment/layers [V] and /garment/seams [S, 2], each only if the form has it.
WEFT_API void write_garment_form(Hdf5File& file, const GarmentForm& form);
/// Reads them. @param name of the file, for messages. @throws ConfigError for wrong shapes, vertices and numbers.
WEFT_API GarmentForm read_garment_form(const Hdf5File& file, const std::string& name, Index vertices);

}  // namespace weft
