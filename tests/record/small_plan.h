// Four poses: a plane and a view of the pattern, a reference and an attitude of the target.
#pragma once

#include "src/record/plan.h"

namespace turntable {

inline Plan small_plan() {
  Plan plan;
  plan.name = "small";
  plan.title = "A small plan";
  plan.rig = freeze("rig.json", "{\"any\": \"text\"}\n");
  plan.sources = {freeze("motion.json", "{}")};
  plan.scenarios = {
      {"sweep", "Sweep", "sweep.json", ScenarioKind::kCalibration, std::nullopt, 4, 1, {}},
      {"motion", "Motion", "motion.json", ScenarioKind::kAttitude, 3, 5, 1, {AxisId::kYaw}}};
  PlannedPose pose;
  pose.scenario = 1;
  pose.stage_mm = 120;
  pose.role = PoseRole::kReference;
  plan.poses.push_back(pose);
  pose.role = PoseRole::kMeasure;
  pose.yaw_deg = 0.1 + 0.2;
  pose.point = 1;
  pose.dwell_s = 0.25;
  plan.poses.push_back(pose);
  PlannedPose plane;
  plane.payload = Payload::kCirclePattern;
  plane.role = PoseRole::kPlaneFit;
  plane.stage_mm = 130;
  plane.images = 2;
  plan.poses.push_back(plane);
  plane.role = PoseRole::kPinholeView;
  plane.pitch_deg = -25;
  plan.poses.push_back(plane);
  number_poses(plan);
  return plan;
}

}  // namespace turntable
