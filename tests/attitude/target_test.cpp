#include "src/attitude/target.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <limits>
#include <stdexcept>
#include <vector>

#include "tests/attitude/problems.h"
#include "tests/support/draws.h"

namespace turntable {
namespace {

using ::testing::HasSubstr;

TEST(Target, refuses_fewer_than_four_points_and_says_how_many_there_are) {
  std::vector<Vector3d> points = problems::published_target();
  points.pop_back();
  EXPECT_THAT(TargetModel::refusal(points), HasSubstr("at least four points"));
  EXPECT_THAT(TargetModel::refusal(points), HasSubstr("3 given"));
  EXPECT_THAT(TargetModel::refusal({}), HasSubstr("0 given"));
  EXPECT_THROW(TargetModel{points}, std::invalid_argument);
}

TEST(Target, knows_coplanar_points_in_any_position_and_their_normal) {
  Random random = draws_of_this_test();
  std::vector<Vector3d> square{{0, 0, 0}, {50, 0, 0}, {50, 50, 0}, {0, 50, 0}, {25, 10, 0}};
  const Matrix3d R = problems::random_rotation(random, 180);
  for (Vector3d& p : square) p = R * p + Vector3d(3, -70, 11);
  const TargetModel plane(square);
  EXPECT_TRUE(plane.coplanar());
  EXPECT_NEAR(std::abs(plane.normal().dot(R.col(2))), 1.0, 1e-12);
  // Of rank 2: it recovers what lies in the plane and knows nothing of the normal.
  const Matrix3d HG = plane.pseudo_inverse() * plane.vectors().transpose();
  EXPECT_LT((HG - (Matrix3d::Identity() - R.col(2) * R.col(2).transpose())).norm(), 1e-12);
  square[2] += R * Vector3d(0, 0, 30);
  EXPECT_FALSE(TargetModel(square).coplanar());
}

TEST(Target, refuses_points_that_coincide_or_lie_on_a_line) {
  const std::vector<Vector3d> same(4, Vector3d(1, 2, 3));
  EXPECT_THAT(TargetModel::refusal(same), HasSubstr("one line"));
  const std::vector<Vector3d> line{{0, 0, 0}, {1, 1, 1}, {2, 2, 2}, {3, 3, 3}};
  EXPECT_THAT(TargetModel::refusal(line), HasSubstr("one line"));
}

TEST(Target, refuses_nan_and_too_many_points) {
  std::vector<Vector3d> points = problems::published_target();
  points[2].y() = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THAT(TargetModel::refusal(points), HasSubstr("point 2"));
  points[2].y() = std::numeric_limits<double>::infinity();
  EXPECT_THAT(TargetModel::refusal(points), HasSubstr("point 2"));
  Random random = draws_of_this_test();
  EXPECT_EQ(TargetModel::refusal(problems::random_target(random, kMaxTargetPoints)), "");
  EXPECT_THAT(TargetModel::refusal(std::vector<Vector3d>(kMaxTargetPoints + 1)),
              HasSubstr("up to 32"));
}

TEST(Target, pseudo_inverse_recovers_any_vector_from_its_products) {
  Random random = draws_of_this_test();
  for (const int n : {4, 5, 16, 32}) {
    const TargetModel target(problems::random_target(random, n));
    ASSERT_EQ(target.size(), n);
    const Matrix3d HG = target.pseudo_inverse() * target.vectors().transpose();
    EXPECT_LT((HG - Matrix3d::Identity()).cwiseAbs().maxCoeff(), 1e-13);
  }
}

TEST(Target, vectors_start_at_the_first_point_wherever_it_lies) {
  std::vector<Vector3d> points = problems::published_target();
  const TargetModel at_origin(points);
  for (Vector3d& p : points) p += Vector3d(100, -20, 5);
  const TargetModel shifted(points);
  EXPECT_LT((shifted.vectors() - at_origin.vectors()).cwiseAbs().maxCoeff(), 1e-12);
  EXPECT_NEAR(shifted.radius_mm(), at_origin.radius_mm(), 1e-12);
}

}  // namespace
}  // namespace turntable
