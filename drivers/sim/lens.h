// A lens as glass makes them, for rendering: no camera model under test contains it exactly (no
// inverse crime). Camera frame -> tangents through a walking entrance pupil at z = w theta^2 ->
// radial and decentring distortion (Conrady 1919) -> tilted sensor -> pixels:
//   x   = X / (Z - w theta^2),  y likewise,  theta = atan |(x, y)|
//   x_d = x (1 + k1 r^2 + k2 r^4 + k3 r^6) + 2 p1 x y + p2 (r^2 + 2 x^2),  y_d likewise
//   x_s = x_d / (1 + x_d tan a + y_d tan b),  y_s likewise  (sensor tilt a, b)
//   u   = c_u + f x_s,  v = c_v + f y_s
#pragma once

#include <Eigen/Core>

#include "src/core/rig_file.h"
#include "src/core/units.h"

namespace turntable::sim {

/// A ray in the camera frame: from (0, 0, pupil_mm) along (tangent, 1).
struct CameraRay {
  Vector2d tangent;
  double pupil_mm;
};

class Lens {
 public:
  explicit Lens(const LensTruth& truth);

  /// Pixel of a point in the camera frame (x right, y down, z forward; mm). The point must lie in
  /// front (Z > 0).
  Vector2d project(const Vector3d& point_camera_mm) const;
  /// Ray of a pixel, by Newton iteration to 1e-12 in the tangents.
  CameraRay ray(const Vector2d& pixel) const;

 private:
  Vector2d distort(const Vector2d& tangent) const;

  LensTruth truth_;
  Vector2d tilt_;
};

}  // namespace turntable::sim
