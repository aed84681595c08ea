#include "src/evaluation/truth.h"

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "src/core/units.h"
#include "tests/support/draws.h"

namespace turntable {
namespace {

Matrix3d turn(const Vector3d& deg) { return rotation_from_vector(deg / kDegPerRad); }

TEST(Align, FindsWhatIsFixedBeforeAndBehindTheGimbal) {
  Random random = draws_of_this_test();
  const auto draw = [&](double deg) {
    return turn(deg * Vector3d(random.normal(), random.normal(), random.normal()));
  };
  const Matrix3d X = draw(20.0), Y = draw(60.0);
  std::vector<Matrix3d> gimbal, measured;
  for (int k = 0; k < 50; ++k) {
    gimbal.push_back(draw(15.0));
    measured.push_back(X * gimbal.back() * Y);
  }
  const Alignment exact = align(measured, gimbal);
  EXPECT_LT(geodesic_angle(exact.X, X), 1e-9);
  EXPECT_LT(geodesic_angle(exact.Y, Y), 1e-9);
  EXPECT_EQ(exact.determined, 6);
  for (Matrix3d& R : measured) R = draw(0.05) * R;
  const Alignment noisy = align(measured, gimbal);
  EXPECT_LT(geodesic_angle(noisy.X, X), 0.3 / kDegPerRad);
  EXPECT_NEAR(noisy.rms_rad * kDegPerRad, 0.05 * std::sqrt(3.0), 0.015);
}

TEST(Align, LeavesOpenWhatTurnsAboutOneAxisDoNotTell) {
  const Matrix3d X = turn({0.3, -0.4, 0.0}), Y = turn({5, 3, -80});
  std::vector<Matrix3d> gimbal, measured;
  for (int k = 0; k < 10; ++k) {
    gimbal.push_back(turn({0, 0, 5.0 * k}));
    measured.push_back(X * gimbal.back() * Y);
  }
  const Alignment found = align(measured, gimbal);
  EXPECT_EQ(found.determined, 5);
  EXPECT_LT(found.rms_rad, 1e-9);
  EXPECT_LT(geodesic_angle(found.X, X), 0.01 / kDegPerRad);  // nearest to no turn at all
  const Matrix3d relative = gimbal[9] * gimbal[0].transpose();
  EXPECT_LT(geodesic_angle(found.X * relative * found.X.transpose(),
                           measured[9] * measured[0].transpose()),
            1e-9);
  EXPECT_EQ(align({}, {}).X, Matrix3d::Identity());
}

}  // namespace
}  // namespace turntable
