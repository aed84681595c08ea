// The one place where a camera, a target and a solver become a measurement: image points in,
// attitude in the plane frame out, whatever the solver looks through.
//   central camera, ray solver       rays by CentralModel::ray
//   ray camera, pinhole solver       (x/z, y/z) = (-g_x, g_y),  R_plane_from_camera = diag(1, -1, -1)
//   spread of a ray                  S = d(x, y)/d(u, v) L on planes a and b,  L L^T = cov(u, v)
// The second is exact for directions and ignores that the rays need not meet: the camera is put into
// the point nearest to all rays (`IrtModel::bundle_centre`). The Jacobian is a central difference
// over 1 px; at 1e3 px focal length its error is far below one part in 1e4.
// Source of S: GUM, JCGM 100:2008, 5.1; of the frames: mathematics of the rig, sections 1 and 3.
// Symbols: g = d(x, y)/dz, slope of a ray; (u, v) pixel, px; L lower Cholesky factor, px.
// Units: px in, mm and rad out. Domain: the calibrated part of the image. Outside it the attitude is
// stated as solved, kOutsideDomain; a pixel to which the camera model has no ray leaves none.
#pragma once

#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "src/attitude/solver.h"
#include "src/attitude/uncertainty.h"
#include "src/imaging/calibration.h"

namespace turntable {

/// One sighting as one solver explains it. Numbers that do not exist are NaN.
struct MeasuredAttitude {
  SolveStatus status = SolveStatus::kInvalidInput;
  Matrix3d R_plane_from_target = Matrix3d::Constant(Solution::kNaN);
  Vector3d position_mm = Vector3d::Constant(Solution::kNaN);  ///< M0 in the plane frame
  /// Of (delta, position) in the plane frame, as `Solution::covariance`: spots only.
  Matrix6d covariance = Matrix6d::Constant(Solution::kNaN);
  double chi2 = Solution::kNaN;
  int iterations = 0;
  /// Root mean square over the points: distance from the ray, mm (ray solvers), or reprojection, px
  /// (pinhole solvers).
  double residual = Solution::kNaN;
  bool in_domain = false;      ///< every spot lies inside the calibrated area
  std::uint32_t left_out = 0;  ///< bit t = point t, as `Solution::left_out`
  std::optional<Rival> rival;  ///< in the plane frame, residual as above

  /// As `Solution::has_attitude`. An ambiguous sighting has none, but R holds the better of its two.
  bool has_attitude() const {
    return status != SolveStatus::kAmbiguous && R_plane_from_target.allFinite();
  }
};

/// Of a spot whose uncertainty nobody states, px, and of a target's coordinates, share of its radius.
constexpr double kAssumedSpotSigmaPx = 0.1;
constexpr double kAssumedTargetShare = 1e-3;
/// Beyond it an attitude does not fit (`Fit::misfit`): about 1 is right, and 30 leaves room for
/// uncertainties that are stated five times too small.
constexpr double kMaxMisfit = 30.0;

/// "irt" and the central models of the calibration, as `AttitudeSensor` takes them.
std::vector<std::string> camera_names(const Calibration& calibration);

/// Looks through one camera model at one target and asks one solver. Keeps references to all three.
/// `measure` neither throws nor allocates (with a solver that does not), and may be called from
/// several threads.
class AttitudeSensor {
 public:
  /// @param camera one of `camera_names`; empty: what the solver's sight wants, which is the ray
  /// model, "pinhole", or the model that takes distortion out.
  /// @param robust as `SolveOptions::robust`.
  /// @throws ConfigError (file `calibration.source`): there is no such camera model, or the solver
  /// takes no target whose points lie in a plane.
  AttitudeSensor(const Calibration& calibration, const TargetModel& target, const Solver& solver,
                 std::string_view camera = {}, bool robust = false);

  /// True if the camera that the solver's sight wants is there.
  static bool can_serve(const Calibration& calibration, const Solver& solver);

  /// @param points_px one per target point, in the target's order
  /// @param covariances_px2 of each, px^2, symmetric and positive; none: not known
  MeasuredAttitude measure(std::span<const Vector2d> points_px,
                           std::span<const Eigen::Matrix2d> covariances_px2 = {}) const;

  /// What is stated of errors that are not the spots' own: of these rays, by a ray model that states
  /// its covariance; of the target's coordinates, independent of each other. Allocates.
  /// @param target_sigma_mm standard uncertainty of each coordinate; 0 = not stated
  UncertaintySources sources(std::span<const Vector2d> points_px, double target_sigma_mm) const;

  /// Where the uncertainty of a measurement comes from: its spots, the rays, the target. NaN if it
  /// has no covariance. Allocates.
  /// @param points_px, covariances_px2 as they were measured
  PoseUncertainty uncertainty(std::span<const Vector2d> points_px,
                              std::span<const Eigen::Matrix2d> covariances_px2,
                              const MeasuredAttitude& measured,
                              const UncertaintySources& stated) const;

  /// How well a measurement of any solver explains its points, within their uncertainty, that of the
  /// rays and that of the target. Without any uncertainty nothing would ever fit: what spots and
  /// target do not state is assumed, here alone (kAssumedSpotSigmaPx, kAssumedTargetShare). NaN
  /// without an attitude. Allocates.
  Fit judge(std::span<const Vector2d> points_px, std::span<const Eigen::Matrix2d> covariances_px2,
            const MeasuredAttitude& measured, UncertaintySources stated) const;

  /// Ray of a pixel through this sensor's camera; NaN where the model has none.
  Ray ray(const Vector2d& pixel_px) const;
  /// How a spot of this covariance moves it.
  RaySpread spread(const Vector2d& pixel_px, const Eigen::Matrix2d& covariance_px2) const;
  /// The uncertainty of the rays is known: `uncertainty` counts it.
  bool states_rays() const {
    return central_ == nullptr && calibration_.irt.covariance().size() > 0;
  }
  const RayPlanes& planes() const { return calibration_.irt.planes(); }
  const Solver& solver() const { return solver_; }
  const TargetModel& target() const { return target_; }
  /// "mm" or "px".
  std::string_view residual_unit() const { return sees_rays() ? "mm" : "px"; }

 private:
  struct Look;
  void look(std::span<const Vector2d> points_px, std::span<const Eigen::Matrix2d> covariances_px2,
            Look& look) const;
  Eigen::MatrixXd target_covariance(double sigma_mm) const;
  bool sees_rays() const { return solver_.sight == Sight::kRays; }

  const Calibration& calibration_;
  const TargetModel& target_;
  const Solver& solver_;
  SolveOptions options_;
  const CentralModel* central_ = nullptr;  ///< nullptr: the ray model
  /// Of the camera that pinhole solvers answer in.
  Matrix3d R_plane_from_camera_ = Matrix3d::Identity();
  Vector3d centre_mm_ = Vector3d::Zero();
  Vector2d lean_ = Vector2d::Zero();  ///< `CentralModel::lean`
  double focal_px_ = 1.0;
};

}  // namespace turntable
