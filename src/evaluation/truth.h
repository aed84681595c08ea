// What measured attitudes are compared with: three levels of truth, none replacing another.
//   as published      gimbal axes taken as parallel to the plane frame
//   aligned           R_meas = X R_gimbal Y, with the fixed rotations X and Y from the measured attitudes
//                     themselves (hand-eye calibration of rotations)
//   self-calibrated   the whole rig from the images (self_calibration.h)
// Alignment: closed form by logarithms, a_k = X g_k for rotation vectors a, g relative to the first
// pose (F. C. Park, B. J. Martin, IEEE Trans. Robotics Automation 10 (1994) 717-721), nearest to X = 1
// where the motions leave X open; then Gauss-Newton on
//   e_k = log(R_k (X G_k Y)^T),   X <- exp(dx) X, Y <- Y exp(dy):   e_k = dx + X G_k Y dy
// Symbols: R_k -> measured, G_k -> gimbal. Units: rad. Domain: any X and Y for the closed form's start
// with noise of a few degrees.
#pragma once

#include <span>
#include <string_view>

#include "src/geometry/rotation.h"

namespace turntable {

enum class TruthLevel { kPublished, kAligned, kSelfCalibrated };
inline constexpr TruthLevel kTruthLevels[] = {TruthLevel::kPublished, TruthLevel::kAligned,
                                              TruthLevel::kSelfCalibrated};
std::string_view truth_level_name(TruthLevel level);  ///< "as published", ...

struct Alignment {
  Matrix3d X = Matrix3d::Identity(), Y = Matrix3d::Identity();
  /// Of the six angles of X and Y: 5 if all motions turn about one axis, and X about it is then left
  /// where it was. Attitudes relative to an initial pose do not depend on it.
  int determined = 0;
  double rms_rad = 0.0;  ///< of |e_k|
};

/// @param measured, gimbal one per pose. Without poses: X = Y = 1.
Alignment align(std::span<const Matrix3d> measured, std::span<const Matrix3d> gimbal);

}  // namespace turntable
