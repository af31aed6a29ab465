#include "weft/plugin.hpp"
#include "cloth.hpp"

WEFT_PLUGIN(weft::Simulator, weft::cloth::Cloth, weft::cloth::Params, "cloth", "1.3.0")
