#include "src/geometry/rotation.h"

#include <gtest/gtest.h>

#include <Eigen/LU>
#include <numbers>

#include "tests/support/draws.h"

namespace turntable {
namespace {

constexpr double kPi = std::numbers::pi;

Vector3d random_direction(Random& random) {
  return Vector3d(random.normal(), random.normal(), random.normal()).normalized();
}

double off_rotation(const Matrix3d& R) {
  return (R * R.transpose() - Matrix3d::Identity()).cwiseAbs().maxCoeff() +
         std::abs(R.determinant() - 1.0);
}

TEST(Rotation, vector_and_matrix_return_to_each_other_from_tiny_angles_to_pi) {
  Random random = draws_of_this_test();
  for (const double angle : {0.0, 1e-300, 1e-16, 1e-9, 1e-4, 0.5, 2.0, kPi - 1e-4, kPi - 1e-7}) {
    const Vector3d v = angle * random_direction(random);
    const Matrix3d R = rotation_from_vector(v);
    EXPECT_LT(off_rotation(R), 1e-14) << angle;
    EXPECT_LT((vector_from_rotation(R) - v).norm(), 1e-12) << angle;
  }
}

TEST(Rotation, half_turn_returns_up_to_the_sign_of_its_axis) {
  Random random = draws_of_this_test();
  for (int draw = 0; draw < 50; ++draw) {
    const Matrix3d R = rotation_from_vector(kPi * random_direction(random));
    EXPECT_NEAR(vector_from_rotation(R).norm(), kPi, 1e-12);
    EXPECT_LT((rotation_from_vector(vector_from_rotation(R)) - R).cwiseAbs().maxCoeff(), 1e-12);
  }
}

TEST(Rotation, turns_right_handed) {
  EXPECT_LT((rotation_from_vector({0, 0, kPi / 2}) * Vector3d::UnitX() - Vector3d::UnitY()).norm(),
            1e-15);
}

TEST(Rotation, nearest_rotation_is_a_rotation_and_leaves_rotations_alone) {
  Random random = draws_of_this_test();
  for (int draw = 0; draw < 100; ++draw) {
    const Matrix3d R = rotation_from_vector(random.uniform(0, kPi) * random_direction(random));
    EXPECT_LT((nearest_rotation(R) - R).cwiseAbs().maxCoeff(), 1e-14);
    Matrix3d M;
    for (double& entry : M.reshaped()) entry = random.normal();
    EXPECT_LT(off_rotation(nearest_rotation(M)), 1e-13);
  }
}

TEST(Rotation, no_rotation_tried_is_nearer_than_the_nearest_one) {
  Random random = draws_of_this_test();
  for (int draw = 0; draw < 100; ++draw) {
    Matrix3d M;
    for (double& entry : M.reshaped()) entry = random.normal();
    const Matrix3d R = nearest_rotation(M);
    for (int trial = 0; trial < 20; ++trial) {
      const Matrix3d other = rotation_from_vector(0.05 * random_direction(random)) * R;
      EXPECT_GE((M - other).norm(), (M - R).norm() - 1e-12);
    }
  }
}

TEST(Rotation, nearest_rotation_from_rows_is_the_nearest_rotation_of_its_rows) {
  Random random = draws_of_this_test();
  for (int draw = 0; draw < 200; ++draw) {
    const Vector3d i = random_direction(random);
    const Vector3d j = random_direction(random);
    if (i.cross(j).norm() < 0.05) continue;
    Matrix3d M;
    M << i.transpose(), j.transpose(), i.cross(j).transpose();
    EXPECT_LT((nearest_rotation_from_rows(i, j) - nearest_rotation(M)).cwiseAbs().maxCoeff(),
              1e-12);
  }
  EXPECT_FALSE(nearest_rotation_from_rows(Vector3d::UnitX(), Vector3d::UnitX()).allFinite());
}

TEST(Rotation, geodesic_angle_is_exact_near_zero_and_near_pi) {
  Random random = draws_of_this_test();
  for (const double angle : {0.0, 1e-12, 1e-8, 1e-3, 1.0, 3.0, kPi - 1e-8, kPi}) {
    const Matrix3d R_a = rotation_from_vector(random_direction(random));
    const Matrix3d R_b = R_a * rotation_from_vector(angle * random_direction(random));
    EXPECT_NEAR(geodesic_angle(R_a, R_b), angle, 1e-15 + 1e-7 * (angle > 3.1) + 1e-15 * 4);
    EXPECT_NEAR(geodesic_angle(R_b, R_a), geodesic_angle(R_a, R_b), 1e-15);
  }
}

TEST(Rotation, wrap_keeps_the_upper_end_and_not_the_lower) {
  EXPECT_EQ(wrap(180.0, 360.0), 180.0);
  EXPECT_EQ(wrap(-180.0, 360.0), 180.0);
  EXPECT_EQ(wrap(540.0, 360.0), 180.0);
  EXPECT_EQ(wrap(-540.0, 360.0), 180.0);
  EXPECT_EQ(wrap(359.0, 360.0), -1.0);
  EXPECT_EQ(wrap(-359.0, 360.0), 1.0);
  EXPECT_EQ(wrap(0.0, 360.0), 0.0);
  EXPECT_EQ(wrap(-90.0, 360.0), -90.0);
}

}  // namespace
}  // namespace turntable
