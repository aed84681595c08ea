#include "src/evaluation/measure_spots.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "src/imaging/opencv_yaml.h"

namespace turntable {
namespace {

/// A pinhole with its rays, 600 mm above the target.
const Calibration& pinhole() {
  static const Calibration made = [] {
    CentralModel lens;
    lens.fx = lens.fy = 1945.0;
    lens.cx = lens.cy = 511.5;
    lens.image_size = {1024, 1024};
    return calibration_from_central(lens, {-625.0, -575.0}, "pinhole");
  }();
  return made;
}

const TargetModel& leds() {
  static const TargetModel model(
      std::vector<Vector3d>{{0, 0, 0}, {58.6, 13.0, -40}, {-40.6, 44.2, -40}, {-18.0, -57.2, -40}});
  return model;
}

Vector2d pixel_of(const Vector3d& in_plane) {
  return {511.5 - 1945.0 * in_plane.x() / in_plane.z(),
          511.5 + 1945.0 * in_plane.y() / in_plane.z()};
}

/// The spots of the target, last point first, so that no order is right by accident.
SpotList spots_of(const TargetModel& target, const Matrix3d& R, const Vector3d& at) {
  SpotList spots;
  for (int t = target.size() - 1; t >= 0; --t) {
    spots.centres_px.push_back(
        pixel_of(R * (target.points().col(t) - target.points().col(0)) + at));
    spots.sigmas_px.push_back(0.02);
  }
  return spots;
}

constexpr double kRad = std::numbers::pi / 180.0;
const Matrix3d kTurned = rotation_from_vector({0.2, -0.3, 0.4});
const Vector3d kPlace(5, -8, -590);

MeasuredAttitude pose(const Matrix3d& R, const Vector3d& at) {
  MeasuredAttitude out;
  out.status = SolveStatus::kConverged;
  out.R_plane_from_target = R;
  out.position_mm = at;
  return out;
}

TEST(MeasureSpots, FindsTheTargetAmongOtherSpotsWithoutAPrediction) {
  const AttitudeSensor sensor(pinhole(), leds(), default_solver());
  SpotList spots = spots_of(leds(), kTurned, kPlace);
  spots.centres_px.insert(spots.centres_px.begin(), {100, 900});
  spots.sigmas_px.insert(spots.sigmas_px.begin(), 0.02);
  const TargetMeasurement got = measure_spots(sensor, spots);
  EXPECT_EQ(got.status, "converged");
  EXPECT_FALSE(got.predicted);
  EXPECT_EQ(got.spot_of_point, (std::vector<int>{4, 3, 2, 1}));
  EXPECT_LT(geodesic_angle(got.attitude.R_plane_from_target, kTurned), 1e-4 * kRad);
  EXPECT_LT((got.attitude.position_mm - kPlace).norm(), 1e-4);
  EXPECT_GT(got.attitude.covariance(0, 0), 0.0);
}

TEST(MeasureSpots, TakesThePredictionWhereItFits) {
  const AttitudeSensor sensor(pinhole(), leds(), default_solver());
  const SpotList spots = spots_of(leds(), kTurned, kPlace);
  const MeasuredAttitude before =
      pose(rotation_from_vector({0.0, 0.05, 0.0}) * kTurned, kPlace + Vector3d(2, 2, 5));
  const TargetMeasurement got = measure_spots(sensor, spots, {}, &before);
  EXPECT_TRUE(got.predicted);
  EXPECT_EQ(got.spot_of_point, (std::vector<int>{3, 2, 1, 0}));
  EXPECT_LT(geodesic_angle(got.attitude.R_plane_from_target, kTurned), 1e-4 * kRad);
}

TEST(MeasureSpots, LooksEverywhereWhereThePredictionDoesNotFitAnyMore) {
  const AttitudeSensor sensor(pinhole(), leds(), default_solver());
  const SpotList spots = spots_of(leds(), kTurned, kPlace);
  const MeasuredAttitude elsewhere = pose(Matrix3d::Identity(), {-60, 40, -590});
  const TargetMeasurement got = measure_spots(sensor, spots, {}, &elsewhere);
  EXPECT_FALSE(got.predicted);
  EXPECT_EQ(got.status, "converged");
  EXPECT_LT(geodesic_angle(got.attitude.R_plane_from_target, kTurned), 1e-4 * kRad);
}

TEST(MeasureSpots, SaysWhyThereIsNoAttitude) {
  const AttitudeSensor sensor(pinhole(), leds(), default_solver());
  SpotList spots = spots_of(leds(), kTurned, kPlace);
  SpotList moved = spots;
  moved.centres_px[1] += Vector2d(15, -20);
  EXPECT_EQ(measure_spots(sensor, moved).status, "no target");
  spots.centres_px.pop_back();
  spots.sigmas_px.pop_back();
  const TargetMeasurement few = measure_spots(sensor, spots);
  EXPECT_EQ(few.status, "too few spots: 3 of 4");
  EXPECT_FALSE(few.attitude.has_attitude());
  EXPECT_TRUE(few.spot_of_point.empty());

  // Three assignments of a cube's corner look the same.
  const TargetModel corner(std::vector<Vector3d>{{0, 0, 0}, {75, 0, 0}, {0, 75, 0}, {0, 0, 75}});
  const AttitudeSensor of_corner(pinhole(), corner, default_solver());
  const TargetMeasurement one_of_three =
      measure_spots(of_corner, spots_of(corner, kTurned, kPlace));
  EXPECT_EQ(one_of_three.status, "ambiguous spots");
  EXPECT_FALSE(one_of_three.attitude.has_attitude());
}

TEST(MeasureSpots, TellsTheTurnsOfASymmetricTargetApartIfToldWhereToLook) {
  const TargetModel corner(std::vector<Vector3d>{{0, 0, 0}, {75, 0, 0}, {0, 75, 0}, {0, 0, 75}});
  const AttitudeSensor sensor(pinhole(), corner, default_solver());
  const SpotList spots = spots_of(corner, kTurned, kPlace);
  const TargetMeasurement got = measure_spots(sensor, spots, {.max_turn_rad = 50 * kRad});
  EXPECT_EQ(got.status, "converged");
  EXPECT_LT(geodesic_angle(got.attitude.R_plane_from_target, kTurned), 1e-4 * kRad);

  const Matrix3d third = rotation_from_vector(120 * kRad * Vector3d(1, 1, 1).normalized());
  const TargetMeasurement turned =
      measure_spots(sensor, spots, {.R_near = kTurned * third, .max_turn_rad = 50 * kRad});
  EXPECT_LT(geodesic_angle(turned.attitude.R_plane_from_target, kTurned * third), 1e-4 * kRad);
}

TEST(MeasureSpots, ByNameTakesTheTargetsOrderAndWeighsAlikeIfASpotStatesNoUncertainty) {
  const AttitudeSensor sensor(pinhole(), leds(), default_solver());
  SpotList spots = spots_of(leds(), kTurned, kPlace);
  std::ranges::reverse(spots.centres_px);
  const TargetMeasurement stated = measure_named_spots(sensor, spots);
  EXPECT_EQ(stated.status, "converged");
  EXPECT_LT(geodesic_angle(stated.attitude.R_plane_from_target, kTurned), 1e-4 * kRad);
  EXPECT_TRUE(std::isfinite(stated.attitude.chi2));
  spots.sigmas_px[2] = 0.0;
  EXPECT_TRUE(std::isnan(measure_named_spots(sensor, spots).attitude.chi2));
}

TEST(MeasureSpots, OfATargetInAPlaneNeedsAPrediction) {
  const TargetModel flat(std::vector<Vector3d>{{0, 0, 0}, {60, 0, 0}, {0, 50, 0}, {-30, -40, 0}});
  const AttitudeSensor sensor(pinhole(), flat, default_solver());
  const SpotList spots = spots_of(flat, kTurned, kPlace);
  EXPECT_THROW(measure_spots(sensor, spots), std::invalid_argument);
  const MeasuredAttitude before = pose(kTurned, kPlace);
  const TargetMeasurement got = measure_spots(sensor, spots, {}, &before);
  EXPECT_TRUE(got.predicted);
  EXPECT_LT(geodesic_angle(got.attitude.R_plane_from_target, kTurned), 1e-4 * kRad);
}

}  // namespace
}  // namespace turntable
