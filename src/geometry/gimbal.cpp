#include "src/geometry/gimbal.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "src/core/units.h"

namespace turntable {

double& GimbalAngles::operator[](AxisId axis) {
  switch (axis) {
    case AxisId::kYaw:
      return yaw;
    case AxisId::kRoll:
      return roll;
    case AxisId::kPitch:
      return pitch;
    case AxisId::kStage:
      break;
  }
  throw std::out_of_range("the stage has no angle");
}

double GimbalAngles::operator[](AxisId axis) const {
  return const_cast<GimbalAngles&>(*this)[axis];
}

std::array<Vector3d, 3> tilted_axes(const std::array<Vector3d, 3>& axes, const Vector3d& tilt_rad) {
  return {axes[0], (axes[1] + tilt_rad(0) * axes[0]).normalized(),
          (axes[2] + tilt_rad(1) * axes[0] + tilt_rad(2) * axes[1]).normalized()};
}

Gimbal::Gimbal(const GimbalConfig& config)
    : order_(config.order_base_outwards), centre_at_zero_(config.centre_at_stage_zero_mm) {
  for (std::size_t i = 0; i < 3; ++i) {
    const auto slot = std::ranges::find(kRotaryAxes, order_[i]) - kRotaryAxes.begin();
    axes_[i] = config.axes[static_cast<std::size_t>(slot)].normalized();
  }
  const double volume = axes_[0].dot(axes_[1].cross(axes_[2]));
  if (std::abs(std::abs(volume) - 1.0) > 1e-9)
    throw std::invalid_argument("gimbal axes are not orthogonal");
  handedness_ = volume > 0 ? 1.0 : -1.0;
  real_ = axes_;
  if (!config.axis_tilt_deg.isZero(0.0))
    real_ = tilted_axes(axes_, config.axis_tilt_deg / kDegPerRad);
  if (!config.plane_from_gimbal_deg.isZero(0.0))
    for (Vector3d& axis : real_)
      axis = rotation_from_vector(config.plane_from_gimbal_deg / kDegPerRad) * axis;
}

Gimbal Gimbal::turning_about(const std::array<Vector3d, 3>& axes) const {
  Gimbal out = *this;
  for (std::size_t i = 0; i < 3; ++i) {
    const auto slot = std::ranges::find(kRotaryAxes, order_[i]) - kRotaryAxes.begin();
    out.real_[i] = axes[static_cast<std::size_t>(slot)].normalized();
  }
  return out;
}

Matrix3d Gimbal::rotation(const GimbalAngles& angles) const {
  Matrix3d R = Matrix3d::Identity();
  for (std::size_t i = 0; i < 3; ++i)
    R = R * Eigen::AngleAxisd(angles[order_[i]], real_[i]).toRotationMatrix();
  return R;
}

GimbalAngles Gimbal::angles(const Matrix3d& R) const {
  // In the right-handed basis B = [a1 a2 h a3] the product is R1(t1) R2(t2) R3(h t3) about x, y, z:
  //   [ c2 c3          -c2 s3          s2    ]
  //   [ ...             ...           -s1 c2 ]
  //   [ ...             ...            c1 c2 ]
  Matrix3d B;
  B << axes_[0], axes_[1], handedness_ * axes_[2];
  const Matrix3d M = B.transpose() * R * B;
  const double s2 = std::clamp(M(0, 2), -1.0, 1.0);
  const double c2 = std::hypot(M(0, 0), M(0, 1));
  GimbalAngles out;
  out[order_[1]] = std::atan2(s2, c2);
  if (c2 > 1e-12) {
    out[order_[0]] = std::atan2(-M(1, 2), M(2, 2));
    out[order_[2]] = handedness_ * std::atan2(-M(0, 1), M(0, 0));
  } else {
    out[order_[0]] = std::atan2(M(2, 1), M(1, 1));
    out[order_[2]] = 0.0;
  }
  return out;
}

}  // namespace turntable
