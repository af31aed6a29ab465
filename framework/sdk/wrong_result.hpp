#pragma once
#include "weft/error.hpp"
#include "weft/export.hpp"

namespace weft {

/// A plugin returned something that no plugin may return. The message names it.
class WEFT_API WrongResult : public Error {
 public:
  using Error::Error;
  ~WrongResult() override;
};

/// It returned a number that is not finite. Of a cell or an example that is a numerical failure, like Diverged; but nobody
/// who skips what diverges skips this, since the plugin should have said so itself.
class WEFT_API NotFinite : public WrongResult {
 public:
  using WrongResult::WrongResult;
  ~NotFinite() override;
};

}  // namespace weft
