#pragma once
#include <vector>

#include "element_block.hpp"

namespace weft::cloth {

/// What the internal forces come from (see Elements).
struct ForceArguments {
  const std::vector<ElementBlock>& blocks;
  double unit, damping_stretch_s, damping_bend_s;
  const Fixed4* x;
  const Float4* v;
  Float4* forces;  ///< added to
};

/// Adds the internal forces, eight elements at a time. @return the largest squared principal stretch, at least 1.
float add_forces_narrow(const ForceArguments& arguments);
/// The same bits, sixteen at a time (AVX-512). Only where has_wide_lanes().
float add_forces_wide(const ForceArguments& arguments);
bool has_wide_lanes();

}  // namespace weft::cloth
