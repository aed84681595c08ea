#include "src/evaluation/attitude_sensor.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "src/core/errors.h"

namespace turntable {
namespace {

constexpr std::string_view kRayCamera = "irt";

/// The model through which a pinhole sight looks; nullptr if the camera has none, or for rays.
const CentralModel* wanted_central(const Calibration& calibration, Sight sight) {
  switch (sight) {
    case Sight::kRays:
      return nullptr;
    case Sight::kPinholeRaw:
      return calibration.find_central("pinhole");
    case Sight::kPinholeUndistorted:
      return calibration.undistorting();
  }
  return nullptr;
}

/// The ray model as a camera of directions: (x, y, z) -> (x, -y, -z).
const Matrix3d kTurnedOver = Vector3d(1.0, -1.0, -1.0).asDiagonal();

Vector2d directions(const Ray& ray, const RayPlanes& planes) {
  const Vector2d g = ray.slope(planes);
  return {-g.x(), g.y()};
}

/// Pixels per unit of slope in the middle of the image.
double focal_length_px(const IrtModel& irt) {
  const ImageSize size = irt.image_size();
  const Vector2d middle(0.5 * (size.width - 1), 0.5 * (size.height - 1));
  const auto slope = [&](double du, double dv) {
    return irt.ray(middle + Vector2d(du, dv)).slope(irt.planes());
  };
  const Vector2d du = slope(0.5, 0.0) - slope(-0.5, 0.0), dv = slope(0.0, 0.5) - slope(0.0, -0.5);
  return 1.0 / std::sqrt(std::abs(du.x() * dv.y() - du.y() * dv.x()));
}

bool positive_definite(const Eigen::Matrix2d& C) {
  return C.allFinite() && C(0, 0) > 0.0 && C(0, 1) == C(1, 0) && C.determinant() > 0.0;
}

bool finite(const Ray& ray) { return ray.at_a.allFinite() && ray.at_b.allFinite(); }

}  // namespace

std::vector<std::string> camera_names(const Calibration& calibration) {
  std::vector<std::string> names{std::string(kRayCamera)};
  for (const CentralModel& model : calibration.central)
    names.emplace_back(central_name(model.kind));
  return names;
}

bool AttitudeSensor::can_serve(const Calibration& calibration, const Solver& solver) {
  return solver.sight == Sight::kRays || wanted_central(calibration, solver.sight) != nullptr;
}

AttitudeSensor::AttitudeSensor(const Calibration& calibration, const TargetModel& target,
                               const Solver& solver, std::string_view camera, bool robust)
    : calibration_(calibration), target_(target), solver_(solver), options_(solver.defaults) {
  options_.robust = robust;
  if (target.coplanar() && !solver.coplanar)
    throw ConfigError("--solver", "",
                      fmt::format("{} takes no target whose points lie in a plane, as these do. "
                                  "Choose a solver that does, such as {}.",
                                  solver.name, default_solver().name));
  if (camera.empty()) {
    if (!can_serve(calibration, solver))
      throw ConfigError(
          calibration.source, "",
          fmt::format(
              "solver {} needs a pinhole calibration, which this camera file does not have. "
              "Choose a ray solver or calibrate with tilted views.",
              solver.name));
    central_ = wanted_central(calibration, solver.sight);
  } else if (camera != kRayCamera) {
    central_ = calibration.find_central(camera);
    if (central_ == nullptr)
      throw ConfigError(calibration.source, "",
                        fmt::format("has no camera model \"{}\", allowed: {}. Choose one of these, "
                                    "or calibrate with tilted views.",
                                    camera, fmt::join(camera_names(calibration), ", ")));
  }
  if (sees_rays()) return;
  if (central_ != nullptr) {
    R_plane_from_camera_ = central_->R_plane_from_camera;
    centre_mm_ = central_->centre_mm;
    lean_ = central_->lean;
    focal_px_ = central_->fx;
  } else {
    R_plane_from_camera_ = kTurnedOver;
    centre_mm_ = calibration.irt.bundle_centre().first;
    focal_px_ = focal_length_px(calibration.irt);
  }
}

Ray AttitudeSensor::ray(const Vector2d& pixel_px) const {
  return central_ == nullptr ? calibration_.irt.ray(pixel_px) : central_->ray(pixel_px, planes());
}

/// The observation and what it points into.
struct AttitudeSensor::Look {
  Look() = default;
  Look(const Look&) = delete;
  Look& operator=(const Look&) = delete;

