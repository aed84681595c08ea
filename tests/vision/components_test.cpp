#include "src/vision/components.h"

#include <gtest/gtest.h>

#include <array>
#include <opencv2/imgproc.hpp>
#include <set>

#include "src/core/random.h"

namespace turntable {
namespace {

TEST(Components, AgreeWithOpenCvOnRandomImages) {
  Random random(1, "Components.AgreeWithOpenCvOnRandomImages");
  for (int trial = 0; trial < 200; ++trial) {
    const int width = 1 + static_cast<int>(random.uniform(0, 150)),
              height = 1 + static_cast<int>(random.uniform(0, 40));
    const double share = random.uniform(0.02, 0.7);
    Image image({width, height}, 0);
    for (auto& p : image.pixels) p = random.uniform() < share ? 200 : 10;
    const bool bright = trial % 2 == 0;
    const auto components = find_components(image, 100.0, bright);

    cv::Mat binary(height, width, CV_8U, image.pixels.data()), labels, stats, centroids;
    cv::threshold(binary.clone(), binary, 100, 255,
                  bright ? cv::THRESH_BINARY : cv::THRESH_BINARY_INV);
    const int count = cv::connectedComponentsWithStats(binary, labels, stats, centroids, 8);
    ASSERT_EQ(components.size(), static_cast<std::size_t>(count - 1));
    std::multiset<std::array<int, 5>> ours, theirs;
    for (const Component& c : components)
      ours.insert({c.box.left, c.box.top, c.box.width(), c.box.height(), c.area_px});
    for (int i = 1; i < count; ++i)
      theirs.insert({stats.at<int>(i, 0), stats.at<int>(i, 1), stats.at<int>(i, 2),
                     stats.at<int>(i, 3), stats.at<int>(i, 4)});
    EXPECT_EQ(ours, theirs);
  }
}

TEST(Components, OfHostileImagesEndInTimeAndWithoutSpots) {
  EXPECT_TRUE(find_components(Image(), 10, true).empty());
  EXPECT_TRUE(find_components(Image({100, 100}, 0), 0.0, true).empty());
  EXPECT_TRUE(find_components(Image({100, 100}, 255), 255.0, true).empty());
  EXPECT_EQ(find_components(Image({1, 1}, 255), 100.0, true).size(), 1u);
  Image checker({1000, 1000}, 0);
  for (int v = 0; v < 1000; v += 2)
    for (int u = 0; u < 1000; u += 2) checker.row(v)[u] = 255;
  EXPECT_LE(find_components(checker, 100.0, true).size(), 20000u);
}

TEST(Threshold, FollowsTheImagesOwnRange) {
  EXPECT_DOUBLE_EQ(choose_threshold({10, 210}, true), 70.0);
  EXPECT_DOUBLE_EQ(choose_threshold({10, 110}, true), 50.0);
  EXPECT_DOUBLE_EQ(choose_threshold({10, 50}, true), 30.0);
  EXPECT_DOUBLE_EQ(choose_threshold({10, 210}, false), 150.0);
}

}  // namespace
}  // namespace turntable
