#include "src/attitude/opencv_pnp.h"

#include <array>
#include <cmath>
#include <opencv2/calib3d.hpp>

#include "src/attitude/reprojection.h"

namespace turntable {
namespace {

/// One problem in OpenCV's terms, and its answer so far.
struct PnpProblem {
  int n = 0;
  std::array<cv::Point3d, kMaxTargetPoints> object;  ///< mm, from M0
  std::array<cv::Point2d, kMaxTargetPoints> image;
  cv::Matx33d camera = cv::Matx33d::eye();
  cv::Vec3d rvec, tvec;

  bool solve(int method, int points, bool from_guess = false) {
    return cv::solvePnP(cv::Mat(points, 1, CV_64FC3, object.data()),
                        cv::Mat(points, 1, CV_64FC2, image.data()), camera, cv::noArray(), rvec,
                        tvec, from_guess, method);
  }
};

/// Sightings on one line, or in one place: their scatter has a singular value below a millionth of
/// the other. OpenCV answers them with a pose.
bool on_one_line(std::span<const Vector2d> x) {
  Vector2d mean = Vector2d::Zero();
  for (const Vector2d& point : x) mean += point / static_cast<double>(x.size());
  double xx = 0.0, xy = 0.0, yy = 0.0;
  for (const Vector2d& point : x) {
    const Vector2d d = point - mean;
    xx += d.x() * d.x();
    xy += d.x() * d.y();
    yy += d.y() * d.y();
  }
  return !(xx * yy - xy * xy > 1e-12 * (xx + yy) * (xx + yy));
}

/// @param solve bool(PnpProblem&): leaves the answer in rvec, tvec.
template <typename Solve>
Solution with_opencv(const TargetModel& target, const Observation& observation,
                     const Solve& solve) {
  Solution solution;
  const std::span<const Vector2d> x = observation.normalised;
  if (x.size() != static_cast<std::size_t>(target.size())) return solution;
  for (const Vector2d& point : x)
    if (!point.allFinite()) return solution;
  solution.status = SolveStatus::kDegenerate;
  if (on_one_line(x)) return solution;
  PnpProblem problem;
  problem.n = target.size();
  for (int t = 0; t < problem.n; ++t) {
    const auto i = static_cast<std::size_t>(t);
    const Vector3d p = target.points().col(t) - target.points().col(0);
    problem.object[i] = {p.x(), p.y(), p.z()};
    problem.image[i] = {x[i].x(), x[i].y()};
  }
  try {
    if (!solve(problem)) return solution;
  } catch (const cv::Exception&) {
    return solution;
  }
  const Vector3d v(problem.rvec[0], problem.rvec[1], problem.rvec[2]);
  const Vector3d T(problem.tvec[0], problem.tvec[1], problem.tvec[2]);
  if (!v.allFinite() || !T.allFinite()) return solution;
  solution.R = solution.rows_ijk = rotation_from_vector(v);
  solution.position_mm = T;
  solution.residual = reprojection_rms(target, x, solution.R, T);
  if (std::isfinite(solution.residual)) solution.status = SolveStatus::kConverged;
  return solution;
}

}  // namespace

Solution solve_opencv_sqpnp(const TargetModel& target, const Observation& observation,
                            const SolveOptions&) {
  return with_opencv(target, observation,
                     [](PnpProblem& p) { return p.solve(cv::SOLVEPNP_SQPNP, p.n); });
}

Solution solve_opencv_epnp(const TargetModel& target, const Observation& observation,
                           const SolveOptions&) {
  if (target.coplanar()) {
    Solution refused;
    refused.status = SolveStatus::kCoplanarTarget;
    return refused;
  }
  return with_opencv(target, observation,
                     [](PnpProblem& p) { return p.solve(cv::SOLVEPNP_EPNP, p.n); });
}

Solution solve_opencv_iterative(const TargetModel& target, const Observation& observation,
                                const SolveOptions&) {
  return with_opencv(target, observation, [](PnpProblem& p) {
    return (p.solve(cv::SOLVEPNP_AP3P, 4) || p.solve(cv::SOLVEPNP_EPNP, p.n)) &&
           p.solve(cv::SOLVEPNP_ITERATIVE, p.n, true);
  });
}

}  // namespace turntable