  std::array<Ray, kMaxTargetPoints> rays;
  std::array<RaySpread, kMaxTargetPoints> spreads;
  std::array<Vector2d, kMaxTargetPoints> normalised;
  Observation observation;
  bool answered = true;  ///< the camera has a ray for every pixel
};

RaySpread AttitudeSensor::spread(const Vector2d& pixel_px,
                                 const Eigen::Matrix2d& covariance_px2) const {
  const auto moved = [&](double du, double dv) { return ray(pixel_px + Vector2d(du, dv)); };
  const Ray right = moved(0.5, 0.0), left = moved(-0.5, 0.0);
  const Ray below = moved(0.0, 0.5), above = moved(0.0, -0.5);
  Eigen::Matrix2d L = Eigen::Matrix2d::Zero();  // Cholesky
  L(0, 0) = std::sqrt(covariance_px2(0, 0));
  L(1, 0) = covariance_px2(1, 0) / L(0, 0);
  L(1, 1) = std::sqrt(covariance_px2(1, 1) - L(1, 0) * L(1, 0));
  RaySpread out;
  out.at_a << right.at_a - left.at_a, below.at_a - above.at_a;
  out.at_b << right.at_b - left.at_b, below.at_b - above.at_b;
  out.at_a *= L;
  out.at_b *= L;
  return out;
}

void AttitudeSensor::look(std::span<const Vector2d> points_px,
                          std::span<const Eigen::Matrix2d> covariances_px2, Look& out) const {
  const std::size_t n = points_px.size();
  out.observation.planes = planes();
  for (std::size_t i = 0; i < n; ++i) {
    if (sees_rays()) {
      out.rays[i] = ray(points_px[i]);
      out.answered = out.answered && finite(out.rays[i]);
      if (covariances_px2.empty()) continue;
      out.spreads[i] = spread(points_px[i], covariances_px2[i]);
      out.answered =
          out.answered && out.spreads[i].at_a.allFinite() && out.spreads[i].at_b.allFinite();
    } else {
      out.normalised[i] = central_ != nullptr
                              ? central_->normalise(points_px[i])
                              : directions(calibration_.irt.ray(points_px[i]), planes());
      out.answered = out.answered && out.normalised[i].allFinite();
    }
  }
  if (sees_rays()) {
    out.observation.rays = std::span(out.rays).first(n);
    if (!covariances_px2.empty()) out.observation.spreads = std::span(out.spreads).first(n);
  } else {
    out.observation.normalised = std::span(out.normalised).first(n);
  }
}

MeasuredAttitude AttitudeSensor::measure(std::span<const Vector2d> points_px,
                                         std::span<const Eigen::Matrix2d> covariances_px2) const {
  MeasuredAttitude out;
  const std::size_t n = points_px.size();
  if (n != static_cast<std::size_t>(target_.size()) ||
      (!covariances_px2.empty() && covariances_px2.size() != n) ||
      !std::ranges::all_of(points_px, [](const Vector2d& p) { return p.allFinite(); }) ||
      !std::ranges::all_of(covariances_px2, positive_definite))
    return out;
  out.in_domain = std::ranges::all_of(
      points_px, [&](const Vector2d& p) { return calibration_.irt.in_domain(p); });

  Look seen;
  look(points_px, covariances_px2, seen);
  if (!seen.answered) {
    out.status = SolveStatus::kOutsideDomain;
    return out;
  }

  const Solution solution = solver_.function(target_, seen.observation, options_);
  out.status = solution.status;
  out.iterations = solution.iterations;
  out.residual = solution.residual;
  out.left_out = solution.left_out;
  if (!sees_rays()) out.residual *= focal_px_;
  if (!solution.has_attitude() && solution.status != SolveStatus::kAmbiguous) return out;
  if (!out.in_domain && solution.has_attitude()) out.status = SolveStatus::kOutsideDomain;
  out.chi2 = solution.chi2;
  if (sees_rays()) {
    out.R_plane_from_target = solution.R;
    out.position_mm = solution.position_mm;
    out.covariance = solution.covariance;
    out.rival = solution.rival;
    return out;
  }
  const auto in_plane = [&](const Vector3d& p) -> Vector3d {
    Vector3d at = R_plane_from_camera_ * p + centre_mm_;
    at.head<2>() -= lean_ * at.z();
    return at;
  };
  out.R_plane_from_target = R_plane_from_camera_ * solution.R;
  out.position_mm = in_plane(solution.position_mm);
  // The lean is below a thousandth: it moves positions, and no uncertainty that anybody would read.
  Matrix6d turn = Matrix6d::Zero();
  turn.topLeftCorner<3, 3>() = turn.bottomRightCorner<3, 3>() = R_plane_from_camera_;
  out.covariance = turn * solution.covariance * turn.transpose();
  if (solution.rival)
    out.rival = Rival{R_plane_from_camera_ * solution.rival->R,
                      in_plane(solution.rival->position_mm), solution.rival->residual * focal_px_};
  return out;
}

Eigen::MatrixXd AttitudeSensor::target_covariance(double sigma_mm) const {
  return sigma_mm * sigma_mm * Eigen::MatrixXd::Identity(3 * target_.size(), 3 * target_.size());
}

UncertaintySources AttitudeSensor::sources(std::span<const Vector2d> points_px,
                                           double target_sigma_mm) const {
  UncertaintySources out;
  if (states_rays()) out.rays_mm2 = calibration_.irt.joint_ray_covariance(points_px);
  if (target_sigma_mm > 0.0) out.target_mm2 = target_covariance(target_sigma_mm);
  return out;
}

PoseUncertainty AttitudeSensor::uncertainty(std::span<const Vector2d> points_px,
                                            std::span<const Eigen::Matrix2d> covariances_px2,
                                            const MeasuredAttitude& measured,
                                            const UncertaintySources& stated) const {
  Solution solution;  // a covariance that is not stated stays NaN
  Look seen;
  if (sees_rays() && measured.R_plane_from_target.allFinite()) {
    look(points_px, covariances_px2, seen);
    solution.R = measured.R_plane_from_target;
    solution.position_mm = measured.position_mm;
    solution.covariance = measured.covariance;
    solution.left_out = measured.left_out;
  }
  return propagate_uncertainty(target_, seen.observation, solution, stated);
}

Fit AttitudeSensor::judge(std::span<const Vector2d> points_px,
                          std::span<const Eigen::Matrix2d> covariances_px2,
                          const MeasuredAttitude& measured, UncertaintySources stated) const {
  if (!measured.R_plane_from_target.allFinite()) return {};
  const Eigen::Matrix2d assumed =
      kAssumedSpotSigmaPx * kAssumedSpotSigmaPx * Eigen::Matrix2d::Identity();
  Look seen;
  for (std::size_t i = 0; i < points_px.size(); ++i) {
    seen.rays[i] = ray(points_px[i]);
    seen.spreads[i] = spread(points_px[i], covariances_px2.empty() ? assumed : covariances_px2[i]);
  }
  seen.observation.planes = planes();
  seen.observation.rays = std::span(seen.rays).first(points_px.size());
  seen.observation.spreads = std::span(seen.spreads).first(points_px.size());
  if (stated.target_mm2.size() == 0)
    stated.target_mm2 = target_covariance(kAssumedTargetShare * target_.radius_mm());
  return judge_fit(target_, seen.observation, measured.R_plane_from_target, measured.position_mm,
                   stated, measured.left_out);
}

}  // namespace turntable
