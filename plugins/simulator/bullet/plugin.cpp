#include "weft/plugin.hpp"
#include "bullet.hpp"

WEFT_PLUGIN(weft::Simulator, weft::bullet::Bullet, weft::bullet::Params, "bullet", "1.0.0")
