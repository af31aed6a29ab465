#pragma once

namespace weft::app {

/// The commit that weft was built from, with "+changes" if its sources differed.
const char* commit();

}  // namespace weft::app
