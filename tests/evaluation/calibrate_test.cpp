#include "src/evaluation/calibrate.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <nlohmann/json.hpp>

#include "src/core/errors.h"
#include "src/record/image_archive.h"
#include "src/record/number_table.h"
#include "src/record/sha256.h"
#include "tests/support/message_of.h"
#include "tests/support/real_data.h"
#include "tests/support/simulated_view.h"
#include "tests/support/temporary_folder.h"

namespace turntable {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

constexpr const char* kAbsent =
    "REAL DATA ABSENT: nothing of this test was checked. Put the folder shared/real beside the "
    "source "
    "tree, or name it in TURNTABLE_REAL.";

const OrderRow& row_of(const Calibration& c, int order) {
  return c.orders.at(static_cast<std::size_t>(order - 1));
}

/// Of all held-out points, those outside the calibrated area included.
double held_out_rms_mm(const OrderRow& o) {
  const double inside = o.held_out_points > 0 ? o.held_out_rms_mm : 0.0;
  const double outside = o.outside_points > 0 ? o.outside_rms_mm : 0.0;
  return std::sqrt((inside * inside * o.held_out_points + outside * outside * o.outside_points) /
                   (o.held_out_points + o.outside_points));
}

/// A set of images of the simulated rig: three planes, `images` each, and two tilted views.
class SimulatedSet {
 public:
  SimulatedSet() : view_(shipped_rig("simulated")) {
    const Json rig = Json::parse(view_.rig().source);
    json_ = {{"format", "turntable-calibration-set/1"},
             {"name", "simulated planes"},
             {"simulated", true},
             {"electrons_per_grey", view_.rig().camera.electrons_per_grey},
             {"polynomial_order", 5},
             {"pattern", rig.at("pattern")},
             {"planes", Json::array()},
             {"views", Json::array()}};
    for (const double z : {0.0, 130.0, 180.0}) {
      Json images = Json::array();
      for (int k = 0; k < 2; ++k) images.push_back(take(z, 0, 0));
      json_["planes"].push_back(
          {{"z_mm", z}, {"use", z == 0 ? "check" : "fit"}, {"images", images}});
    }
    for (const auto& [roll, pitch] :
         {std::pair{25.0, 0.0}, {-20.0, 15.0}, {0.0, -25.0}, {15.0, 20.0}})
      json_["views"].push_back(take(80, roll, pitch));
  }
  Json json_;

  CalibrationSet load() {
    spill(folder_ / "set.json", json_.dump());
    return load_calibration_set(folder_ / "set.json");
  }
  std::string refusal() {
    return message_of<ConfigError>([&] { load(); });
  }
  const TemporaryFolder& folder() const { return folder_; }

