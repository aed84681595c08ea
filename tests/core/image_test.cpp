#include "src/core/image.h"

#include <gmock/gmock.h>

#include <array>

namespace turntable {
namespace {

using ::testing::ElementsAre;

TEST(ToGrey, KeepsGreyAndSkipsWhatFillsTheRows) {
  const std::array<std::uint8_t, 8> rows{1, 2, 3, 99, 4, 5, 255, 99};
  EXPECT_THAT(to_grey({rows.data(), {3, 2}, 4, 1, 8}).pixels, ElementsAre(1, 2, 3, 4, 5, 255));
}

TEST(ToGrey, WeighsBlueGreenAndRedAndIgnoresOpacity) {
  const std::array<std::uint8_t, 12> primaries{255, 0, 0, 0, 255, 0, 0, 0, 255, 255, 255, 255};
  EXPECT_THAT(to_grey({primaries.data(), {4, 1}, 12, 3, 8}).pixels, ElementsAre(29, 150, 76, 255));
  const std::array<std::uint8_t, 8> opaque{255, 0, 0, 7, 255, 255, 255, 0};
  EXPECT_THAT(to_grey({opaque.data(), {2, 1}, 8, 4, 8}).pixels, ElementsAre(29, 255));
}

TEST(ToGrey, GivesBackGreyThatWasWrittenAsColour) {
  for (int grey = 0; grey < 256; ++grey) {
    const auto g = static_cast<std::uint8_t>(grey);
    const std::array<std::uint8_t, 3> pixel{g, g, g};
    EXPECT_THAT(to_grey({pixel.data(), {1, 1}, 3, 3, 8}).pixels, ElementsAre(g));
  }
}

TEST(ToGrey, KeepsTheUpperEightOfSixteenBits) {
  const std::array<std::uint16_t, 3> deep{0x00ff, 0x12ff, 0xffff};
  EXPECT_THAT(to_grey({deep.data(), {3, 1}, 6, 1, 16}).pixels, ElementsAre(0, 0x12, 0xff));
  EXPECT_THAT(to_grey({deep.data(), {1, 1}, 6, 3, 16}).pixels, ElementsAre(0x57));
}

}  // namespace
}  // namespace turntable
