#include "src/geometry/gimbal.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <numbers>
#include <stdexcept>

#include "src/core/units.h"
#include "tests/support/draws.h"
#include "tests/support/golden.h"

namespace turntable {
namespace {

// Default turntable: pitch, roll, yaw about x, y, z; yaw carries roll carries pitch.
GimbalConfig default_config() {
  GimbalConfig config;
  config.axes = {Vector3d::UnitZ(), Vector3d::UnitY(), Vector3d::UnitX()};  // yaw, roll, pitch
  return config;
}

GimbalConfig config_of(const nlohmann::json& document) {
  GimbalConfig config;
  for (std::size_t i = 0; i < 3; ++i) {
    config.order_base_outwards[i] =
        axis_from_name(document.at("order_base_outwards").at(i).get<std::string>());
    config.axes[i] =
        golden::vector<3>(document.at("axes").at(std::string(axis_name(kRotaryAxes[i]))));
  }
  return config;
}

GimbalAngles random_angles(Random& random) {
  return {random.uniform(-3.1, 3.1), random.uniform(-1.5, 1.5), random.uniform(-3.1, 3.1)};
}

TEST(GimbalGolden, rotation_agrees_and_decomposes_back_on_every_case) {
  const nlohmann::json document = golden::load("gimbal.json");
  const Gimbal gimbal(config_of(document));
  double worst = 0.0, worst_angle = 0.0;
  std::size_t number = 0;
  for (const auto& test_case : document.at("cases")) {
    SCOPED_TRACE("case " + std::to_string(number++));
    const GimbalAngles angles{rad_from_deg(test_case.at("yaw_deg")),
                              rad_from_deg(test_case.at("roll_deg")),
                              rad_from_deg(test_case.at("pitch_deg"))};
    const Matrix3d want = golden::matrix3(test_case.at("R"));
    const double difference = golden::largest_difference(gimbal.rotation(angles), want);
    EXPECT_LT(difference, golden::kAgreement);
    worst = std::max(worst, difference);
    const GimbalAngles back = gimbal.angles(want);
    EXPECT_LT(golden::largest_difference(gimbal.rotation(back), want), golden::kAgreement);
    // A case beyond +-90 deg of the middle axis has the same rotation by other angles.
    const AxisId middle = document.at("order_base_outwards").at(1) == "yaw"    ? AxisId::kYaw
                          : document.at("order_base_outwards").at(1) == "roll" ? AxisId::kRoll
                                                                               : AxisId::kPitch;
    if (std::abs(wrap(angles[middle], 2 * std::numbers::pi)) > rad_from_deg(89.9)) continue;
    for (const AxisId axis : kRotaryAxes) {
      const double error = std::abs(wrap(back[axis] - angles[axis], 2 * std::numbers::pi));
      EXPECT_LT(deg_from_rad(error), golden::kAgreement) << axis_name(axis);
      worst_angle = std::max(worst_angle, deg_from_rad(error));
    }
  }
  golden::report("gimbal, R", number, worst);
  golden::report("gimbal, angles, deg", number, worst_angle);
}

TEST(Gimbal, turns_the_inner_axis_with_the_outer_one) {
  const Gimbal gimbal(default_config());
  // Yaw by 90 deg turns the pitch axis from x to y: a point on z then pitches about y.
  const Matrix3d R = gimbal.rotation({rad_from_deg(90), 0, rad_from_deg(90)});
  EXPECT_LT((R * Vector3d::UnitZ() - Vector3d::UnitX()).norm(), 1e-15);
}

TEST(Gimbal, angles_return_for_every_order_and_handedness) {
  Random random = draws_of_this_test();
  std::array order = kRotaryAxes;
  std::ranges::sort(order);
  do {
    for (int flips = 0; flips < 8; ++flips) {
      GimbalConfig config = default_config();
      config.order_base_outwards = order;
      const Matrix3d mounting = rotation_from_vector({0.3, -0.2, 0.5});
      for (std::size_t i = 0; i < 3; ++i)
        config.axes[i] = mounting * config.axes[i] * ((flips >> i & 1) != 0 ? -1.0 : 1.0);
      const Gimbal gimbal(config);
      GimbalAngles angles;
      for (const AxisId axis : order) angles[axis] = random.uniform(-1.5, 1.5);
      const GimbalAngles back = gimbal.angles(gimbal.rotation(angles));
      for (const AxisId axis : order) EXPECT_NEAR(back[axis], angles[axis], 1e-12);
    }
  } while (std::ranges::next_permutation(order).found);
}

TEST(Gimbal, at_the_singularity_the_rotation_still_returns) {
  const Gimbal gimbal(default_config());
  for (const double middle : {90.0, -90.0})
    for (const double outer : {-120.0, 0.0, 35.0}) {
      const Matrix3d R =
          gimbal.rotation({rad_from_deg(outer), rad_from_deg(middle), rad_from_deg(20)});
      const GimbalAngles back = gimbal.angles(R);
      EXPECT_EQ(back.pitch, 0.0);
      EXPECT_NEAR(deg_from_rad(back.roll), middle, 1e-6);
      EXPECT_LT((gimbal.rotation(back) - R).cwiseAbs().maxCoeff(), 1e-12);
    }
}

TEST(Gimbal, near_the_singularity_the_rotation_still_returns) {
  const Gimbal gimbal(default_config());
  for (const double off : {1e-3, 1e-6, 1e-9, 1e-11, 1e-13}) {
    const Matrix3d R = gimbal.rotation({0.4, std::numbers::pi / 2 - off, -0.7});
    EXPECT_LT((gimbal.rotation(gimbal.angles(R)) - R).cwiseAbs().maxCoeff(), 1e-11) << off;
  }
}

TEST(Gimbal, decomposition_stays_in_its_ranges) {
  Random random = draws_of_this_test();
  const Gimbal gimbal(default_config());
  for (int draw = 0; draw < 1000; ++draw) {
    const Matrix3d R = gimbal.rotation(random_angles(random));
    const GimbalAngles angles = gimbal.angles(R);
    EXPECT_LE(std::abs(angles.roll), std::numbers::pi / 2);
    EXPECT_LT((gimbal.rotation(angles) - R).cwiseAbs().maxCoeff(), 1e-12);
  }
}

TEST(Gimbal, refuses_axes_that_are_not_orthogonal) {
  GimbalConfig config = default_config();
  config.axes[1] = Vector3d(0.1, 1.0, 0.0);
  EXPECT_THROW(Gimbal{config}, std::invalid_argument);
  config.axes[1] = config.axes[0];
  EXPECT_THROW(Gimbal{config}, std::invalid_argument);
  config.axes[1] = Vector3d::Zero();
  EXPECT_THROW(Gimbal{config}, std::invalid_argument);
}

TEST(Gimbal, the_stage_carries_the_centre_along_z) {
  GimbalConfig config = default_config();
  config.centre_at_stage_zero_mm = {1, 2, 3};
  EXPECT_EQ(Gimbal(config).centre_mm(100.0), Vector3d(1, 2, 103));
}

TEST(Gimbal, turns_about_tilted_axes_and_decomposes_by_the_stated_ones) {
  GimbalConfig config = default_config();
  config.axis_tilt_deg = {0.1, -0.2, 0.3};
  const Gimbal tilted(config), drawn(default_config());
  const double rad = std::numbers::pi / 180.0;
  // Yaw, roll, pitch = z, y, x: roll leans towards yaw, pitch towards yaw and towards roll.
  const Vector3d roll = Vector3d(0, 1, 0.1 * rad).normalized();
  const Vector3d pitch = Vector3d(1, 0.3 * rad, -0.2 * rad).normalized();
  const GimbalAngles angles{0.3, -0.4, 0.5};
  const Matrix3d expected = Eigen::AngleAxisd(0.3, Vector3d::UnitZ()).toRotationMatrix() *
                            Eigen::AngleAxisd(-0.4, roll).toRotationMatrix() *
                            Eigen::AngleAxisd(0.5, pitch).toRotationMatrix();
  EXPECT_LT((tilted.rotation(angles) - expected).cwiseAbs().maxCoeff(), 1e-12);
  EXPECT_LT((drawn.rotation(tilted.angles(expected)) - expected).cwiseAbs().maxCoeff(), 1e-12);
  // By order of yaw, roll, pitch.
  EXPECT_LT((drawn.turning_about({Vector3d::UnitZ(), roll, pitch}).rotation(angles) - expected)
                .cwiseAbs()
                .maxCoeff(),
            1e-12);
}

TEST(Gimbal, a_turned_gimbal_turns_its_attitudes) {
  GimbalConfig config = default_config();
  config.plane_from_gimbal_deg = {0.4, -0.3, 0.2};
  const Matrix3d X = rotation_from_vector(config.plane_from_gimbal_deg * std::numbers::pi / 180.0);
  const GimbalAngles angles{0.3, -0.4, 0.5};
  EXPECT_LT((Gimbal(config).rotation(angles) -
             X * Gimbal(default_config()).rotation(angles) * X.transpose())
                .cwiseAbs()
                .maxCoeff(),
            1e-12);
}

TEST(Gimbal, the_stage_has_no_angle) {
  GimbalAngles angles;
  EXPECT_THROW(angles[AxisId::kStage] = 1.0, std::out_of_range);
}

}  // namespace
}  // namespace turntable
