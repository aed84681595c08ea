// Three rotary axes, one carrying the next.
//   R_gimbal = R_1(angle_1) R_2(angle_2) R_3(angle_3)
// from the base outwards (default: yaw, roll, pitch).
// The axes may miss right angles by a little, and lie askew in the plane frame: rotation() turns about
// the real ones, angles() always decomposes by the stated, orthogonal ones.
// Golden numbers: gimbal.json. Angles are decomposed in the same order; the middle angle lies in
// [-90, 90] deg.
#pragma once

#include "src/core/rig_file.h"
#include "src/geometry/rotation.h"

namespace turntable {

/// Table angles, rad.
struct GimbalAngles {
  double yaw = 0.0;
  double roll = 0.0;
  double pitch = 0.0;

  double& operator[](AxisId axis);
  double operator[](AxisId axis) const;
};

/// Orthogonal axes, base outwards, as they are when they miss right angles: the second leans towards
/// the first by tilt(0), the third towards the first by tilt(1) and towards the second by tilt(2).
/// To first order these three are all: what else may be wrong with axes turns all of them together.
std::array<Vector3d, 3> tilted_axes(const std::array<Vector3d, 3>& axes, const Vector3d& tilt_rad);

class Gimbal {
 public:
  /// Unit axes at zero angles and their order; the real ones are turned and tilted as the config
  /// says. Decomposition needs orthogonal axes.
  /// @throws std::invalid_argument if they are not.
  explicit Gimbal(const GimbalConfig& config);

  /// The same gimbal with other real axes: unit vectors in the plane frame at zero angles, by order of
  /// kRotaryAxes.
  Gimbal turning_about(const std::array<Vector3d, 3>& axes) const;

  /// R_gimbal: table at zero angles -> table at `angles`, in the plane frame.
  Matrix3d rotation(const GimbalAngles& angles) const;
  /// The angles that make R. At the singularity (middle angle +-90 deg) the innermost angle is set
  /// to 0.
  GimbalAngles angles(const Matrix3d& R) const;
  /// Gimbal centre in the plane frame with the stage at `stage_mm`.
  Vector3d centre_mm(double stage_mm) const { return centre_at_zero_ + Vector3d(0, 0, stage_mm); }

 private:
  std::array<AxisId, 3> order_;
  std::array<Vector3d, 3> axes_;  ///< in that order
  std::array<Vector3d, 3> real_;  ///< likewise; those that turn
  double handedness_;             ///< +1 if axes 1, 2, 3 are right-handed, -1 if not
  Vector3d centre_at_zero_;
};

}  // namespace turntable
