#include "src/imaging/camera_models.h"

#include <gtest/gtest.h>

#include "src/core/units.h"
#include "tests/support/draws.h"
#include "tests/support/simulated_view.h"

namespace turntable {
namespace {

/// What a sweep of the simulated rig yields, with true pixels and noise: planes at 130 and 180 mm to
/// fit, the base plane to judge, tilted views. The lens is a physical one, none of the models.
CameraData sweep(double noise_px) {
  SimulatedView rig(shipped_rig("simulated"));
  rig.world().mount(Payload::kCirclePattern);
  Random random = draws_of_this_test();
  CameraData data;
  data.planes = {130, 180};
  data.size = rig.rig().camera.image_size;
  const auto look = [&](double stage, double yaw, double roll, double pitch) {
    rig.stand(stage, yaw, roll, pitch);
    PatternView view;
    view.at_zero = yaw == 0 && roll == 0 && pitch == 0;
    view.z_mm = view.at_zero ? stage : 0.0;
    for (int row = -7; row <= 7; ++row)
      for (int column = -9; column <= 9; ++column) {
        const Vector2d at = Vector2d(column, row) * 20.0;
        const Vector2d pixel = rig.pixel_of({at.x(), at.y(), 0});
        if (pixel.minCoeff() < 10 || pixel.maxCoeff() > data.size.width - 11) continue;
        view.on_pattern_mm.push_back(at);
        view.pixels_px.emplace_back(pixel + noise_px * Vector2d(random.normal(), random.normal()));
        PlanePoint p;
        p.pixel_px = view.pixels_px.back();
        p.on_plane_mm = at;
        p.z_mm = stage;
        p.column = column;
        p.row = row;
        if (view.at_zero) (stage == 0 ? data.held_out : data.fit).push_back(p);
      }
    data.views.push_back(view);
  };
  for (const double stage : {0.0, 130.0, 180.0}) look(stage, 0, 0, 0);
  for (const double tilt : {-20.0, 20.0}) {
    look(120, 0, 0, tilt);
    look(120, 0, tilt, 0);
    look(150, 30, tilt, 0.5 * tilt);
  }
  return data;
}

ModelRow row_of(const std::vector<ModelRow>& rows, std::string_view name) {
  for (const ModelRow& row : rows)
    if (row.name == name) return row;
  ADD_FAILURE() << "no row " << name;
  return {};
}

TEST(CameraModels, TheTableHasEveryModelOnce) {
  ASSERT_EQ(kCameraModels.size(), 5u);
  EXPECT_EQ(kCameraModels[0].name, "irt");
  for (std::size_t i = 0; i < std::size(kCentralKinds); ++i)
    EXPECT_EQ(kCameraModels[i + 1].name, central_name(kCentralKinds[i]));
  EXPECT_EQ(find_camera_model("brown"), &kCameraModels[2]);
  EXPECT_EQ(find_camera_model("thick"), nullptr);
}

TEST(CameraModels, OnAPhysicalLensThoseWithDistortionLeaveThePinholeFarBehind) {
  const CameraData data = sweep(0.005);
  const std::vector<ModelRow> rows = compare_models(data);
  ASSERT_EQ(rows.size(), kCameraModels.size());
  for (const ModelRow& row : rows) ASSERT_EQ(row.why_not, "") << row.name;
  const ModelRow pinhole = row_of(rows, "pinhole");
  EXPECT_GT(pinhole.held_out_rms_mm, 0.05);
  for (const char* name : {"irt", "brown", "rational", "fisheye"}) {
    const ModelRow row = row_of(rows, name);
    EXPECT_LT(row.held_out_rms_mm, 0.2 * pinhole.held_out_rms_mm) << name;
    EXPECT_LT(row.held_out_rms_px, 0.2 * pinhole.held_out_rms_px) << name;
    EXPECT_LE(row.held_out_rms_mm, row.held_out_max_mm) << name;
  }
  // The base plane is 700 mm away at 1945 px: 0.36 mm to the pixel.
  EXPECT_NEAR(pinhole.held_out_rms_mm / pinhole.held_out_rms_px, 0.36, 0.02);
  EXPECT_EQ(row_of(rows, "irt").parameters, 84);
  EXPECT_EQ(row_of(rows, "brown").parameters, 17);  // four, five of distortion, pose, lean
}

TEST(CameraModels, NeverSeeAPointThatJudgesWhicheverImageShowsIt) {
  CameraData data = sweep(0.005), without = data;
  // Points are means over several images; no view has just their pixels.
  PatternView again = data.views[0];
  for (Vector2d& px : again.pixels_px) px += Vector2d(0.3, -0.2);
  data.views.insert(data.views.begin() + 1, again);
  // A point that only one image shows is in no mean: the remnant of a view counts as none.
  data.views[0].pixels_px.emplace_back(500.0, 500.0);
  data.views[0].on_pattern_mm.emplace_back(1234.0, 5678.0);
  without.views.erase(without.views.begin());
  const ModelRow all = row_of(compare_models(data), "brown");
  const ModelRow none = row_of(compare_models(without), "brown");
  EXPECT_EQ(all.why_not, "");
  EXPECT_EQ(all.held_out_rms_mm, none.held_out_rms_mm);
}

TEST(CameraModels, TheLeanOfTheStageIsFoundAndNotTakenForAnAttitude) {
  const CameraData data = sweep(0.005);
  const Vector2d truth = shipped_rig("simulated").simulation->stage_squareness_deg;
  const CentralModel m = fit_central(CentralKind::kBrown, data.views, data.size);
  // What the brown model leaves out of the lens comes back here: a tenth of 0.02 deg.
  EXPECT_LT((m.lean * kDegPerRad - truth).norm(), 0.003);
  EXPECT_GT(truth.norm(), 0.02);
}

TEST(CameraModels, PointsHeldOutDoNotEnterThroughTheViews) {
  CameraData data = sweep(0.0);
  const std::vector<ModelRow> before = compare_models(data);
  // Spoil the judging plane: had any model seen it, its fit would change.
  for (PlanePoint& p : data.held_out) p.pixel_px.x() += 5.0;
  for (PatternView& view : data.views)
    if (view.at_zero && view.z_mm == 0.0)
      for (Vector2d& pixel : view.pixels_px) pixel.x() += 5.0;
  const std::vector<ModelRow> after = compare_models(data);
  for (std::size_t i = 0; i < after.size(); ++i) {
    EXPECT_EQ(after[i].fit_rms_mm, before[i].fit_rms_mm) << after[i].name;
    EXPECT_NEAR(after[i].held_out_rms_px, 5.0, 1.5) << after[i].name;
  }
}

TEST(CameraModels, AModelThatTheDataDoNotCarrySaysWhy) {
  CameraData data = sweep(0.005);
  std::erase_if(data.views, &PatternView::at_zero);
  const std::vector<ModelRow> rows = compare_models(data);
  EXPECT_EQ(rows[0].why_not, "");
  EXPECT_GT(rows[0].held_out_rms_mm, 0.0);
  for (std::size_t i = 1; i < rows.size(); ++i) {
    EXPECT_NE(rows[i].why_not.find("zero table angles"), std::string::npos);
    EXPECT_TRUE(std::isnan(rows[i].held_out_rms_mm));
  }
}

TEST(CameraModels, AFittedModelIsKeptWhereTheFileIsWrittenFrom) {
  const CameraData data = sweep(0.005);
  Calibration c;
  find_camera_model("irt")->fit(data).store(c);
  find_camera_model("brown")->fit(data).store(c);
  c.source = "test";
  const Calibration back = parse_calibration(calibration_to_json(c), "back");
  EXPECT_EQ(back.irt.order(), 5);
  EXPECT_EQ(back.irt.sigma_mm({500, 400}, 150), c.irt.sigma_mm({500, 400}, 150));
  EXPECT_GT(back.irt.sigma_mm({500, 400}, 150), 0.0);
  ASSERT_EQ(back.planes.size(), 2u);
  int points = 0;
  double squares = 0.0;
  for (const PlaneResidual& plane : back.planes) {
    EXPECT_TRUE(plane.fitted);
    EXPECT_GT(plane.coverage, 0.5);
    EXPECT_LE(plane.rms_mm, plane.max_mm);
    points += plane.points;
    squares += plane.points * plane.rms_mm * plane.rms_mm;
  }
  EXPECT_EQ(points, back.points);
  // Two coordinates per point, 84 of them given to the coefficients.
  EXPECT_NEAR(std::sqrt(squares / (2.0 * points - 84)), back.sigma_mm, 1e-9);
  EXPECT_GT(back.loo_rms_mm, 0.0);
  ASSERT_NE(back.find_central("brown"), nullptr);
  EXPECT_EQ(back.find_central("pinhole"), nullptr);
  EXPECT_EQ(back.find_central("brown")->normalise({100, 200}),
            c.find_central("brown")->normalise({100, 200}));
}

}  // namespace
}  // namespace turntable
