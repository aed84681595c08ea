#include "src/report/calibration_report.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>

#include "src/evaluation/calibrate.h"
#include "tests/support/draws.h"
#include "tests/support/simulated_view.h"
#include "tests/support/temporary_folder.h"

namespace turntable {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

/// Three planes and six tilted views through the simulated lens, true pixels with a little noise.
CalibrationSet simulated_set(Random random) {
  SimulatedView view(shipped_rig("simulated"));
  const PatternConfig& pattern = view.rig().pattern;
  CalibrationSet set;
  set.name = "set";
  set.source = "simulated points";
  set.simulated = true;
  set.size = view.rig().camera.image_size;
  set.spacing_mm = pattern.spacing_mm;
  set.order = 5;
  const auto look = [&](double stage, double roll, double pitch) {
    view.stand(stage, 0, roll, pitch);
    std::vector<PlanePoint> points;
    for (int row = 0; row < pattern.rows; ++row)
      for (int column = 0; column < pattern.columns; ++column) {
        const int c = column - pattern.origin_column, r = row - pattern.origin_row;
        const Vector2d at(c * pattern.spacing_mm, r * pattern.spacing_mm);
        const Vector2d px =
            view.pixel_of({at.x(), at.y(), 0}) + 0.01 * Vector2d(random.normal(), random.normal());
        if (px.minCoeff() > 10 && px.x() < set.size.width - 10 && px.y() < set.size.height - 10)
          points.push_back({px, at, stage, c, r, 0.01});
      }
    return points;
  };
  const auto as_view = [](const std::vector<PlanePoint>& points, bool at_zero, double z) {
    PatternView v;
    v.at_zero = at_zero;
    v.z_mm = z;
    for (const PlanePoint& p : points) {
      v.pixels_px.push_back(p.pixel_px);
      v.on_pattern_mm.push_back(p.on_plane_mm);
    }
    return v;
  };
  for (const double z : {0.0, 130.0, 180.0}) {
    const auto points = look(z, 0, 0);
    set.planes.push_back({z, z > 0, points});
    set.views.push_back(as_view(points, true, z));
    set.stage.push_back({z, z, z > 0 ? 1 : 2, z > 0 ? 0.0 : 0.0007, Vector2d(0.01, -0.02)});
  }
  for (const auto& [roll, pitch] : {std::pair{25.0, 0.0},
                                    {-25.0, 10.0},
                                    {0.0, 25.0},
                                    {0.0, -25.0},
                                    {15.0, 20.0},
                                    {-15.0, -20.0}})
    set.views.push_back(as_view(look(80, roll, pitch), false, 0));
  view.stand(0, 0, 0, 0);
  set.example = PatternExample{"base.png", view.look(Payload::kCirclePattern), {}};
  for (const PlanePoint& p : set.planes[0].points)
    set.example->points.push_back({p.column, p.row, p.on_plane_mm, p.pixel_px, 0.01, {}});
  set.images = {{"base.png", std::string(64, 'a')}};
  set.remarks = {"one thing that was left out."};
  return set;
}

TEST(CalibrationReport, SaysInNumbersAndPicturesHowGoodTheCameraIs) {
  const CalibrationSet set = simulated_set(draws_of_this_test());
  const Calibration calibration = calibrate(set);
  const TemporaryFolder folder;
  EXPECT_EQ(write_calibration_report(folder.path(), calibration, set).extension(), ".html");
  const std::string text = slurp(folder / "calibration.md");
  for (const char* words :
       {"**Simulated.**", "Left out one at a time", "chi-square", "| used |",
        "The residuals choose order 5, which was used", "| irt |", "| fisheye |", "0.00070",
        "(0.0100, -0.0200)", "one thing that was left out", "base.png", "calibrated area"})
    EXPECT_THAT(text, HasSubstr(words));
  for (const char* figure :
       {"figure8_pattern", "figure9_positions", "figure10_residuals_0mm",
        "figure10_residuals_130mm", "calibration_vectors_180mm", "calibration_coverage",
        "calibration_orders", "calibration_uncertainty", "calibration_bundle"}) {
    const std::string csv = slurp(folder / "figures" / (std::string(figure) + ".csv"));
    EXPECT_GT(std::ranges::count(csv, '\n'), 8) << figure;
    const std::string svg = slurp(folder / "figures" / (std::string(figure) + ".svg"));
    EXPECT_GT(svg.size(), 10'000u) << figure;  // an empty frame has about 8000
    EXPECT_THAT(text, HasSubstr(std::string("figures/") + figure + ".svg"));
  }
  EXPECT_EQ(parse_calibration(slurp(folder / "calibration.json"), "c").irt.order(), 5);
  EXPECT_THAT(slurp(folder / "opencv/brown.yml"), HasSubstr("camera_matrix"));
  EXPECT_THAT(slurp(folder / "tables/table1.tex"), HasSubstr("tabular"));
  EXPECT_THAT(slurp(folder / "tables/orders.csv"), HasSubstr("left_out_rms_mm"));
  EXPECT_THAT(slurp(folder / "tables/models.csv"), HasSubstr("rational"));
}

TEST(CalibrationReport, OfACameraThatCameAsNumbersHasNoFiguresOfPoints) {
  const Calibration calibration =
      load_calibration(fs::path(TURNTABLE_SOURCE_DIR) / "scenarios/calibrations/paper_table1.json");
  const TemporaryFolder folder;
  write_calibration_report(folder.path(), calibration, {});
  const std::string text = slurp(folder / "calibration.md");
  EXPECT_THAT(text, HasSubstr("calibration_bundle.svg"));
  EXPECT_FALSE(fs::exists(folder / "figures/figure9_positions.csv"));
}

}  // namespace
}  // namespace turntable
