#include "src/evaluation/camera_comparison.h"

#include <algorithm>
#include <cmath>

#include "src/core/parallel.h"
#include "src/core/units.h"
#include "src/evaluation/attitude_sensor.h"

namespace turntable {
namespace {

/// e^2 of every pose, deg^2; NaN where it was not measured.
using SquaredErrors = std::vector<double>;

double rmse(const SquaredErrors& squares, std::span<const std::size_t> poses) {
  double sum = 0.0;
  for (const std::size_t k : poses) sum += squares[k];
  return std::sqrt(sum / static_cast<double>(poses.size()));
}

/// `statistic` of the poses that all of `columns` have measured.
template <class Statistic>
WithInterval with_interval(std::initializer_list<const SquaredErrors*> columns,
                           const Statistic& statistic) {
  std::vector<std::size_t> measured;
  for (std::size_t k = 0; k < (*columns.begin())->size(); ++k)
    if (std::ranges::all_of(columns, [k](const auto* c) { return std::isfinite((*c)[k]); }))
      measured.push_back(k);
  if (measured.empty()) return {Solution::kNaN, {Solution::kNaN, Solution::kNaN}};
  std::vector<std::size_t> drawn(measured.size());
  return {statistic(std::span<const std::size_t>(measured)),
          bootstrap_interval(
              measured.size(),
              [&](std::span<const std::size_t> places) {
                for (std::size_t i = 0; i < places.size(); ++i) drawn[i] = measured[places[i]];
                return statistic(std::span<const std::size_t>(drawn));
              },
              Random(1, "camera comparison"))};
}

WithInterval change(const SquaredErrors& from, const SquaredErrors& to) {
  return with_interval({&from, &to}, [&](std::span<const std::size_t> poses) {
    return rmse(to, poses) - rmse(from, poses);
  });
}

GimbalAngles radians(const GimbalAngles& deg) {
  return {rad_from_deg(deg.yaw), rad_from_deg(deg.roll), rad_from_deg(deg.pitch)};
}

}  // namespace

CameraComparison compare_cameras(const Evaluation& evaluation, const RigFile& rig,
                                 const Calibration& calibration) {
  CameraComparison out;
  out.rig = rig.title;
  if (calibration.find_central("pinhole") != nullptr) out.cameras.push_back("pinhole");
  if (const CentralModel* model = calibration.undistorting())
    out.cameras.emplace_back(central_name(model->kind));
  out.cameras.push_back("irt");
  for (const char* name : {"posit", "aopit", "aopit_ray", "ml_ray", "opencv_sqpnp"})
    out.solvers.push_back(find_solver(name));

  const TargetModel target(rig.target.points_mm);
  const Gimbal gimbal(rig.gimbal);
  std::vector<AttitudeSensor> sensors;
  for (const std::string& camera : out.cameras)
    for (const Solver* solver : out.solvers)
      sensors.emplace_back(calibration, target, *solver, camera);

  std::vector<std::vector<MeasuredAttitude>> attitudes(evaluation.poses.size());
  parallel_for(attitudes.size(), [&](std::size_t i) {
    const EvaluatedPose& pose = evaluation.poses[i];
    if (pose.points_px.empty()) return;
    for (const AttitudeSensor& sensor : sensors)
      attitudes[i].push_back(sensor.measure(pose.points_px, pose.covariances_px2));
  });

  const std::vector<std::optional<std::size_t>> initial = initial_poses(evaluation);

  std::vector<SquaredErrors> squares(sensors.size());
  for (std::size_t i = 0; i < attitudes.size(); ++i) {
    const PlannedPose& planned = evaluation.poses[i].planned;
    if (planned.role != PoseRole::kMeasure) continue;
    const bool seen = initial[i] && !attitudes[i].empty() && !attitudes[*initial[i]].empty();
    for (std::size_t s = 0; s < sensors.size(); ++s) {
      double square = Solution::kNaN;
      if (seen && attitudes[i][s].has_attitude() && attitudes[*initial[i]][s].has_attitude()) {
        const auto truth = [&](std::size_t k) {
          return gimbal.rotation(radians(evaluation.poses[k].read_back_deg));
        };
        const PoseError e =
            pose_error(gimbal,
                       relative_attitude(attitudes[i][s].R_plane_from_target,
                                         attitudes[*initial[i]][s].R_plane_from_target),
                       relative_attitude(truth(i), truth(*initial[i])));
        square = e.pitch_deg * e.pitch_deg + e.roll_deg * e.roll_deg + e.yaw_deg * e.yaw_deg;
      }
      squares[s].push_back(square);
    }
  }

  out.cells.resize(sensors.size());
  const std::size_t solvers = out.solvers.size();
  parallel_for(sensors.size(), [&](std::size_t s) {
    CameraSolverCell& cell = out.cells[s];
    cell.camera = out.cameras[s / solvers];
    cell.solver = out.solvers[s % solvers];
    cell.poses = squares[s].size();
    cell.failed = static_cast<std::size_t>(
        std::ranges::count_if(squares[s], [](double v) { return std::isnan(v); }));
    const WithInterval none{Solution::kNaN, {Solution::kNaN, Solution::kNaN}};
    cell.rmse_deg = cell.from_first_solver_deg = cell.from_camera_before_deg = none;
    if (squares[s].empty()) return;
    cell.rmse_deg = with_interval(
        {&squares[s]}, [&](std::span<const std::size_t> poses) { return rmse(squares[s], poses); });
    if (s % solvers > 0) cell.from_first_solver_deg = change(squares[s - s % solvers], squares[s]);
    if (s >= solvers) cell.from_camera_before_deg = change(squares[s - solvers], squares[s]);
  });
  return out;
}

}  // namespace turntable
