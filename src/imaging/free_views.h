// Rays from views of a known rigid target at unknown poses: no stage, boards held by hand.
//   X = R_k P + p_k                                  point P of the target in view k, plane frame
//   m = ray(u).at(X_z) - (X_x, X_y)                  its miss in the plane z = X_z, mm
//   M = d ray(u).at(X_z) / du                        local mm per px, 2 x 2
//   minimise  sum |M^-1 m|^2  over all R_k, p_k and the polynomials' coefficients
// M^-1 m is the residual in the image plane to first order in itself. Gauss-Newton with Marquardt's
// damping (Marquardt 1963), all unknowns at once: m is linear in the coefficients and in p_k, and
// an alternation of poses and rays would creep along the valley in which each makes up for the
// other. M is held within a step.
// Source: a camera as a bundle of free rays calibrated from targets at unknown poses: Sturm &
// Ramalingam, "A generic concept for camera calibration", ECCV 2004; Schoeps, Larsson, Pollefeys &
// Sattler, "Why having 10,000 parameters in your camera model is better than twelve", CVPR 2020.
// Gauge: a rigid motion of the whole scene moves all poses and can be made up for by the
// polynomials: along x, y, z and about z exactly, about x and y nearly. (Shear, scale and
// projective maps cannot: the targets are rigid and known in mm.) The frame stays where the poses
// that were started from put it: steps have a zero sum over the views of the turns, and of the
// moves (inner constraints: Triggs, McLauchlan, Hartley & Fitzgibbon, "Bundle adjustment: a modern
// synthesis", 2000, section 9).
// Frame: the plane frame is the camera frame of the central model that was started from, turned
// over: R = diag(1, -1, -1), x right, y up, z towards the camera, centre of projection at the
// origin. All that is seen lies at negative heights.
// Units: mm, px, rms lengths per point. Domain: the hull of the pixels that were used, at least
// three views at different tilts. A polynomial in pixels stands for a tangent, which grows without
// bound towards 90 deg from the axis: a wide-angle lens takes order 7 up to about 50 deg, 9 up to
// 60, and is beyond these rays from about 70 on.
#pragma once

#include <array>
#include <span>
#include <vector>

#include "src/imaging/irt.h"

namespace turntable {

/// One view of one rigid target, planar or not: the same number of points and pixels.
struct FreeView {
  std::vector<Vector3d> on_target_mm;
  std::vector<Vector2d> pixels_px;
};

struct ViewPose {
  Matrix3d R_plane_from_target = Matrix3d::Identity();
  Vector3d position_mm = Vector3d::Zero();  ///< of the target's origin, plane frame
  double rms_px = 0.0;                      ///< length per point
  bool converged = false;
};

/// Residual of a point in the image plane, px (u right, v down).
Vector2d residual_px(const IrtModel& model, const ViewPose& pose, const Vector3d& on_target_mm,
                     const Vector2d& pixel_px);

/// Pose of a view with the rays frozen, by Gauss-Newton from `start`. Needs three points that are
/// not on a line; with fewer, or from a start too far off, `converged` is false.
ViewPose fit_pose(const IrtModel& model, const FreeView& view, const ViewPose& start);
/// The same without a start: SQPNP (OpenCV) on the rays as if they all met at the bundle's centre,
/// then `fit_pose`. Needs four points.
ViewPose fit_pose(const IrtModel& model, const FreeView& view);

/// The central model that fits are started from: Kannala & Brandt, "A generic camera model and
/// calibration method for conventional, wide-angle, and fish-eye lenses", 2006 (OpenCV's fisheye),
///   r = theta + k1 theta^3 + k2 theta^5 + k3 theta^7 + k4 theta^9,   u = c + f r (cos phi, sin phi)
/// for points in front of the camera, theta < 90 deg; tele lenses are the small end of it.
struct CentralFit {
  Vector2d focal_px, principal_px;
  std::array<double, 4> k{};
  std::vector<ViewPose> poses;
  double rms_px = 0.0;
  bool converged = false;

  std::vector<Vector2d> project(const ViewPose& pose, std::span<const Vector3d> on_target_mm) const;
};

/// Lens and poses by least squares on pixels, from a series of focal lengths and SQPNP poses.
/// @throws Error with fewer than three views, a view with fewer than six points, or if no focal
/// length brings the views together.
CentralFit fit_central(std::span<const FreeView> views, ImageSize size);

struct FreeViewsFit {
  /// A point left out as an outlier, by its place in the input.
  struct Outlier {
    std::size_t view = 0, point = 0;
  };
  IrtModel model;  ///< planes: the lowest and the highest point of all views
  std::vector<ViewPose> poses;
  std::vector<Outlier> outliers;
  int order = 0;
  int points = 0;               ///< used
  double rms_px = 0.0;          ///< over the points used
  double sigma_px = 0.0;        ///< per coordinate, with the fit's degrees of freedom
  double position_sd_mm = 0.0;  ///< standard deviation of a view's position, the worst view's
  int iterations = 0;
  bool converged = false;
};

/// Rays and poses together. Outliers are removed, the worst first: more than 6 robust standard
/// deviations and 0.1 px off, at most a tenth of the points.
/// @param start one pose per view; those of `fit_central` if empty.
/// @throws Error if the views do not determine the order (too few points, all at one tilt: a
/// view's position uncertain by a hundredth of itself), or if more than a tenth of the points do not fit.
FreeViewsFit fit_rays(std::span<const FreeView> views, ImageSize size, int order,
                      std::span<const ViewPose> start = {});

}  // namespace turntable
