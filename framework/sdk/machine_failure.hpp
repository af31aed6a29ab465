#pragma once
#include "weft/error.hpp"
#include "weft/export.hpp"

// Failures of the machine. They say nothing about the work, which may be done again when the machine is mended.
namespace weft {

/// A result that cannot be written.
class WEFT_API WriteError : public Error {
 public:
  using Error::Error;
  ~WriteError() override;
};

/// A file that is there, but cannot be read now: locked, without permission, too many open files, a failing disk, a pointer
/// of Git LFS in its place.
class WEFT_API ReadError : public ConfigError {
 public:
  using ConfigError::ConfigError;
  ~ReadError() override;
};

/// There was not enough memory.
class WEFT_API OutOfMemory : public Error {
 public:
  using Error::Error;
  ~OutOfMemory() override;
};

}  // namespace weft
