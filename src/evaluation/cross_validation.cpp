#include "src/evaluation/cross_validation.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <optional>

#include "src/core/errors.h"
#include "src/core/parallel.h"
#include "src/core/random.h"
#include "src/core/units.h"
#include "src/evaluation/attitude_sensor.h"

namespace turntable {
namespace {

/// A sighting that is judged, and the one it is relative to; indices into the sightings.
struct Judged {
  std::size_t pose = 0, initial = 0;
};

struct Scene {
  const Plan& plan;
  const RigFile& rig;
  const Calibration& calibration;
  const Evaluation& evaluation;
  const RigModel& model;
  const RigSightings& sightings;
  const SelfCalibration& whole;
  Gimbal gimbal;
  std::vector<Judged> judged = {};

  const EvaluatedPose& evaluated(std::size_t sighting) const {
    return evaluation.poses[sightings.places[sighting]];
  }
  const GimbalAngles& angles(std::size_t sighting) const {
    return sightings.poses[sighting].at.angles;
  }
};

std::vector<Judged> judged_poses(const Scene& s) {
  std::map<std::pair<std::size_t, int>, std::size_t> initial;
  for (std::size_t k = 0; k < s.sightings.poses.size(); ++k) {
    const PlannedPose& planned = s.evaluated(k).planned;
    if (planned.role == PoseRole::kReference) initial[{planned.scenario, planned.repeat}] = k;
  }
  std::vector<Judged> out;
  for (std::size_t k = 0; k < s.sightings.poses.size(); ++k) {
    const PlannedPose& planned = s.evaluated(k).planned;
    const auto found = initial.find({planned.scenario, planned.repeat});
    if (planned.role == PoseRole::kMeasure && found != initial.end())
      out.push_back({k, found->second});
  }
  return out;
}

/// Fold of each sighting; whole arrivals of the outermost axis that its scenario turns.
std::vector<int> deal_folds(const Scene& s, int& folds, std::size_t& groups) {
  std::map<std::pair<std::size_t, int>, std::size_t> group_of;
  std::vector<std::size_t> group(s.sightings.poses.size());
  for (std::size_t k = 0; k < group.size(); ++k) {
    std::size_t outermost = kAllAxes.size() - 1;
    for (const AxisId axis : s.plan.scenario_of(s.evaluated(k).planned).axes)
      if (axis != AxisId::kStage) {
        outermost = static_cast<std::size_t>(std::ranges::find(kAllAxes, axis) - kAllAxes.begin());
        break;
      }
    const std::pair key(outermost, s.sightings.poses[k].arrivals[outermost]);
    group[k] = group_of.emplace(key, group_of.size()).first->second;
  }
  groups = group_of.size();
  folds = std::min(kFolds, static_cast<int>(groups));
  std::vector<std::size_t> order(groups);
  for (std::size_t g = 0; g < groups; ++g) order[g] = g;
  for (std::size_t g = groups; g > 1; --g)  // Fisher-Yates
    std::swap(order[g - 1],
              order[static_cast<std::size_t>(Random(1, "cross-validation folds", g).uniform() *
                                             static_cast<double>(g))]);
  std::vector<int> fold_of_group(groups);
  for (std::size_t g = 0; g < groups; ++g)
    fold_of_group[order[g]] = static_cast<int>(g % static_cast<std::size_t>(folds));
  std::vector<int> out(group.size());
  for (std::size_t k = 0; k < group.size(); ++k) out[k] = fold_of_group[group[k]];
  return out;
}

using Attitudes = std::vector<std::optional<Matrix3d>>;  ///< by sighting; nothing if there is none

/// @param wanted which sightings
Attitudes measure(const Scene& s, const AttitudeSensor& sensor, const std::vector<bool>& wanted) {
  Attitudes out(wanted.size());
  constexpr std::size_t kChunk = 64;
  parallel_for((wanted.size() + kChunk - 1) / kChunk, [&](std::size_t chunk) {
    const std::size_t end = std::min(wanted.size(), (chunk + 1) * kChunk);
    for (std::size_t k = chunk * kChunk; k < end; ++k) {
      if (!wanted[k]) continue;
      const EvaluatedPose& pose = s.evaluated(k);
      const MeasuredAttitude a = sensor.measure(pose.points_px, pose.covariances_px2);
      if (a.has_attitude()) out[k] = a.R_plane_from_target;
    }
  });
  return out;
}

/// Errors of judged poses at one level, by place in `judged`; nothing where there is no attitude.
using Errors = std::vector<std::optional<PoseError>>;

template <class Truth>  // Judged -> R_rel
void take_errors(const Scene& s, const Attitudes& attitudes, const std::vector<int>& fold_of,
                 int fold, const Truth& truth, Errors& out) {
  for (std::size_t j = 0; j < s.judged.size(); ++j) {
    const Judged& at = s.judged[j];
    if (fold_of[at.pose] != fold || !attitudes[at.pose] || !attitudes[at.initial]) continue;
    out[j] = pose_error(s.gimbal, relative_attitude(*attitudes[at.pose], *attitudes[at.initial]),
                        truth(at));
  }
}

/// d Euler / d delta at R for exp(delta) R, by order of pitch, roll, yaw.
Matrix3d euler_slope(const Gimbal& gimbal, const Matrix3d& R) {
  constexpr double kStep = 1e-6;
  Matrix3d E;
  for (int c = 0; c < 3; ++c) {
    const GimbalAngles above = gimbal.angles(rotation_from_vector(kStep * Vector3d::Unit(c)) * R);
    const GimbalAngles below = gimbal.angles(rotation_from_vector(-kStep * Vector3d::Unit(c)) * R);
    E.col(c) << above.pitch - below.pitch, above.roll - below.roll, above.yaw - below.yaw;
  }
  return E / (2 * kStep);
}

/// Axis about which each of kRotaryAxes turns the table as it stands, plane frame.
std::array<Vector3d, 3> axes_now(const Gimbal& gimbal, const GimbalAngles& at) {
  constexpr double kStep = 1e-5;
  std::array<Vector3d, 3> out;
  for (std::size_t i = 0; i < 3; ++i) {
    GimbalAngles above = at, below = at;
    above[kRotaryAxes[i]] += kStep;
    below[kRotaryAxes[i]] -= kStep;
    out[i] = vector_from_rotation(gimbal.rotation(above) * gimbal.rotation(below).transpose()) /
             (2 * kStep);
  }
  return out;
}

std::vector<LevelBound> bounds(const Scene& s) {
  const RigParameters found = s.model.named(s.whole.values);
  const TargetModel target(found.target_points_mm);
  const Calibration camera = s.model.camera(s.whole.values, s.calibration);
  const AttitudeSensor sensor(camera, target, default_solver());
  const Gimbal real = s.model.gimbal(s.whole.values);
  // Spots that state no noise have what the campaign says of it.
  const double noise = s.sightings.noise_stated ? 1.0 : kAssumedSpotSigmaPx * s.whole.noise_factor;
  std::vector<Matrix3d> C(s.sightings.poses.size());
  parallel_for(C.size(), [&](std::size_t k) {
    const EvaluatedPose& pose = s.evaluated(k);
    const std::vector<Eigen::Matrix2d> covariances =
        s.sightings.noise_stated
            ? pose.covariances_px2
            : std::vector<Eigen::Matrix2d>(pose.points_px.size(),
                                           noise * noise * Eigen::Matrix2d::Identity());
    C[k] = sensor.measure(pose.points_px, covariances).covariance.topLeftCorner<3, 3>();
  });

  struct Sum {
    std::size_t poses = 0;
    Vector3d noise = Vector3d::Zero(), with_arrivals = Vector3d::Zero();
  };
  std::map<std::size_t, Sum> sums;
  for (const Judged& at : s.judged) {
    const Matrix3d R_0 = real.rotation(s.angles(at.initial));
    const Matrix3d R = real.rotation(s.angles(at.pose)) * R_0.transpose();
    const Matrix3d E = kDegPerRad * euler_slope(s.gimbal, R);
    const Matrix3d C_rel = C[at.pose] + R * C[at.initial] * R.transpose();
    if (!C_rel.allFinite()) continue;
    const auto u = axes_now(real, s.angles(at.pose)), u_0 = axes_now(real, s.angles(at.initial));
    Matrix3d arrivals = Matrix3d::Zero();
    for (std::size_t i = 0; i < 3; ++i) {
      const auto a =
          static_cast<std::size_t>(std::ranges::find(kAllAxes, kRotaryAxes[i]) - kAllAxes.begin());
      const double sd = rad_from_deg(s.model.arrival_sd()[a]);
      const Vector3d now = sd * u[i], then = sd * R * u_0[i];
      if (s.sightings.poses[at.pose].arrivals[a] == s.sightings.poses[at.initial].arrivals[a])
        arrivals += (now - then) * (now - then).transpose();
      else
        arrivals += now * now.transpose() + then * then.transpose();
    }
    Sum& sum = sums[s.evaluated(at.pose).planned.scenario];
    ++sum.poses;
    sum.noise += (E * C_rel * E.transpose()).diagonal();
    sum.with_arrivals += (E * (C_rel + arrivals) * E.transpose()).diagonal();
  }
  std::vector<LevelBound> out;
  for (const auto& [scenario, sum] : sums) {
    const Vector3d rms = (sum.noise / static_cast<double>(sum.poses)).cwiseSqrt();
    LevelBound& row = out.emplace_back();
    row.scenario = scenario;
    row.poses = sum.poses;
    row.pitch_deg = rms(0);
    row.roll_deg = rms(1);
    row.yaw_deg = rms(2);
    row.total_deg = rms.norm();
    row.total_with_repeatability_deg =
        std::sqrt(sum.with_arrivals.sum() / static_cast<double>(sum.poses));
    for (const EvaluatedPose& pose : s.evaluation.poses)
      if (pose.planned.scenario == scenario && pose.planned.role == PoseRole::kMeasure)
        ++row.left_out;
    row.left_out -= sum.poses;
  }
  return out;
}

}  // namespace

CrossValidation cross_validate(const Plan& plan, const RigFile& rig, const Calibration& calibration,
                               const Evaluation& evaluation, const RigModel& model,
                               const RigSightings& sightings, const SelfCalibration& whole) {
  Scene s{plan, rig, calibration, evaluation, model, sightings, whole, Gimbal(rig.gimbal)};
  s.judged = judged_poses(s);
  CrossValidation out;
  const std::vector<int> fold_of = deal_folds(s, out.folds, out.groups);
  if (out.folds < 2 || s.judged.empty())
    throw Error(
        "there are not two arrivals of an axis with poses to judge, and cross-validation holds "
        "some "
        "out while it uses the others. Take more poses.");

  const std::size_t n = sightings.poses.size(), solvers = evaluation.solvers.size();
  const TargetModel drawn(rig.target.points_mm);
  std::vector<Attitudes> as_drawn;
  for (const Solver* solver : evaluation.solvers)
    as_drawn.push_back(
        measure(s, AttitudeSensor(calibration, drawn, *solver), std::vector<bool>(n, true)));

  std::array<std::vector<Errors>, std::size(kTruthLevels)> errors;  // by level, solver
  for (auto& level : errors) level.assign(solvers, Errors(s.judged.size(), std::nullopt));
  for (int fold = 0; fold < out.folds; ++fold) {
    std::vector<std::size_t> used;
    std::vector<bool> needed(n, false);
    for (std::size_t k = 0; k < n; ++k)
      if (fold_of[k] != fold) used.push_back(k);
    for (const Judged& at : s.judged)
      if (fold_of[at.pose] == fold) needed[at.pose] = needed[at.initial] = true;
    const Eigen::VectorXd values = recalibrate(model, sightings, used, whole);
    const TargetModel target(model.named(values).target_points_mm);
    const Calibration camera = model.camera(values, calibration);
    const Gimbal real = model.gimbal(values);
    const auto relative = [&](const Gimbal& gimbal, const Judged& at) {
      return relative_attitude(gimbal.rotation(s.angles(at.pose)),
                               gimbal.rotation(s.angles(at.initial)));
    };
    for (std::size_t i = 0; i < solvers; ++i) {
      const auto published = [&](const Judged& at) { return relative(s.gimbal, at); };
      take_errors(s, as_drawn[i], fold_of, fold, published, errors[0][i]);

      std::vector<Matrix3d> measured, turned;
      for (const std::size_t k : used)
        if (as_drawn[i][k]) {
          measured.push_back(*as_drawn[i][k]);
          turned.push_back(s.gimbal.rotation(s.angles(k)));
        }
      const Matrix3d X = align(measured, turned).X;
      const auto aligned = [&](const Judged& at) -> Matrix3d {
        return X * relative(s.gimbal, at) * X.transpose();
      };
      take_errors(s, as_drawn[i], fold_of, fold, aligned, errors[1][i]);

      const AttitudeSensor sensor(camera, target, *evaluation.solvers[i]);
      const auto calibrated = [&](const Judged& at) { return relative(real, at); };
      take_errors(s, measure(s, sensor, needed), fold_of, fold, calibrated, errors[2][i]);
    }
  }

  out.bounds = bounds(s);
  for (const LevelBound& bound : out.bounds)
    for (std::size_t i = 0; i < solvers; ++i)
      for (std::size_t level = 0; level < errors.size(); ++level) {
        std::vector<PoseError> taken;
        std::size_t failed = 0;
        for (std::size_t j = 0; j < s.judged.size(); ++j) {
          if (s.evaluated(s.judged[j].pose).planned.scenario != bound.scenario) continue;
          if (errors[level][i][j])
            taken.push_back(*errors[level][i][j]);
          else
            ++failed;
        }
        out.rows.push_back({bound.scenario, evaluation.solvers[i], kTruthLevels[level],
                            error_statistics(taken, failed)});
      }
  for (const Judged& at : s.judged) out.poses.push_back(sightings.places[at.pose]);
  out.errors = std::move(errors);
  return out;
}

Evaluation at_level(const Evaluation& evaluation, const CrossValidation& judged, TruthLevel level) {
  const auto& errors = judged.errors[static_cast<std::size_t>(level)];
  std::vector<std::size_t> place_of(evaluation.poses.size(), judged.poses.size());
  for (std::size_t j = 0; j < judged.poses.size(); ++j) place_of[judged.poses[j]] = j;
  Evaluation out;
  out.solvers = evaluation.solvers;
  for (std::size_t i = 0; i < evaluation.poses.size(); ++i) {
    const EvaluatedPose& from = evaluation.poses[i];
    const bool is_judged = place_of[i] < judged.poses.size();
    if (!is_judged && from.planned.role == PoseRole::kMeasure) continue;
    EvaluatedPose& pose = out.poses.emplace_back(from);
    for (std::size_t k = 0; k < out.solvers.size() && is_judged; ++k) {
      PoseResult& result = pose.results[k];
      const std::optional<PoseError>& error = errors[k][place_of[i]];
      result.measured = error.has_value();
      if (error) result.error = *error;
    }
  }
  return out;
}

TruthLevels truth_levels(const RunRecord& record, const RigFile& rig,
                         const Calibration& calibration, const Evaluation& evaluation) {
  TruthLevels out;
  try {
    const RigSightings sightings = rig_sightings(record, rig, calibration, evaluation);
    RigModel model(rig, made_on_stage(calibration, record.plan));
    out.found = self_calibrate(model, sightings);
    out.model = model;
    out.judged =
        cross_validate(record.plan, rig, calibration, evaluation, model, sightings, out.found);
  } catch (const Interrupted&) {
    throw;
  } catch (const Error& e) {
    out.why_not = e.what();
  }
  return out;
}

std::vector<LevelStatistics> level_statistics(const Evaluation& evaluation,
                                              const TruthLevels& levels) {
  std::vector<LevelStatistics> out{
      {TruthLevel::kPublished, scenario_statistics(evaluation), paired_comparisons(evaluation)}};
  for (const TruthLevel level : {TruthLevel::kAligned, TruthLevel::kSelfCalibrated}) {
    if (levels.judged.poses.empty()) continue;
    const Evaluation at = at_level(evaluation, levels.judged, level);
    out.push_back({level, scenario_statistics(at), paired_comparisons(at)});
  }
  return out;
}

}  // namespace turntable
