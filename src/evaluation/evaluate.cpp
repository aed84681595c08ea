#include "src/evaluation/evaluate.h"

#include <fmt/format.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <limits>
#include <map>
#include <optional>

#include "src/core/errors.h"
#include "src/core/parallel.h"
#include "src/core/units.h"
#include "src/evaluation/attitude_sensor.h"
#include "src/evaluation/measure_spots.h"
#include "src/record/csv.h"
#include "src/vision/matching.h"

namespace turntable {
namespace {

GimbalAngles degrees(const GimbalAngles& rad) {
  return {deg_from_rad(rad.yaw), deg_from_rad(rad.roll), deg_from_rad(rad.pitch)};
}

/// Everything about the rig and the camera that is the same for every pose.
struct Setting {
  const RunFolder& folder;
  const RigFile& rig;
  const Calibration& calibration;
  const EvaluateOptions& options;
  Gimbal gimbal;
  TargetModel target;
  double gate_mm;
};

SpotList spots_of(const TakenPose& pose, std::size_t k, const Setting& s) {
  if (s.options.spots_of) return s.options.spots_of(pose, k);
  const TakenImage& taken = pose.images[k];
  if (s.options.spots == SpotSource::kImages && !taken.file.empty())
    return spots_in(load_calibrated_image(s.folder, taken, s.calibration),
                    s.rig.camera.electrons_per_grey);
  SpotList list;
  if (taken.spots)
    for (const TakenSpot& spot : *taken.spots) {
      list.centres_px.emplace_back(spot.u_px, spot.v_px);
      list.sigmas_px.push_back(spot.sigma_px);
    }
  return list;
}

/// The LEDs of one pose, in the target's order.
struct Sighting {
  std::vector<Vector2d> points_px;
  std::vector<Eigen::Matrix2d> covariances_px2;  ///< none if one of the spots states none
};

/// Spot of every LED, averaged over the images of the pose in which all were matched.
std::optional<Sighting> sighted(const TakenPose& pose, const Setting& s, EvaluatedPose& out,
                                std::string& status) {
  const Matrix3d R = s.gimbal.rotation(pose.angles());
  const Vector3d origin = s.gimbal.centre_mm(pose.stage.position) + R * s.rig.target.offset_mm;
  std::vector<Vector3d> predicted;
  for (const Vector3d& p : s.rig.target.points_mm) predicted.push_back(R * p + origin);

  Sighting sum;
  sum.points_px.assign(predicted.size(), Vector2d::Zero());
  std::vector<double> variances_px2(predicted.size(), 0.0);
  bool stated = true;
  int used = 0;
  for (std::size_t k = 0; k < pose.images.size(); ++k) {
    const SpotList seen = spots_of(pose, k, s);
    if (k == 0) out.spots = static_cast<int>(seen.centres_px.size());
    std::vector<Ray> rays;
    for (const Vector2d& c : seen.centres_px) rays.push_back(s.calibration.irt.ray(c));
    const Match match = match_to_prediction(predicted, rays, s.calibration.irt.planes(), s.gate_mm);
    status = match_status_name(match.status);
    if (match.status != MatchStatus::kMatched) continue;
    for (std::size_t i = 0; i < predicted.size(); ++i) {
      const auto spot = static_cast<std::size_t>(match.ray_of_point[i]);
      sum.points_px[i] += seen.centres_px[spot];
      variances_px2[i] += seen.sigmas_px[spot] * seen.sigmas_px[spot];
      stated = stated && seen.sigmas_px[spot] > 0.0;
    }
    ++used;
  }
  if (used == 0) return std::nullopt;
  for (Vector2d& p : sum.points_px) p /= used;
  if (stated)
    for (const double variance : variances_px2)
      sum.covariances_px2.push_back(variance / (used * used) * Eigen::Matrix2d::Identity());
  return sum;
}

std::vector<const Solver*> chosen_solvers(const Calibration& calibration,
                                          const EvaluateOptions& options) {
  if (!options.solvers.empty()) return options.solvers;
  std::vector<const Solver*> chosen;
  for (const Solver& solver : kSolvers)
    if ((solver.by_default || options.all_solvers) &&
        AttitudeSensor::can_serve(calibration, solver))
      chosen.push_back(&solver);
  return chosen;
}

/// Appends one row per pose and solver. @param before in front of each, if the file has such a column
void add_pose_rows(Csv& csv, const Evaluation& evaluation, const Plan& plan,
                   const std::string* before) {
  constexpr double kNone = std::numeric_limits<double>::quiet_NaN();
  for (const EvaluatedPose& pose : evaluation.poses)
    for (const PoseResult& r : pose.results) {
      const auto if_taken = [&](double x) { return pose.taken ? x : kNone; };
      const auto if_measured = [&](double x) { return r.measured ? x : kNone; };
      if (before != nullptr) csv.text(*before);
      csv.integer(static_cast<std::int64_t>(pose.planned.index)).text(pose.planned.id);
      csv.text(plan.scenario_of(pose.planned).name)
          .integer(pose.planned.repeat)
          .integer(pose.planned.point);
      csv.text(role_name(pose.planned.role)).text(r.solver->name).text(r.status);
      csv.integer(r.measured).integer(pose.in_domain).integer(pose.missed).integer(pose.spots);
      csv.number(if_taken(pose.stage_mm), 5).number(if_taken(pose.read_back_deg.yaw), 5);
      csv.number(if_taken(pose.read_back_deg.roll), 5)
          .number(if_taken(pose.read_back_deg.pitch), 5);
      csv.number(if_measured(r.angles_deg.yaw), 6).number(if_measured(r.angles_deg.roll), 6);
      csv.number(if_measured(r.angles_deg.pitch), 6);
      csv.number(if_measured(r.error.yaw_deg), 6).number(if_measured(r.error.roll_deg), 6);
      csv.number(if_measured(r.error.pitch_deg), 6).number(if_measured(r.error.geodesic_deg), 6);
      csv.integer(r.iterations).number(if_measured(r.residual), 6);
      csv.text(r.solver->sight == Sight::kRays ? "mm" : "px");
      csv.end_row();
    }
}

/// Columns of poses.csv.
const std::vector<std::string> kPoseColumns{"index",
                                            "id",
                                            "scenario",
                                            "repeat",
                                            "point",
                                            "role",
                                            "solver",
                                            "status",
                                            "measured",
                                            "in_domain",
                                            "missed",
                                            "spots",
                                            "stage_mm",
                                            "turntable_yaw_deg",
                                            "turntable_roll_deg",
                                            "turntable_pitch_deg",
                                            "measured_yaw_deg",
                                            "measured_roll_deg",
                                            "measured_pitch_deg",
                                            "error_yaw_deg",
                                            "error_roll_deg",
                                            "error_pitch_deg",
                                            "error_geodesic_deg",
                                            "iterations",
                                            "residual",
                                            "residual_unit"};

}  // namespace

Image load_calibrated_image(const RunFolder& folder, const TakenImage& taken,
                            const Calibration& calibration) {
  Image image = load_image(folder, taken);
  const ImageSize size = calibration.irt.image_size();
  if (image.size() != size)
    throw ConfigError(
        (folder.root() / taken.file).string(), "",
        fmt::format("found {} x {} px, allowed: {} x {} px, the size the camera was calibrated at. "
                    "Calibrate again at this size.",
                    image.width, image.height, size.width, size.height));
  return image;
}

Evaluation evaluate(const RunRecord& record, const RunFolder& folder, const RigFile& rig,
                    const Calibration& calibration, const EvaluateOptions& options) {
  const Setting setting{folder,
                        rig,
                        calibration,
                        options,
                        Gimbal(rig.gimbal),
                        TargetModel(rig.target.points_mm),
                        match_gate_mm(rig.target.points_mm)};
  Evaluation evaluation;
  evaluation.solvers = chosen_solvers(calibration, options);
  std::vector<AttitudeSensor> sensors;
  for (const Solver* solver : evaluation.solvers)
    sensors.emplace_back(calibration, setting.target, *solver);

  std::map<std::string, const TakenPose*> taken_by_id;
  for (const TakenPose& pose : record.poses) taken_by_id[pose.planned.id] = &pose;
  std::vector<const TakenPose*> taken;
  for (const PlannedPose& planned : record.plan.poses) {
    if (record.plan.scenario_of(planned).kind != ScenarioKind::kAttitude) continue;
    if (options.scenario && planned.scenario != *options.scenario) continue;
    const auto it = taken_by_id.find(planned.id);
    taken.push_back(it == taken_by_id.end() ? nullptr : it->second);
    EvaluatedPose& pose = evaluation.poses.emplace_back();
    pose.planned = planned;
  }

  // First every attitude by itself, on all cores; then, in order, relative to the initial poses.
  std::vector<std::vector<MeasuredAttitude>> attitudes(taken.size());
  std::vector<std::string> why_not(taken.size());  ///< no spots for any solver; empty if there are
  std::atomic<std::size_t> done{0};
  parallel_for(taken.size(), [&](std::size_t i) {
    EvaluatedPose& pose = evaluation.poses[i];
    attitudes[i].resize(sensors.size());
    if (taken[i] == nullptr) {
      why_not[i] = "not taken";
    } else {
      pose.taken = true;
      pose.missed = taken[i]->missed();
      pose.stage_mm = taken[i]->stage.position;
      pose.read_back_deg = degrees(taken[i]->angles());
      std::string status = "no image";
      if (auto seen = sighted(*taken[i], setting, pose, status)) {
        pose.in_domain = std::ranges::all_of(
            seen->points_px, [&](const Vector2d& p) { return calibration.irt.in_domain(p); });
        for (std::size_t k = 0; k < sensors.size(); ++k)
          attitudes[i][k] = sensors[k].measure(seen->points_px, seen->covariances_px2);
        pose.points_px = std::move(seen->points_px);
        pose.covariances_px2 = std::move(seen->covariances_px2);
      } else {
        why_not[i] = status;
      }
    }
    if (options.progress) options.progress(++done, taken.size());
  });

  const std::vector<std::optional<std::size_t>> initial = initial_poses(evaluation);
  for (std::size_t i = 0; i < evaluation.poses.size(); ++i) {
    EvaluatedPose& pose = evaluation.poses[i];
    for (std::size_t k = 0; k < evaluation.solvers.size(); ++k) {
      const MeasuredAttitude& attitude = attitudes[i][k];
      PoseResult result;
      result.solver = evaluation.solvers[k];
      result.status = why_not[i].empty() ? status_name(attitude.status) : why_not[i];
      result.iterations = attitude.iterations;
      result.residual = attitude.residual;
      if (attitude.has_attitude()) {
        const bool referenced = initial[i].has_value() && attitudes[*initial[i]][k].has_attitude();
        if (referenced) {
          const TakenPose& at_start = *taken[*initial[i]];
          const Matrix3d R_measured = relative_attitude(
              attitude.R_plane_from_target, attitudes[*initial[i]][k].R_plane_from_target);
          const Matrix3d R_true = relative_attitude(setting.gimbal.rotation(taken[i]->angles()),
                                                    setting.gimbal.rotation(at_start.angles()));
          result.measured = true;
          result.angles_deg = degrees(setting.gimbal.angles(R_measured));
          result.error = pose_error(setting.gimbal, R_measured, R_true);
        } else {
          result.status = "initial pose not measured";
        }
      }
      pose.results.push_back(std::move(result));
    }
  }
  return evaluation;
}

std::vector<std::optional<std::size_t>> initial_poses(const Evaluation& evaluation) {
  std::map<std::pair<std::size_t, int>, std::size_t> reference;  // (scenario, repeat) -> place
  for (std::size_t i = 0; i < evaluation.poses.size(); ++i)
    if (const PlannedPose& p = evaluation.poses[i].planned; p.role == PoseRole::kReference)
      reference[{p.scenario, p.repeat}] = i;
  std::vector<std::optional<std::size_t>> out;
  for (const EvaluatedPose& pose : evaluation.poses) {
    const auto found = reference.find({pose.planned.scenario, pose.planned.repeat});
    out.push_back(found == reference.end() ? std::nullopt : std::optional(found->second));
  }
  return out;
}

std::vector<RepeatStatistics> repeat_statistics(const Evaluation& evaluation) {
  std::vector<RepeatStatistics> out;
  std::map<std::pair<std::size_t, int>, std::vector<const EvaluatedPose*>> groups;
  for (const EvaluatedPose& pose : evaluation.poses)
    if (pose.planned.role == PoseRole::kMeasure)
      groups[{pose.planned.scenario, pose.planned.repeat}].push_back(&pose);
  for (const auto& [key, poses] : groups)
    for (std::size_t k = 0; k < evaluation.solvers.size(); ++k) {
      std::vector<PoseError> errors;
      RepeatStatistics row;
      row.scenario = key.first;
      row.repeat = key.second;
      row.solver = evaluation.solvers[k];
      for (const EvaluatedPose* pose : poses) {
        if (!pose->results[k].measured) continue;
        errors.push_back(pose->results[k].error);
        if (!pose->in_domain) ++row.outside_domain;
      }
      row.statistics = error_statistics(errors, poses.size() - errors.size());
      out.push_back(row);
    }
  return out;
}

std::size_t failed_results(const Evaluation& evaluation) {
  std::size_t failed = 0;
  for (const EvaluatedPose& pose : evaluation.poses)
    failed +=
        (pose.missed ? 1 : 0) + static_cast<std::size_t>(std::ranges::count_if(
                                    pose.results, [](const PoseResult& r) { return !r.measured; }));
  return failed;
}

void write_poses_csv(const Evaluation& evaluation, const Plan& plan,
                     const std::filesystem::path& file) {
  Csv csv(kPoseColumns);
  add_pose_rows(csv, evaluation, plan, nullptr);
  csv.write(file);
}

void write_poses_csv(const std::string& column, const std::vector<EvaluationVariant>& variants,
                     const Plan& plan, const std::filesystem::path& file) {
  std::vector<std::string> header{column};
  header.insert(header.end(), kPoseColumns.begin(), kPoseColumns.end());
  Csv csv(header);
  for (const EvaluationVariant& v : variants) add_pose_rows(csv, *v.evaluation, plan, &v.value);
  csv.write(file);
}

}  // namespace turntable
