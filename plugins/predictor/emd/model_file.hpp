#pragma once
#include <filesystem>

#include "model.hpp"

namespace weft::emd {

/// Writes the whole model; the file is complete or absent.
/// @param half_precision store weights and basis as 16-bit floats.
void save_model(const std::filesystem::path& file, const Model& model, bool half_precision);

/// Reads a model of this or an earlier schema. Checks every size, number and range and the checksum. Runs no code from
/// the file. @throws ConfigError with the file and the reason.
Model load_model(const std::filesystem::path& file);

/// Rounds to the nearest 16-bit float, which is what a file in half precision holds.
float round_to_half(float value);
/// Whether storing the model in half precision changes nothing.
bool fits_half(const Model& model);

}  // namespace weft::emd
