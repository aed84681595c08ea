// Central camera models: every ray passes through one point. A point (X, Y, Z) of the camera frame
// (x right, y down, z forward) goes to the tangents x = X / Z, y = Y / Z, is distorted, and lands at
//   u = f_x x_d + c_x,   v = f_y y_d + c_y.
// With r^2 = x^2 + y^2 and theta = atan r:
//   pinhole    x_d = x
//   brown      x_d = x (1 + k1 r^2 + k2 r^4 + k3 r^6) + 2 p1 x y + p2 (r^2 + 2 x^2)
//              y_d = y (1 + k1 r^2 + k2 r^4 + k3 r^6) + p1 (r^2 + 2 y^2) + 2 p2 x y
//   rational   brown with its radial factor divided by (1 + k4 r^2 + k5 r^4 + k6 r^6)
//   fisheye    x_d = x theta_d / r,  theta_d = theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 +
//              k4 theta^8)
// Sources: Brown, Decentering distortion of lenses, Photogrammetric Engineering 32 (1966) 444-462;
// Claus & Fitzgibbon, A rational function lens distortion model for general cameras, CVPR 2005;
// Kannala & Brandt, A generic camera model and calibration method for conventional, wide-angle, and
// fish-eye lenses, IEEE TPAMI 28 (2006) 1335-1340. Coefficients in OpenCV's order and meaning.
// Units: px, mm, tangents dimensionless. Pixel (0, 0) is the centre of the top-left pixel.
// Domain: Z > 0, and the part of the image where the distortion still grows outwards. Outside it
// (behind the camera, or a pixel that no ray reaches) the answer is NaN.
#pragma once

#include <span>
#include <string_view>
#include <vector>

#include "src/core/image.h"
#include "src/geometry/ray.h"
#include "src/geometry/rotation.h"

namespace turntable {

enum class CentralKind { kPinhole, kBrown, kRational, kFisheye };
inline constexpr CentralKind kCentralKinds[] = {CentralKind::kPinhole, CentralKind::kBrown,
                                                CentralKind::kRational, CentralKind::kFisheye};

std::string_view central_name(CentralKind kind);  ///< "pinhole", "brown", "rational", "fisheye"
std::size_t distortion_terms(CentralKind kind);   ///< 0, 5, 8, 4

struct CentralModel {
  CentralKind kind = CentralKind::kPinhole;
  double fx = 0.0, fy = 0.0, cx = 0.0, cy = 0.0;
  std::vector<double> distortion;  ///< k1 k2 p1 p2 k3 (k4 k5 k6), or fisheye's k1 k2 k3 k4
  double rms_px = 0.0;             ///< reprojection residual of the fit, per point
  int views = 0;
  Matrix3d R_plane_from_camera = Matrix3d::Identity();
  Vector3d centre_mm = Vector3d::Zero();  ///< of the camera, in the plane frame
  /// What the stage moves along x and y of the pattern per mm of height: its travel is not exactly
  /// normal to the pattern. Coordinates in the plane frame move with the pattern, as those of
  /// `IrtModel` do: (x, y) at height z stands at (x, y) + lean z. Zero if views at one height only.
  Vector2d lean = Vector2d::Zero();
  /// False: no view tied the camera to the plane frame, which is then the camera frame turned over
  /// (x right, y up, z towards the camera, origin in the camera's centre).
  bool tied_to_plane = false;
  ImageSize image_size;

  /// Pixel -> tangents (X / Z, Y / Z), distortion taken out, by Newton's method to the last digits.
  Vector2d normalise(const Vector2d& pixel_px) const;
  /// Pixel of a point in the camera frame, mm.
  Vector2d project(const Vector3d& point_camera) const;
  /// Ray of a pixel in the plane frame.
  Ray ray(const Vector2d& pixel_px, const RayPlanes& planes) const;
};

/// One view of the flat pattern.
struct PatternView {
  std::vector<Vector2d> pixels_px;
  std::vector<Vector2d> on_pattern_mm;
  bool at_zero = false;  ///< table angles zero: the pattern frame is parallel to the plane frame
  double z_mm = 0.0;     ///< then its height in the plane frame
};

/// Intrinsics and distortion by OpenCV (Zhang, A flexible new technique for camera calibration,
/// IEEE TPAMI 22 (2000) 1330-1334) from all views; then R_plane_from_camera, centre_mm and lean by
/// least squares in tangents over all points of the views at zero angles together. Without the lean,
/// a stage that is not square would turn R with it, and attitudes by 0.01 deg per 0.02 deg.
/// @throws Error with fewer than three views, a view of fewer than six points, or points from which
/// OpenCV finds no camera.
CentralModel fit_central(CentralKind kind, std::span<const PatternView> views, ImageSize size);

}  // namespace turntable
