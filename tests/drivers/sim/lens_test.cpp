#include "drivers/sim/lens.h"

#include <gtest/gtest.h>

#include "src/core/random.h"

namespace turntable::sim {
namespace {

LensTruth awkward_lens() {
  LensTruth truth;
  truth.focal_px = 1945;
  truth.principal_point_px = {517, 508};
  truth.radial = {-0.08, 0.15, -0.05};
  truth.decentring = {0.001, -0.0007};
  truth.sensor_tilt_deg = {0.6, -0.4};
  truth.pupil_walk_mm_per_rad2 = 30;
  return truth;
}

TEST(Lens, RayOfAPixelPassesThroughEveryPointThatProjectsThere) {
  const Lens lens(awkward_lens());
  Random random(1, "Lens.RayOfAPixelPassesThroughEveryPointThatProjectsThere");
  for (int i = 0; i < 500; ++i) {
    const Vector2d pixel(random.uniform(0, 1023), random.uniform(0, 1023));
    const CameraRay ray = lens.ray(pixel);
    for (const double along : {100.0, 520.0, 2000.0}) {
      const Vector3d point =
          Vector3d(0, 0, ray.pupil_mm) + along * Vector3d(ray.tangent.x(), ray.tangent.y(), 1.0);
      EXPECT_LT((lens.project(point) - pixel).norm(), 1e-8);
    }
  }
}

TEST(Lens, WithoutAberrationsIsAPinhole) {
  LensTruth truth;
  truth.focal_px = 1000;
  truth.principal_point_px = {500, 400};
  const Vector2d pixel = Lens(truth).project({10, -20, 200});
  EXPECT_NEAR(pixel.x(), 550, 1e-12);
  EXPECT_NEAR(pixel.y(), 300, 1e-12);
}

TEST(Lens, WalkingPupilMakesTheBundleNonCentral) {
  const Lens lens(awkward_lens());
  EXPECT_NEAR(lens.ray({517, 508}).pupil_mm, 0.0, 1e-9);
  EXPECT_GT(lens.ray({1000, 900}).pupil_mm, 1.0);
}

}  // namespace
}  // namespace turntable::sim