 private:
  std::string take(double z, double roll, double pitch) {
    const std::string name = std::to_string(count_++) + ".png";
    view_.stand(z, 0, roll, pitch);
    write_image(folder_ / name, view_.look(Payload::kCirclePattern));
    return name;
  }
  static void write_image(const fs::path& file, const Image& image) {
    spill(file, encode_png(image));
  }
  TemporaryFolder folder_;
  SimulatedView view_;
  int count_ = 0;
};

TEST(CalibrationSet, OfImagesGivesRaysWithinTheStatedBoundsAndEveryModel) {
  SimulatedSet simulated;
  const CalibrationSet set = simulated.load();
  EXPECT_EQ(set.images.size(), 10u);
  EXPECT_EQ(set.images[0].sha256.size(), 64u);
  const Calibration c = calibrate(set);
  for (const PlaneResidual& plane : c.planes)
    EXPECT_LE(plane.max_mm, plane.fitted ? 0.02 : 0.03) << plane.z_mm;
  EXPECT_GT(c.chi2_per_dof, 0.8);
  EXPECT_LT(c.chi2_per_dof, 1.2);
  ASSERT_EQ(c.models.size(), 5u);
  for (const ModelRow& m : c.models) EXPECT_EQ(m.why_not, "") << m.name;
  ASSERT_NE(c.find_central("brown"), nullptr);
  EXPECT_LT(c.models[0].held_out_rms_mm, c.models[1].held_out_rms_mm);  // irt below pinhole
  EXPECT_GT(c.irt.covariance().size(), 0);
}

TEST(CalibrationSet, MisuseIsRefusedWithFileAndPlace) {
  SimulatedSet simulated;
  const Json good = simulated.json_;
  const auto refusal_of = [&](const char* pointer, const Json& value) {
    simulated.json_ = good;
    simulated.json_[Json::json_pointer(pointer)] = value;
    return simulated.refusal();
  };
  EXPECT_THAT(refusal_of("/planes/1/use", "both"), HasSubstr("/planes/1/use"));
  EXPECT_THAT(refusal_of("/planes/1/use", "check"), HasSubstr("at least 2"));
  EXPECT_THAT(refusal_of("/planes/1/z_mm", 180), HasSubstr("twice"));
  EXPECT_THAT(refusal_of("/planes/0/images/0", "none.png"), HasSubstr("none.png"));
  EXPECT_THAT(refusal_of("/image_size_px", {640, 480}), HasSubstr("image_size_px says"));
  EXPECT_THAT(refusal_of("/pattern/radius_mm", "three"), HasSubstr("/pattern/radius_mm"));
  EXPECT_THAT(refusal_of("/pattern/offset_mm", {0, 0}), HasSubstr("/pattern/offset_mm"));
  EXPECT_THAT(refusal_of("/pattern/circles", "dark"), HasSubstr(".png: no pattern"));
  EXPECT_THAT(refusal_of("/polynomial_order", 12), HasSubstr("/polynomial_order"));
  EXPECT_THAT(refusal_of("/points", {{"file", "p.csv"}}), HasSubstr("either"));
}

// ---- sweeps with repeats

/// A sweep of the simulated rig with images and record, whose table stands where the test says.
class SimulatedSweep {
 public:
  SimulatedSweep() : view_(shipped_rig("simulated")) {
    fs::create_directory(folder_ / "images");
    ScenarioInfo scenario;
    scenario.name = "sweep";
    scenario.kind = ScenarioKind::kCalibration;
    record_.plan.scenarios.push_back(scenario);
  }
  /// @param yaw_error_deg where the table stands and its controller does not know
  void visit(double stage_mm, int repeat, double yaw_error_deg = 0.0) {
    TakenPose pose;
    pose.planned.role = stage_mm == 0.0 ? PoseRole::kPlaneCheck : PoseRole::kPlaneFit;
    pose.planned.payload = Payload::kCirclePattern;
    pose.planned.repeat = repeat;
    pose.planned.stage_mm = pose.stage.position = stage_mm;
    view_.stand(stage_mm, yaw_error_deg, 0, 0);
    TakenImage image;
    image.file = "images/" + std::to_string(record_.poses.size()) + ".png";
    const std::string bytes = encode_png(view_.look(Payload::kCirclePattern));
    image.sha256 = sha256_hex(bytes);
    spill(folder_ / image.file, bytes);
    pose.images.push_back(image);
    record_.poses.push_back(pose);
  }
  CalibrationSet set() {
    record_.plan.poses.clear();
    for (const TakenPose& pose : record_.poses) record_.plan.poses.push_back(pose.planned);
    number_poses(record_.plan);
    spill(folder_ / "plan.json", plan_text(record_.plan));
    return sweep_set(record_, RunFolder::open(folder_.path()), view_.rig());
  }

