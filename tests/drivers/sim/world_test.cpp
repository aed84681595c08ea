#include "drivers/sim/world.h"

#include <gtest/gtest.h>

#include <cmath>

#include "drivers/sim/camera.h"
#include "src/core/errors.h"
#include "tests/support/simulated_view.h"

namespace turntable {
namespace {

TEST(World, PatternAtBasePositionIsThePlaneFrame) {
  SimulatedView view(shipped_rig("simulated"));
  view.stand(0, 0, 0, 0);
  view.world().mount(Payload::kCirclePattern);
  const sim::World::Pose pose = view.world().payload_pose();
  const Vector3d camera = -pose.R_camera_from_payload.transpose() * pose.origin_in_camera;
  EXPECT_LT((camera - view.rig().simulation->camera_position_mm).norm(), 1e-9);
}

TEST(World, StageCarriesThePayloadTowardsTheCamera) {
  SimulatedView view(shipped_rig("ideal"));
  view.stand(0, 0, 0, 0);
  const double far = view.world().payload_pose().origin_in_camera.z();
  view.stand(100, 0, 0, 0);
  EXPECT_NEAR(far - view.world().payload_pose().origin_in_camera.z(), 100, 0.01);
}

TEST(World, PositiveYawTurnsXTowardsYInThePlaneFrame) {
  SimulatedView view(shipped_rig("ideal"));
  view.world().mount(Payload::kCirclePattern);
  view.stand(120, 0, 0, 0);
  const Matrix3d R0 = view.world().payload_pose().R_camera_from_payload;
  view.stand(120, 90, 0, 0);
  const Matrix3d R = R0.transpose() * view.world().payload_pose().R_camera_from_payload;
  EXPECT_LT((R * Vector3d::UnitX() - Vector3d::UnitY()).norm(), 1e-12);
}

TEST(World, TurnsAboutAxesThatAreNotAtRightAngles) {
  RigFile rig = shipped_rig("ideal");
  rig.simulation->axis_errors_deg[1] = Vector3d(0.5, 0, 0);  // roll: y leans towards z
  SimulatedView view(rig);
  view.world().mount(Payload::kCirclePattern);
  view.stand(120, 0, 0, 0);
  const Matrix3d R0 = view.world().payload_pose().R_camera_from_payload;
  view.stand(120, 0, 20, 0);
  const Vector3d turn =
      vector_from_rotation(R0.transpose() * view.world().payload_pose().R_camera_from_payload);
  const Vector3d axis(0, std::cos(0.5 / kDegPerRad), std::sin(0.5 / kDegPerRad));
  EXPECT_LT((turn.normalized() - axis).norm(), 1e-9);
}

TEST(World, StageTravelsByItsRealScale) {
  RigFile rig = shipped_rig("ideal");
  rig.simulation->stage_scale = 1.01;
  rig.simulation->camera_rotation_deg.setZero();
  SimulatedView view(rig);
  view.stand(0, 0, 0, 0);
  const double far = view.world().payload_pose().origin_in_camera.z();
  view.stand(100, 0, 0, 0);
  EXPECT_NEAR(far - view.world().payload_pose().origin_in_camera.z(), 101, 1e-9);
}

TEST(Renderer, GivesTheSameImageForTheSameFrameAndAnotherForTheNext) {
  SimulatedView one(shipped_rig("simulated")), two(shipped_rig("simulated"));
  one.stand(120, 10, 5, -5);
  two.stand(120, 10, 5, -5);
  const Image first = one.look(Payload::kLedTarget);
  EXPECT_EQ(first.pixels, two.look(Payload::kLedTarget).pixels);
  EXPECT_NE(first.pixels, one.look(Payload::kLedTarget).pixels);
}

TEST(Renderer, ReachesTheGreyValuesAndTheNoiseOfTheRigFile) {
  SimulatedView view(shipped_rig("simulated"));
  view.stand(120, 0, 0, 0);
  const Image image = view.look(Payload::kLedTarget);
  double sum = 0, sum2 = 0;
  for (int v = 0; v < 200; ++v)
    for (int u = 0; u < 200; ++u) {
      const double g = image.pixels[static_cast<std::size_t>(v * image.width + u)];
      sum += g;
      sum2 += g * g;
    }
  const double mean = sum / 40000, sd = std::sqrt(sum2 / 40000 - mean * mean);
  EXPECT_NEAR(mean, 12.0, 0.05);
  // read noise, shot noise of the ground and rounding
  EXPECT_NEAR(sd, std::sqrt(1.2 * 1.2 + 12.0 / 40 + 1.0 / 12), 0.03);
  EXPECT_NEAR(*std::ranges::max_element(image.pixels), 200, 15);
}

TEST(SimulatedCamera, CountsFramesAndSaysWhenOneIsLost) {
  const RigFile rig = shipped_rig("simulated");
  sim::World world(rig, [](AxisId) { return 0.0; });
  world.mount(Payload::kLedTarget);
  ManualClock clock;
  sim::SimulatedCamera camera(clock, world, 0.5, {{1}});
  EXPECT_EQ(camera.trigger().id, 0u);
  const Time before = clock.now();
  EXPECT_THROW(camera.trigger(), TimeoutError);
  EXPECT_NEAR(seconds(clock.now() - before), 0.5, 1e-9);
  EXPECT_EQ(camera.trigger().id, 2u);
}

}  // namespace
}  // namespace turntable
