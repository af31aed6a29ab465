// Successive halving of the instances of a search.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "session/halving.hpp"

namespace weft {
namespace {

using testing::ElementsAre;

std::vector<Index> wanted(const Halving& halving, Index instances) {
  std::vector<Index> list;
  for (Index i = 0; i < instances; ++i)
    if (halving.wants(i)) list.push_back(i);
  return list;
}

TEST(Halving, TheWorseHalfEndsAfterHalvesOfTheIterations) {
  Halving halving(5, 80, 3);
  Vector costs(5);
  costs << 3, 1, 5, 4, 2;
  halving.look(9, costs);
  EXPECT_THAT(wanted(halving, 5), ElementsAre(0, 1, 2, 3, 4));
  halving.look(10, costs);
  EXPECT_THAT(wanted(halving, 5), ElementsAre(0, 1, 4)) << "of five the better three";
  halving.look(11, costs);
  costs << 1, 3, 0, 0, 2;  // those that have ended do not come back
  halving.look(20, costs);
  EXPECT_THAT(wanted(halving, 5), ElementsAre(0, 4));
  halving.look(79, costs);
  EXPECT_THAT(wanted(halving, 5), ElementsAre(0));
}

TEST(Halving, EqualCostsKeepTheFirst) {
  Halving halving(4, 2, 1);
  halving.look(1, Vector::Constant(4, std::numeric_limits<double>::infinity()));
  EXPECT_THAT(wanted(halving, 4), ElementsAre(0, 1));
}

TEST(Halving, OneInstanceAndFewIterationsStay) {
  Halving one(1, 80, 30);
  for (Index i = 0; i < 80; ++i) one.look(i, Vector::Zero(1));
  EXPECT_TRUE(one.wants(0));
  Halving none(4, 1, 3);  // there is no half of one iteration
  none.look(0, Vector::Zero(4));
  none.look(1, Vector::Zero(4));
  EXPECT_EQ(wanted(none, 4).size(), 4);
  Halving off(4, 80, 0);
  off.look(79, Vector::Zero(4));
  EXPECT_EQ(wanted(off, 4).size(), 4);
}

}  // namespace
}  // namespace weft
