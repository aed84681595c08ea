// The rig as it may really be: what drawings leave open, as numbers, and where they put each LED for
// the camera. What self-calibration (self_calibration.h) estimates and an error budget varies.
//   R(t)  = R_1(t_1) R_2(t_2) R_3(t_3)      base outwards, about axes that may miss right angles
//   x_i   = c + s S (l_x, l_y, 1) + X R(t) (o + Y p_i)
//   X     R_plane_from_gimbal, exp of a rotation vector     Y     R_table_from_target, likewise
//   c     gimbal centre with the stage at 0, mm             o     M0 from it at zero angles, mm
//   p_i   LED in the target frame, M0 at 0, mm              s     stage position, mm
//   l     tangent of the lean of the stage's travel         S     its real over its stated travel
// Source: mathematics of the rig, section 7; derivatives by the right Jacobian of the rotation group
// (J. Sola et al., arXiv 1812.01537, eq. 143).
//
// Rays of a calibration that was made on this stage carry the stage's errors: the pattern rode on it,
// and what it is said to have shown at height z stood at S z (l_x, l_y, 1) instead. In their frame
//   x' = x - l_x z,  y' = y - l_y z,  z' = z / S
// so that the stage's own travel is (0, 0, s) there, and its lean shows as a sheared target.
//
// Gauge. All rotary axes turned alike are X (and Y turned back); so the first axis, base outwards, is
// taken as drawn, the second in its drawn plane with the first, and three tilts remain. An angle that
// reads wrong by a constant is in X, a tilt, and Y: of the first, second and third axis. Target points
// turned alike are Y, and moved alike are o: M0 stays at 0, and tolerances tell the rest apart.
// Units: mm, deg. Domain: errors small enough for one linear step to be nearly right (degrees, mm).
#pragma once

#include <array>
#include <span>
#include <string>
#include <vector>

#include "src/geometry/gimbal.h"
#include "src/imaging/calibration.h"
#include "src/record/run_folder.h"

namespace turntable {

/// Values by name. As one list of numbers: `RigModel::values`.
struct RigParameters {
  Vector3d plane_from_gimbal_deg = Vector3d::Zero();  ///< rotation vector X
  Vector3d table_from_target_deg = Vector3d::Zero();  ///< rotation vector Y
  Vector3d target_offset_mm = Vector3d::Zero();       ///< o
  Vector3d gimbal_centre_mm = Vector3d::Zero();       ///< c
  Vector3d axis_tilt_deg = Vector3d::Zero();          ///< as GimbalConfig::axis_tilt_deg
  Vector2d stage_squareness_deg = Vector2d::Zero();   ///< lean towards x and towards y
  double stage_scale = 1.0;
  std::vector<Vector3d> target_points_mm;  ///< target frame; the first one stays at 0
};

/// What kind of thing a parameter is, for tables and tests; in the order of the list.
enum class ParameterGroup { kMounting, kTargetMounting, kOffset, kCentre, kAxes, kStage, kTarget };

struct RigParameter {
  std::string name;  ///< "plane_from_gimbal_x", "target_2_z"
  std::string unit;  ///< "deg", "mm" or "1"
  std::string what;  ///< for people
  ParameterGroup group{};
  double drawing = 0.0;  ///< what the rig file states
  Tolerance prior;       ///< standard uncertainty of that, in the unit, and its source
};

/// How the table stands.
struct TablePosition {
  double stage_mm = 0.0;
  GimbalAngles angles;  ///< rad
};

class RigModel {
 public:
  /// @param stage_made_frame the rays' calibration was made on this stage (`made_on_stage`)
  RigModel(const RigFile& rig, bool stage_made_frame);

  /// One entry per number of `values`; the same order always: mounting, target mounting, offset,
  /// centre, tilts, squareness, scale, points without M0.
  const std::vector<RigParameter>& parameters() const { return parameters_; }
  int size() const { return static_cast<int>(parameters_.size()); }
  int points() const { return points_; }
  bool stage_made_frame() const { return stage_made_; }
  Eigen::VectorXd drawing() const;
  Eigen::VectorXd prior_sd() const;
  /// Two standard deviations of an arrival make up the rig file's repeatability; unit of the axis, by
  /// order of kAllAxes.
  const std::array<double, kAllAxes.size()>& arrival_sd() const { return arrival_sd_; }

  Eigen::VectorXd values(const RigParameters& parameters) const;
  RigParameters named(const Eigen::VectorXd& values) const;

  /// Derivatives of the LEDs' places: rows 3 i + (x, y, z) of LED i.
  struct Derivatives {
    Eigen::MatrixXd by_value;  ///< 3 n x size(): mm per unit of the parameter
    Eigen::Matrix<double, Eigen::Dynamic, 4> by_axis;  ///< 3 n x 4, kAllAxes: mm per mm, per deg
  };
  /// Every LED in the frame of the rays, mm: 3 n numbers, as above.
  /// @param values size() numbers. @param derivatives filled in if there.
  Eigen::VectorXd leds(const Eigen::Ref<const Eigen::VectorXd>& values, const TablePosition& at,
                       Derivatives* derivatives = nullptr) const;

  /// The gimbal with the axes that these values give it. Attitudes relative to an initial pose are
  /// those of the target in an orthonormal frame: R(t) R(0)^T.
  Gimbal gimbal(const Eigen::VectorXd& values) const;
  /// The camera with rays in the orthonormal frame, where a solver sees the target unsheared. The
  /// same one if the calibration was not made on this stage. Of central models the lean alone is
  /// taken back: what a stretched travel did to them in turn is below what anybody would see.
  Calibration camera(const Eigen::VectorXd& values, const Calibration& calibration) const;

 private:
  GimbalConfig gimbal_;
  bool stage_made_;
  int points_;
  std::array<AxisId, 3> order_;
  std::array<Vector3d, 3> axes_;  ///< drawn ones, base outwards
  std::vector<RigParameter> parameters_;
  std::array<double, kAllAxes.size()> arrival_sd_;
};

/// True if the camera was calibrated by a sweep of a stage, which is taken to be the run's: its rays
/// then carry the stage's errors.
bool made_on_stage(const Calibration& calibration, const Plan& plan);

/// Which arrival of each axis (kAllAxes) a pose was taken after, counted from 0 axis by axis. Poses
/// with the same number share the arrival's random error.
using ArrivalNumbers = std::array<int, kAllAxes.size()>;
/// By place in the plan, for all its poses, taken or not. An axis arrives when it is asked for another
/// place than before; after it missed one; after a change of the payload, which leads through zero,
/// unless it stays there; and when a session begins.
std::vector<ArrivalNumbers> arrival_numbers(const RunRecord& record);

}  // namespace turntable