 private:
  TemporaryFolder folder_;
  SimulatedView view_;
  RunRecord record_;
};

constexpr double kSweepPlanes[] = {0.0, 130.0, 180.0};

TEST(CalibrationSweep, WithRepeatsGivesTheCameraOfASingleOneWithinItsNoise) {
  SimulatedSweep sweep;
  for (const double z : kSweepPlanes) sweep.visit(z, 1);
  const CalibrationSet single = sweep.set();
  for (const int repeat : {2, 3, 4})
    for (const double z : kSweepPlanes) sweep.visit(z, repeat);
  const CalibrationSet pooled = sweep.set();

  ASSERT_EQ(pooled.planes.size(), 3u);
  for (std::size_t k = 0; k < 3; ++k) {
    EXPECT_EQ(pooled.planes[k].z_mm, kSweepPlanes[k]);
    EXPECT_EQ(pooled.planes[k].fit, k > 0);  // the plane kept out stays out in every repeat
    EXPECT_EQ(pooled.stage[k].visits, 4);
    // Four images of equal noise: half of it is left.
    EXPECT_NEAR(pooled.planes[k].points[0].sigma_px, 0.5 * single.planes[k].points[0].sigma_px,
                0.1 * single.planes[k].points[0].sigma_px);
    EXPECT_TRUE(std::isnan(single.stage[k].repeat_rms_px));
    // Nothing but the noise of the images moved it: u and v together, root 2 of one coordinate.
    EXPECT_NEAR(pooled.stage[k].repeat_rms_px, std::sqrt(2.0) * single.planes[k].points[0].sigma_px,
                0.3 * single.planes[k].points[0].sigma_px);
  }
  const Calibration one = calibrate(single), four = calibrate(pooled);
  EXPECT_EQ(four.planes.size(), 3u);
  EXPECT_EQ(four.points, one.points);
  for (const double u : {200.0, 512.0, 800.0})
    for (const double v : {300.0, 512.0, 700.0})
      for (const double z : {0.0, 130.0, 180.0}) {
        const Vector2d pixel(u, v);
        const double allowed = 4 * one.irt.sigma_mm(pixel, z);
        const Vector2d off = one.irt.ray(pixel).at(z, one.irt.planes()) -
                             four.irt.ray(pixel).at(z, four.irt.planes());
        EXPECT_LE(std::abs(off.x()), allowed) << u << " " << v << " " << z;
        EXPECT_LE(std::abs(off.y()), allowed) << u << " " << v << " " << z;
      }
  EXPECT_LT(four.irt.sigma_mm({512, 512}, 150), 0.7 * one.irt.sigma_mm({512, 512}, 150));
}

TEST(CalibrationSweep, TellsHowItsPlanesRepeatAndWhatTheReturnSaysOfDrift) {
  SimulatedSweep sweep;
  // The first plane comes to lie 0.03 deg turned to either side: the standard deviation of
  // -0.03, 0, 0.03 deg is 0.03 deg.
  const double turn_deg = 0.03, turn = turn_deg * 3.14159265358979 / 180.0;
  for (const int repeat : {1, 2, 3}) {
    sweep.visit(0.0, repeat, turn_deg * (repeat - 2));
    sweep.visit(180.0, repeat);
  }
  sweep.visit(130.0, 1);
  sweep.visit(0.0, 3, 20 * turn_deg);  // the return: something came loose
  const CalibrationSet set = sweep.set();
  ASSERT_EQ(set.stage.size(), 3u);
  double square_mm = 0.0, square_px = 0.0;
  Vector2d mean_mm = Vector2d::Zero();
  const auto& points = set.planes[0].points;
  const Vector2d origin = std::ranges::find_if(points, [](const PlanePoint& p) {
                            return p.column == 0 && p.row == 0;
                          })->pixel_px;
  for (const PlanePoint& p : points) {
    square_mm += p.on_plane_mm.squaredNorm();
    square_px += (p.pixel_px - origin).squaredNorm();
    mean_mm += p.on_plane_mm / static_cast<double>(points.size());
  }
  const auto count = static_cast<double>(points.size());
  const PlaneVisits& first = set.stage[0];
  EXPECT_EQ(first.visits, 4);
  EXPECT_NEAR(first.repeat_rms_mm, turn * std::sqrt(square_mm / count), 0.05 * first.repeat_rms_mm);
  EXPECT_NEAR(first.repeat_rms_px, turn * std::sqrt(square_px / count), 0.05 * first.repeat_rms_px);
  // From the first visit at -1 to the return at 20.
  EXPECT_NEAR(first.drift_plane_mm, 21 * turn * mean_mm.norm(), 0.05 * first.drift_plane_mm + 0.01);
  EXPECT_LT(set.stage[1].repeat_rms_px, 0.5 * first.repeat_rms_px);
  EXPECT_TRUE(std::isnan(set.stage[2].repeat_rms_px));
  EXPECT_TRUE(std::isnan(set.stage[2].drift_plane_mm));

  Calibration stored = calibrate(set);
  const Calibration again = parse_calibration(calibration_to_json(stored), "calibration.json");
  EXPECT_NEAR(again.stage[0].repeat_rms_px, first.repeat_rms_px, 1e-12);
  EXPECT_NEAR(again.stage[0].drift_plane_mm, first.drift_plane_mm, 1e-12);
  EXPECT_TRUE(std::isnan(again.stage[2].repeat_rms_mm));
}

// ---- real images, which nobody here made

/// The PIV plate's seven images and the points picked by hand, as a lab would hand them in.
CalibrationSet piv_set(const fs::path& real, const TemporaryFolder& folder, int order) {
  const fs::path data = real / "piv_case_e_camera_1";
  const NumberTable given = read_number_table(
      data / "points.csv",
      {"z_mm", "x_mm", "y_mm", "u_px_as_given", "v_px_as_given_counted_upward_from_the_bottom"});
  std::string csv = "x_mm,y_mm,z_mm,u_px,v_px\n";
  for (std::size_t i = 0; i < given.rows(); ++i)
    csv += fmt::format("{},{},{},{},{}\n", given.at("x_mm")[i], given.at("y_mm")[i],
                       given.at("z_mm")[i], given.at("u_px_as_given")[i],
                       given.at("v_px_as_given_counted_upward_from_the_bottom")[i]);
  spill(folder / "guides.csv", csv);
  Json json{
      {"format", "turntable-calibration-set/1"},
      {"name", "PIV plate"},
      {"points", {{"file", "guides.csv"}, {"refine", {{"circles", "bright"}, {"reach_px", 6}}}}},
      {"planes", Json::array()}};
  if (order > 0) json["polynomial_order"] = order;
  for (int plane = 1; plane <= 7; ++plane)
    json["planes"].push_back({{"z_mm", plane - 4},
                              {"use", plane == 1 || plane == 7 ? "fit" : "check"},
                              {"images", {(data / fmt::format("z_{}.tif", plane)).string()}}});
  spill(folder / "piv.json", json.dump());
  return load_calibration_set(folder / "piv.json");
}

TEST(RealPivPlate, OrderTwoIsChosenAndOrderFiveShownToOverFit) {
  const auto real = real_data();
  if (!real) GTEST_SKIP() << kAbsent;
  const TemporaryFolder folder;
  const CalibrationSet set = piv_set(*real, folder, 0);
  const Calibration c = calibrate(set);
  for (const std::string& remark : set.remarks) std::printf("%s\n", remark.c_str());
  for (const OrderRow& o : c.orders)
    std::printf("order %d: fitted %.1f um, held out %.1f um, left out %.1f um %s\n", o.order,
                1000 * o.rms_mm, 1000 * o.held_out_rms_mm, 1000 * o.loo_rms_mm, o.refused.c_str());
  EXPECT_EQ(c.irt.order(), 2);
  EXPECT_EQ(c.points, 72);  // every dot that was picked by hand
  EXPECT_LE(row_of(c, 2).loo_rms_mm, 0.0108);
  EXPECT_LE(held_out_rms_mm(row_of(c, 2)), 0.0095);
  // Order 5 fits and even predicts the other planes better, but not a point that it has not seen.
  EXPECT_LT(row_of(c, 5).rms_mm, row_of(c, 2).rms_mm);
  EXPECT_LT(row_of(c, 5).held_out_rms_mm, row_of(c, 2).held_out_rms_mm);
  EXPECT_GT(row_of(c, 5).loo_rms_mm, 1.2 * row_of(c, 2).loo_rms_mm);
}

TEST(RealSteppedTarget, TheStripIsRecognisedAndHighOrdersAreRefused) {
  const auto real = real_data();
  if (!real) GTEST_SKIP() << kAbsent;
  const TemporaryFolder folder;
  std::ifstream in(*real / "myptv_camera_1" / "cam1_cal_points");
  std::string csv = "u_px,v_px,x_mm,y_mm,z_mm\n";
  double u, v, x, y, z;
  while (in >> u >> v >> x >> y >> z) csv += fmt::format("{},{},{},{},{}\n", u, v, x, y, z);
  spill(folder / "points.csv", csv);
  Json json{{"format", "turntable-calibration-set/1"},
            {"name", "stepped target"},
            {"image_size_px", {1280, 1024}},
            {"points", {{"file", "points.csv"}}},
            {"planes",
             {{{"z_mm", 0}, {"use", "fit"}},
              {{"z_mm", -12}, {"use", "fit"}},
              {{"z_mm", -6}, {"use", "check"}}}}};
  spill(folder / "stepped.json", json.dump());
  const CalibrationSet set = load_calibration_set(folder / "stepped.json");
  const Calibration c = calibrate(set);
  for (const OrderRow& o : c.orders)
    std::printf(
        "order %d: fitted %.3f mm, held out %.3f mm (outside the domain %.3f), left out %.3f "
        "mm, leverage %.2f %s\n",
        o.order, o.rms_mm, o.held_out_rms_mm, o.outside_rms_mm, o.loo_rms_mm, o.max_leverage,
        o.refused.c_str());
  int strips = 0;
  for (const PlaneResidual& plane : c.planes) strips += plane.fitted && plane.coverage < 0.5;
  EXPECT_EQ(strips, 1);
  EXPECT_LE(c.irt.order(), 2);
  EXPECT_FALSE(row_of(c, 9).refused.empty());
  // Most of the plane between lies outside the strip.
  EXPECT_GT(row_of(c, 1).outside_points, row_of(c, 1).held_out_points);
  const std::string refusal = message_of<Error>([&] {
    CalibrationSet ninth = set;
    ninth.order = 9;
    calibrate(ninth);
  });
  EXPECT_THAT(refusal, HasSubstr("plane"));
}

TEST(RealCircleGrid, SixPhotographsCalibrateTheirCamera) {
  const auto real = real_data();
  if (!real) GTEST_SKIP() << kAbsent;
  const TemporaryFolder folder;
  Json json{{"format", "turntable-calibration-set/1"},
            {"name", "circle grid"},
            {"pattern",
             {{"kind", "circle_grid"},
              {"columns", 10},
              {"rows", 8},
              {"origin", {0, 0}},
              {"spacing_mm", 25},
              {"radius_mm", 7.5},
              {"circles", "dark"}}},
            {"views", Json::array()}};
  for (int i = 0; i < 6; ++i)
    json["views"].push_back((*real / "circles_boofcv" / fmt::format("image{:05}.jpg", i)).string());
  spill(folder / "grid.json", json.dump());
  const CalibrationSet set = load_calibration_set(folder / "grid.json");
  ASSERT_EQ(set.views.size(), 6u);
  for (const PatternView& view : set.views) EXPECT_EQ(view.pixels_px.size(), 80u);
  ASSERT_FALSE(set.remarks.empty());
  EXPECT_THAT(set.remarks[0], HasSubstr("half a turn"));
  const Calibration c = calibrate(set);
  for (const CentralModel& m : c.central)
    std::printf("%s: %.4f px rms\n", std::string(central_name(m.kind)).c_str(), m.rms_px);
  for (const OrderRow& o : c.orders)
    std::printf("order %d: fitted %.4f mm, views kept out %.4f mm %s\n", o.order, o.rms_mm,
                o.held_out_rms_mm, o.refused.c_str());
  ASSERT_NE(c.find_central("brown"), nullptr);
  // Length per point; the photographs' own board, not the circles, is what limits it: OpenCV's path
  // comes to the same (tests/vision/board_test.cpp).
  EXPECT_LT(c.find_central("brown")->rms_px, 0.5);
  EXPECT_GT(c.irt.order(), 0);
}

}  // namespace
}  // namespace turntable
