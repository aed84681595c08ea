#include "drivers/genicam_frame.h"

#include <gtest/gtest.h>

#include <limits>

namespace turntable {
namespace {

TEST(FrameIds, CountOverTheWrapOf16BitsWhichSkipsZero) {
  FrameIds ids;
  EXPECT_EQ(ids.advance(65534), 1u);
  EXPECT_EQ(ids.advance(65535), 1u);
  EXPECT_EQ(ids.current(), 65535u);
  EXPECT_EQ(ids.advance(1), 1u);
  EXPECT_EQ(ids.current(), 65536u);
  EXPECT_EQ(ids.advance(4), 3u);
  EXPECT_EQ(ids.current(), 65539u);
}

TEST(FrameIds, CountGapsThatLieOnTheWrap) {
  FrameIds ids;
  ids.advance(65533);
  EXPECT_EQ(ids.advance(2), 4u);  // 65534, 65535 and 1 are missing
}

TEST(FrameIds, TakeACameraThatCountsZero) {
  FrameIds ids;
  ids.advance(65535);
  EXPECT_EQ(ids.advance(0), 1u);
  EXPECT_EQ(ids.advance(1), 1u);
  EXPECT_EQ(ids.current(), 65537u);
}

TEST(FrameIds, GoOnBeyond16BitsIfTheCameraDoes) {
  FrameIds ids;
  EXPECT_EQ(ids.advance(0), 1u);
  EXPECT_EQ(ids.advance(1), 1u);
  FrameIds extended;
  extended.advance(65535);
  EXPECT_EQ(extended.advance(65536), 1u);
  EXPECT_EQ(extended.advance(65540), 4u);
  EXPECT_EQ(extended.current(), 65540u);
  EXPECT_EQ(extended.advance(std::numeric_limits<std::uint64_t>::max() - 1),
            std::numeric_limits<std::uint64_t>::max() - 1 - 65540);
}

TEST(FrameIds, RefuseWhatDoesNotComeAfter) {
  FrameIds ids;
  ids.advance(100);
  EXPECT_EQ(ids.advance(100), std::nullopt);
  EXPECT_EQ(ids.advance(99), std::nullopt);
  EXPECT_EQ(ids.advance(101), 1u);
  FrameIds extended;
  extended.advance(70000);
  EXPECT_EQ(extended.advance(69999), std::nullopt);
  EXPECT_EQ(extended.advance(1), std::nullopt);
}

TEST(FrameIds, NeverGoBackOverManyWraps) {
  FrameIds ids;
  std::uint64_t raw = 65000;
  ids.advance(raw);
  const std::uint64_t first = ids.current();
  for (std::uint64_t k = 1; k < 300000; ++k) {
    raw = raw == 65535 ? 1 : raw + 1;
    ASSERT_EQ(ids.advance(raw), 1u);
    ASSERT_EQ(ids.current(), first + k);
  }
}

TEST(Top8Bits, AreTheUpperOnesOfTheSignificantBits) {
  const std::uint8_t words[] = {0xff, 0x03, 0x80, 0x01, 0x00, 0x00,   // first row, and
                                0xee, 0xee,                           // two bytes of padding
                                0x04, 0x00, 0x03, 0x00, 0xff, 0x0f};  // 0x0fff has 12 bits
  const Image ten = top_8_bits(words, {3, 2}, 8, 10);
  EXPECT_EQ(ten.pixels, (std::vector<std::uint8_t>{255, 0x60, 0, 1, 0, 255}));
  const Image twelve = top_8_bits(words, {3, 2}, 8, 12);
  EXPECT_EQ(twelve.pixels, (std::vector<std::uint8_t>{0x3f, 0x18, 0, 0, 0, 255}));
  const Image sixteen = top_8_bits(words, {3, 2}, 8, 16);
  EXPECT_EQ(sixteen.pixels, (std::vector<std::uint8_t>{3, 1, 0, 0, 0, 0x0f}));
}

TEST(Top8Bits, OfMono8AreTheImage) {
  const std::uint8_t grey[] = {1, 2, 3, 9, 4, 5, 6, 9};
  EXPECT_EQ(top_8_bits(grey, {3, 2}, 4, 8).pixels, (std::vector<std::uint8_t>{1, 2, 3, 4, 5, 6}));
}

}  // namespace
}  // namespace turntable
