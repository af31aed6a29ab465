#pragma once
#include <stdexcept>
#include <string>

#include "weft/export.hpp"

namespace weft {

/// Base of every error that weft throws. Exported, so that `catch` works across plugins.
/// A message names the location, the key or argument, its value and what is allowed.
class WEFT_API Error : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
  ~Error() override;
};

/// An array of the wrong size, or an index out of range.
class WEFT_API ShapeError : public Error {
 public:
  using Error::Error;
  ~ShapeError() override;
};

/// A wrong key, type, range, unit or file in the user's input. The program exits with 2.
class WEFT_API ConfigError : public Error {
 public:
  using Error::Error;
  ~ConfigError() override;
};

/// A plugin that cannot be found, loaded or created.
class WEFT_API PluginError : public Error {
 public:
  using Error::Error;
  ~PluginError() override;
};

/// An optional ability that the component did not declare in its capabilities.
class WEFT_API Unsupported : public Error {
 public:
  using Error::Error;
  ~Unsupported() override;
};

/// A numerical failure that ends a run: non-finite state, with the frame it appeared in.
class WEFT_API Diverged : public Error {
 public:
  using Error::Error;
  ~Diverged() override;
};

/// @throws ShapeError "<what> = <got>, must be <wanted>" unless got == wanted.
WEFT_API void require_shape(const std::string& what, std::ptrdiff_t got, std::ptrdiff_t wanted);

}  // namespace weft
