#include "src/vision/board.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <opencv2/calib3d.hpp>

#include "src/record/image_import.h"
#include "tests/support/drawn_plane.h"
#include "tests/support/draws.h"
#include "tests/support/real_data.h"

namespace turntable {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector2d;
using Eigen::Vector3d;

/// Plane (mm, y up) in front of a camera of 640 x 480 px, turned in its plane and tilted.
Matrix3d view_of_plane(double turn_deg, double tilt_deg, double px_per_mm) {
  const double deg = std::numbers::pi / 180.0;
  Matrix3d R = (Eigen::AngleAxisd(tilt_deg * deg, Vector3d(0.6, 0.8, 0)) *
                Eigen::AngleAxisd(turn_deg * deg, Vector3d::UnitZ()) *
                Eigen::AngleAxisd(std::numbers::pi, Vector3d::UnitX()))  // y up, v down
                   .toRotationMatrix();
  Matrix3d K;
  K << 800, 0, 320, 0, 800, 240, 0, 0, 1;
  Matrix3d P;
  P << R.col(0), R.col(1), Vector3d(0, 0, 800 / px_per_mm);
  return K * P;
}

double worst_error(const PatternSearch& search, const Matrix3d& H, double* in_sigmas = nullptr) {
  double worst = search.points.empty() ? INFINITY : 0.0, scaled = 0.0;
  for (const PatternPoint& p : search.points) {
    const Vector2d miss = p.centre_px - (H * p.on_pattern_mm.homogeneous()).hnormalized();
    worst = std::max(worst, miss.norm());
    scaled += miss.squaredNorm() / (p.sigma_px * p.sigma_px);
  }
  if (in_sigmas) *in_sigmas = std::sqrt(scaled / (2.0 * static_cast<double>(search.points.size())));
  return worst;
}

PatternConfig config(PatternKind kind, int columns, int rows) {
  PatternConfig p;
  p.kind = kind;
  p.columns = columns;
  p.rows = rows;
  p.origin_column = 2;
  p.origin_row = 2;
  p.spacing_mm = 10;
  p.radius_mm = kind == PatternKind::kChessboard ? 0 : 4;
  return p;
}

TEST(AsymmetricCircles, AreIndexedWhateverTheirTurn) {
  const PatternConfig pattern = config(PatternKind::kAsymmetricCircles, 4, 11);
  const auto grey = [](const Vector2d& p) {  // mm from the origin circle, lattice (2, 2)
    const int column = static_cast<int>(std::lround(p.x() / 10)) + 2,
              row = static_cast<int>(std::lround(p.y() / 10)) + 2;
    const bool circle = row >= 0 && row < 11 && column >= 0 && column < 8 && column % 2 == row % 2;
    const Vector2d at(10.0 * (column - 2), 10.0 * (row - 2));
    return circle && (p - at).norm() < 4 ? 200.0 : 30.0;
  };
  PatternConfig bright = pattern;
  for (const double turn : {0.0, 70.0, 180.0, 250.0}) {
    const Matrix3d H = view_of_plane(turn, 20, 2.4);
    const Image image = draw_plane({640, 480}, H, grey, 1.0, draws_of_this_test());
    const PatternSearch search = find_pattern(image, bright);
    ASSERT_EQ(search.status, PatternStatus::kFound) << turn;
    EXPECT_EQ(search.points.size(), 44u);
    EXPECT_FALSE(search.half_turn_ambiguous);
    EXPECT_LT(worst_error(search, H), 0.1) << turn;
  }
}

TEST(Chessboard, IsIndexedByItsColoursWhateverItsTurn) {
  PatternConfig pattern = config(PatternKind::kChessboard, 8, 7);
  const auto grey = [](const Vector2d& p) {
    const int i = static_cast<int>(std::floor(p.x() / 10)) + 2,
              j = static_cast<int>(std::floor(p.y() / 10)) +
                  2;  // square right of column, above row
    if (i < -1 || i > 7 || j < -1 || j > 6) return 220.0;
    return (i + j) % 2 == 0 ? 30.0 : 220.0;  // dark between the first four corners
  };
  // No edge along the pixels, where the drawing's five steps per pixel show.
  for (const double turn : {13.0, 60.0, 193.0, 260.0}) {
    const Matrix3d H = view_of_plane(turn, 20, 3.5);
    const Image image = draw_plane({640, 480}, H, grey, 3.0, draws_of_this_test());
    const PatternSearch search = find_pattern(image, pattern);
    ASSERT_EQ(search.status, PatternStatus::kFound) << turn;
    EXPECT_EQ(search.points.size(), 56u);
    EXPECT_FALSE(search.half_turn_ambiguous);
    double in_sigmas = 0;
    EXPECT_LT(worst_error(search, H, &in_sigmas), 0.2) << turn;
    EXPECT_GT(in_sigmas, 0.3);  // of the right size, no more is claimed
    EXPECT_LT(in_sigmas, 2.0);
  }
  EXPECT_EQ(find_pattern(Image({200, 200}, 90), pattern).status, PatternStatus::kNoContrast);
}

/// rms reprojection error of cv::calibrateCamera, px.
double calibrated_rms(const std::vector<std::vector<cv::Point3f>>& on_pattern,
                      const std::vector<std::vector<cv::Point2f>>& px) {
  cv::Mat K, distortion;
  std::vector<cv::Mat> r, t;
  return cv::calibrateCamera(on_pattern, px, {640, 480}, K, distortion, r, t);
}

TEST(CircleGrid, OfSixPhotographsIsFoundAndNoWorseThanOpenCvs) {
  const auto real = real_data();
  if (!real || !std::filesystem::is_directory(*real / "circles_boofcv"))
    GTEST_SKIP() << "NOT TESTED ON REAL IMAGES: no folder circles_boofcv in TURNTABLE_REAL or "
                    "../shared/real beside the source tree.";
  PatternConfig pattern = config(PatternKind::kCircleGrid, 10, 8);
  pattern.origin_column = pattern.origin_row = 0;
  pattern.spacing_mm = 25;
  pattern.radius_mm = 7.5;
  pattern.bright = false;
  std::vector<std::vector<cv::Point3f>> ours_mm, common_mm, theirs_mm;
  std::vector<std::vector<cv::Point2f>> ours_px, common_px, theirs_px;
  for (int i = 0; i < 6; ++i) {
    const Image image =
        import_image(*real / "circles_boofcv" / ("image0000" + std::to_string(i) + ".jpg"));
    const PatternSearch search = find_pattern(image, pattern);
    EXPECT_EQ(search.status, PatternStatus::kFound) << i << pattern_status_name(search.status);
    EXPECT_EQ(search.points.size(), 80u);
    EXPECT_TRUE(search.half_turn_ambiguous);
    EXPECT_FALSE(search.quarter_turn_ambiguous);
    ours_mm.emplace_back();
    ours_px.emplace_back();
    for (const PatternPoint& p : search.points) {
      ours_mm.back().emplace_back(static_cast<float>(p.on_pattern_mm.x()),
                                  static_cast<float>(p.on_pattern_mm.y()), 0.0f);
      ours_px.back().emplace_back(static_cast<float>(p.centre_px.x()),
                                  static_cast<float>(p.centre_px.y()));
    }
    std::vector<cv::Point2f> centres;
    const cv::Mat mat(image.height, image.width, CV_8U,
                      const_cast<std::uint8_t*>(image.pixels.data()));
    if (!cv::findCirclesGrid(mat, {10, 8}, centres)) continue;
    common_mm.push_back(ours_mm.back());
    common_px.push_back(ours_px.back());
    theirs_px.push_back(centres);
    theirs_mm.emplace_back();
    for (int k = 0; k < 80; ++k)
      theirs_mm.back().emplace_back(25.0f * static_cast<float>(k % 10),
                                    25.0f * static_cast<float>(k / 10), 0.0f);
  }
  if (HasFailure()) return;
  ASSERT_GE(theirs_px.size(), 3u);
  const double ours = calibrated_rms(common_mm, common_px),
               theirs = calibrated_rms(theirs_mm, theirs_px);
  std::printf(
      "reprojection rms: ours %.4f px, OpenCV's %.4f px in the %zu images where it finds the "
      "grid; ours %.4f px in all six\n",
      ours, theirs, theirs_px.size(), calibrated_rms(ours_mm, ours_px));
  EXPECT_LE(ours, theirs);
}

}  // namespace
}  // namespace turntable
