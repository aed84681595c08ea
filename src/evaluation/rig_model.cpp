#include "src/evaluation/rig_model.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "src/core/units.h"
#include "src/evaluation/calibration_set.h"

namespace turntable {
namespace {

// Places in the list of values.
constexpr Eigen::Index kX = 0, kY = 3, kOffset = 6, kCentre = 9, kTilt = 12, kLean = 15,
                       kScale = 17, kPoints = 18;

constexpr double kRadPerDeg = 1.0 / kDegPerRad;

Matrix3d cross(const Vector3d& v) {
  Matrix3d m;
  m << 0, -v.z(), v.y(), v.z(), 0, -v.x(), -v.y(), v.x(), 0;
  return m;
}

/// exp([v + d]x) = exp([v]x) exp([J d]x) to first order in d.
Matrix3d right_jacobian(const Vector3d& v) {
  const double angle2 = v.squaredNorm(), angle = std::sqrt(angle2);
  const Matrix3d K = cross(v);
  const double first = angle2 < 1e-8 ? 0.5 : (1.0 - std::cos(angle)) / angle2;
  const double second = angle2 < 1e-8 ? 1.0 / 6.0 : (angle - std::sin(angle)) / (angle2 * angle);
  return Matrix3d::Identity() - first * K + second * K * K;
}

/// d (R(v) p) / d v for the rotation vector v.
Matrix3d rotated_by_vector(const Matrix3d& R, const Vector3d& v, const Vector3d& p) {
  return -R * cross(p) * right_jacobian(v);
}

/// d (v / |v|) / d v times dv.
Vector3d turn_of_direction(const Vector3d& unit, double length, const Vector3d& dv) {
  return (dv - unit * unit.dot(dv)) / length;
}

}  // namespace

RigModel::RigModel(const RigFile& rig, bool stage_made_frame)
    : gimbal_(rig.gimbal),
      stage_made_(stage_made_frame),
      points_(static_cast<int>(rig.target.points_mm.size())),
      order_(rig.gimbal.order_base_outwards) {
  for (std::size_t i = 0; i < 3; ++i) {
    const auto slot = std::ranges::find(kRotaryAxes, order_[i]) - kRotaryAxes.begin();
    axes_[i] = rig.gimbal.axes[static_cast<std::size_t>(slot)].normalized();
  }
  constexpr std::array kXyz{'x', 'y', 'z'};
  const ToleranceConfig& t = rig.tolerances;
  const auto add = [&](std::string name, const char* unit, std::string what, ParameterGroup group,
                       double drawing, const Tolerance& prior) {
    parameters_.push_back({std::move(name), unit, std::move(what), group, drawing, prior});
  };
  const auto add3 = [&](const std::string& name, const char* unit, const std::string& what,
                        ParameterGroup group, const Vector3d& drawing, const Tolerance& prior) {
    for (std::size_t k = 0; k < 3; ++k)
      add(fmt::format("{}_{}", name, kXyz[k]), unit, fmt::format("{}, {}", what, kXyz[k]), group,
          drawing(static_cast<Eigen::Index>(k)), prior);
  };
  add3("plane_from_gimbal", "deg", "gimbal against the plane frame", ParameterGroup::kMounting,
       rig.gimbal.plane_from_gimbal_deg, t.mounting_deg);
  add3("table_from_target", "deg", "target against its table", ParameterGroup::kTargetMounting,
       Vector3d::Zero(), t.mounting_deg);
  add3("target_offset", "mm", "M0 from the gimbal centre", ParameterGroup::kOffset,
       rig.target.offset_mm, t.offset_mm);
  add3("gimbal_centre", "mm", "gimbal centre with the stage at 0", ParameterGroup::kCentre,
       rig.gimbal.centre_at_stage_zero_mm, t.offset_mm);
  for (Eigen::Index k = 0; k < 3; ++k) {
    const std::string_view of = axis_name(order_[k == 0 ? 1 : 2]),
                           to = axis_name(order_[k == 2 ? 1 : 0]);
    add(fmt::format("{}_tilt_to_{}", of, to), "deg",
        fmt::format("{} axis leans towards the {} axis", of, to), ParameterGroup::kAxes,
        rig.gimbal.axis_tilt_deg(k), t.axes_deg);
  }
  for (const char axis : {'x', 'y'})
    add(fmt::format("stage_squareness_{}", axis), "deg",
        fmt::format("lean of the stage's travel towards {}", axis), ParameterGroup::kStage, 0.0,
        t.squareness_deg);
  add("stage_scale", "1", "real over stated travel of the stage", ParameterGroup::kStage, 1.0,
      t.stage_scale);
  for (std::size_t i = 1; i < rig.target.points_mm.size(); ++i)
    add3(fmt::format("target_{}", i), "mm", fmt::format("LED M{}", i), ParameterGroup::kTarget,
         rig.target.points_mm[i], t.target_mm);
  for (std::size_t a = 0; a < kAllAxes.size(); ++a)
    arrival_sd_[a] = 0.5 * rig.axis(kAllAxes[a]).repeatability;
}

Eigen::VectorXd RigModel::drawing() const {
  Eigen::VectorXd out(size());
  for (int i = 0; i < size(); ++i) out(i) = parameters_[static_cast<std::size_t>(i)].drawing;
  return out;
}

Eigen::VectorXd RigModel::prior_sd() const {
  Eigen::VectorXd out(size());
  for (int i = 0; i < size(); ++i) out(i) = parameters_[static_cast<std::size_t>(i)].prior.sd;
  return out;
}

Eigen::VectorXd RigModel::values(const RigParameters& p) const {
  Eigen::VectorXd out(size());
  out << p.plane_from_gimbal_deg, p.table_from_target_deg, p.target_offset_mm, p.gimbal_centre_mm,
      p.axis_tilt_deg, p.stage_squareness_deg, p.stage_scale,
      Eigen::VectorXd::Zero(size() - kPoints);
  for (std::size_t i = 1; i < p.target_points_mm.size(); ++i)
    out.segment<3>(kPoints + 3 * static_cast<Eigen::Index>(i - 1)) = p.target_points_mm[i];
  return out;
}

RigParameters RigModel::named(const Eigen::VectorXd& v) const {
  RigParameters out{v.segment<3>(kX),
                    v.segment<3>(kY),
                    v.segment<3>(kOffset),
                    v.segment<3>(kCentre),
                    v.segment<3>(kTilt),
                    v.segment<2>(kLean),
                    v(kScale),
                    {Vector3d::Zero()}};
  for (Eigen::Index i = 1; i < points_; ++i)
    out.target_points_mm.push_back(v.segment<3>(kPoints + 3 * (i - 1)));
  return out;
}

Eigen::VectorXd RigModel::leds(const Eigen::Ref<const Eigen::VectorXd>& v, const TablePosition& at,
                               Derivatives* derivatives) const {
  const Vector3d x = kRadPerDeg * v.segment<3>(kX), y = kRadPerDeg * v.segment<3>(kY);
  const Matrix3d X = rotation_from_vector(x), Y = rotation_from_vector(y);
  const Vector3d tilt = kRadPerDeg * v.segment<3>(kTilt);
  const std::array<Vector3d, 3> axes = tilted_axes(axes_, tilt);
  std::array<Matrix3d, 3> R;
  for (std::size_t j = 0; j < 3; ++j)
    R[j] = Eigen::AngleAxisd(at.angles[order_[j]], axes[j]).toRotationMatrix();
  const Matrix3d XR = X * R[0] * R[1] * R[2];
  const Vector2d lean(std::tan(kRadPerDeg * v(kLean)), std::tan(kRadPerDeg * v(kLean + 1)));
  const double scale = v(kScale), s = at.stage_mm;
  const Vector3d travel(lean.x(), lean.y(), 1.0);  // of the stage, per real mm of height

  // The frame of the rays from the orthonormal one.
  Matrix3d A = Matrix3d::Identity();
  if (stage_made_) A << 1, 0, -lean.x(), 0, 1, -lean.y(), 0, 0, 1.0 / scale;

  Eigen::VectorXd out(3 * points_);
  Vector3d d_second{}, d_third_1{}, d_third_2{};
  if (derivatives != nullptr) {
    derivatives->by_value.setZero(3 * points_, size());
    derivatives->by_axis.setZero(3 * points_, 4);
    d_second = turn_of_direction(axes[1], (axes_[1] + tilt(0) * axes_[0]).norm(), axes_[0]);
    const double third = (axes_[2] + tilt(1) * axes_[0] + tilt(2) * axes_[1]).norm();
    d_third_1 = turn_of_direction(axes[2], third, axes_[0]);
    d_third_2 = turn_of_direction(axes[2], third, axes_[1]);
  }
  for (int i = 0; i < points_; ++i) {
    const Vector3d p = i == 0 ? Vector3d::Zero() : Vector3d(v.segment<3>(kPoints + 3 * (i - 1)));
    const Vector3d q = v.segment<3>(kOffset) + Y * p;  // in the frame of the table
    const Vector3d real = v.segment<3>(kCentre) + scale * s * travel + XR * q;
    out.segment<3>(3 * i) = A * real;
    if (derivatives == nullptr) continue;

    auto by_value = derivatives->by_value.middleRows<3>(3 * i);
    auto by_axis = derivatives->by_axis.middleRows<3>(3 * i);
    const Vector3d q2 = R[2] * q, q1 = R[1] * q2, q0 = R[0] * q1;
    by_value.middleCols<3>(kX) = kRadPerDeg * A * rotated_by_vector(X, x, q0);
    by_value.middleCols<3>(kY) = kRadPerDeg * A * XR * rotated_by_vector(Y, y, p);
    by_value.middleCols<3>(kOffset) = A * XR;
    by_value.middleCols<3>(kCentre) = A;
    // Axis j turned by d: R_j is exp of the rotation vector angle * axis.
    const Matrix3d AX0 = A * X * R[0];
    const double t1 = at.angles[order_[1]], t2 = at.angles[order_[2]];
    by_value.col(kTilt) =
        kRadPerDeg * t1 * AX0 * (rotated_by_vector(R[1], t1 * axes[1], q2) * d_second);
    const Matrix3d third = kRadPerDeg * t2 * AX0 * R[1] * rotated_by_vector(R[2], t2 * axes[2], q);
    by_value.col(kTilt + 1) = third * d_third_1;
    by_value.col(kTilt + 2) = third * d_third_2;
    for (int k = 0; k < 2; ++k) {
      Vector3d d = scale * s * Vector3d::Unit(k);
      if (stage_made_) d -= real.z() * Vector3d::Unit(k);
      by_value.col(kLean + k) = kRadPerDeg * (1.0 + lean(k) * lean(k)) * d;
    }
    by_value.col(kScale) = s * A * travel;
    if (stage_made_) by_value(2, kScale) -= real.z() / (scale * scale);
    if (i > 0) by_value.middleCols<3>(kPoints + 3 * (i - 1)) = A * XR * Y;

    by_axis.col(0) = scale * A * travel;
    const std::array<Vector3d, 3> turn{X * axes[0].cross(q0), X * R[0] * axes[1].cross(q1),
                                       X * R[0] * R[1] * axes[2].cross(q2)};
    for (std::size_t j = 0; j < 3; ++j) {
      const auto column = std::ranges::find(kAllAxes, order_[j]) - kAllAxes.begin();
      by_axis.col(column) = kRadPerDeg * A * turn[j];
    }
  }
  return out;
}

Gimbal RigModel::gimbal(const Eigen::VectorXd& v) const {
  GimbalConfig config = gimbal_;
  config.plane_from_gimbal_deg = v.segment<3>(kX);
  config.axis_tilt_deg = v.segment<3>(kTilt);
  config.centre_at_stage_zero_mm = v.segment<3>(kCentre);
  return Gimbal(config);
}

Calibration RigModel::camera(const Eigen::VectorXd& v, const Calibration& calibration) const {
  Calibration out = calibration;
  if (!stage_made_) return out;
  const Vector2d lean(std::tan(kRadPerDeg * v(kLean)), std::tan(kRadPerDeg * v(kLean + 1)));
  const double scale = v(kScale);
  const IrtModel& irt = calibration.irt;
  // What was named (x, y) at height z stood at (x, y) + S l z and at height S z. The first basis
  // function is 1.
  const RayPlanes planes{scale * irt.planes().a_mm, scale * irt.planes().b_mm};
  Eigen::MatrixX4d coefficients = irt.coefficients();
  coefficients.row(0).head<2>() += planes.a_mm * lean.transpose();
  coefficients.row(0).tail<2>() += planes.b_mm * lean.transpose();
  out.irt = IrtModel(irt.image_size(), planes, irt.order(), std::move(coefficients),
                     irt.domain_hull_px());
  out.irt.set_covariance(irt.covariance());
  for (CentralModel& model : out.central) model.lean -= lean;
  return out;
}

bool made_on_stage(const Calibration& calibration, const Plan& plan) {
  return !calibration.stage.empty() || calibration.source == calibration_source(plan);
}

std::vector<ArrivalNumbers> arrival_numbers(const RunRecord& record) {
  const Plan& plan = record.plan;
  std::vector<const TakenPose*> taken(plan.poses.size(), nullptr);
  for (const TakenPose& pose : record.poses) taken[pose.planned.index] = &pose;
  // Poses are taken in the plan's order: a session's first one comes after as many as those before it
  // have taken.
  std::vector<std::size_t> session_begins;
  std::size_t before = 0;
  for (const RunSession& session : record.sessions) {
    session_begins.push_back(before);
    const auto found = session.events.find("primary");
    if (found != session.events.end()) before += static_cast<std::size_t>(found->second);
  }

  std::vector<ArrivalNumbers> out(plan.poses.size());
  ArrivalNumbers now{};
  std::size_t done = 0;
  const PlannedPose* last = nullptr;
  const TakenPose* last_taken = nullptr;
  for (std::size_t k = 0; k < plan.poses.size(); ++k) {
    const PlannedPose& pose = plan.poses[k];
    const bool session =
        taken[k] != nullptr && done > 0 && std::ranges::count(session_begins, done) > 0;
    for (std::size_t a = 0; a < kAllAxes.size() && last != nullptr; ++a) {
      const double from = last->target(kAllAxes[a]), to = pose.target(kAllAxes[a]);
      const bool through_zero = pose.payload != last->payload && (from != 0.0 || to != 0.0);
      const bool missed = last_taken != nullptr && last_taken->axis(kAllAxes[a]).missed;
      if (from != to || through_zero || missed || session) ++now[a];
    }
    out[k] = now;
    last = &pose;
    if (taken[k] != nullptr) {
      ++done;
      last_taken = taken[k];
    }
  }
  return out;
}

}  // namespace turntable
