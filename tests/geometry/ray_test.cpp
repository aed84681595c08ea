#include "src/geometry/ray.h"

#include <gtest/gtest.h>

#include "tests/support/draws.h"

namespace turntable {
namespace {

constexpr RayPlanes kPlanes{130.0, 180.0};

TEST(Ray, passes_through_its_points_on_both_planes) {
  const Ray ray{{1.0, 2.0}, {3.0, -4.0}};
  EXPECT_EQ(ray.at(130.0, kPlanes), ray.at_a);
  EXPECT_LT((ray.at(180.0, kPlanes) - ray.at_b).norm(), 1e-14);
  EXPECT_LT((ray.at(155.0, kPlanes) - Vector2d(2.0, -1.0)).norm(), 1e-14);
  EXPECT_LT((ray.slope(kPlanes) - Vector2d(0.04, -0.12)).norm(), 1e-16);
}

TEST(Ray, distance_is_perpendicular) {
  Random random = draws_of_this_test();
  for (int draw = 0; draw < 100; ++draw) {
    const auto coordinate = [&] { return random.uniform(-100, 100); };
    const Ray ray{{coordinate(), coordinate()}, {coordinate(), coordinate()}};
    const Vector3d point(coordinate(), coordinate(), coordinate());
    const Vector3d on_a(ray.at_a.x(), ray.at_a.y(), kPlanes.a_mm);
    const Vector3d on_b(ray.at_b.x(), ray.at_b.y(), kPlanes.b_mm);
    const double want = (point - on_a).cross((on_b - on_a).normalized()).norm();
    EXPECT_NEAR(distance_mm(point, ray, kPlanes), want, 1e-10);
  }
}

TEST(Ray, a_point_on_the_ray_has_no_distance) {
  const Ray ray{{10.0, 20.0}, {-15.0, 27.0}};
  for (const double z : {0.0, 130.0, 500.0}) {
    const Vector2d at = ray.at(z, kPlanes);
    EXPECT_LT(distance_mm({at.x(), at.y(), z}, ray, kPlanes), 1e-12);
  }
}

}  // namespace
}  // namespace turntable
