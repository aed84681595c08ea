// Attitude solvers behind one table. A solver is a free function in a file pair of its own plus one
// line of `kSolvers` (solver.cpp); the command line, the law tests, the benchmark and the report
// iterate the table.
#pragma once

#include <limits>
#include <span>
#include <string_view>

#include "src/attitude/target.h"
#include "src/geometry/ray.h"
#include "src/geometry/rotation.h"

namespace turntable {

/// What a solver sees of an image, and with it the frame its answer is in.
enum class Sight {
  kRays,        ///< rays of the calibrated camera; answers R_plane_from_target
  kPinholeRaw,  ///< a distortion-free pinhole applied to the pixels; answers R_camera_from_target
  kPinholeUndistorted,  ///< pinhole after removing distortion; answers R_camera_from_target
};
std::string_view sight_name(Sight sight);  ///< "rays", "pinhole_raw", "pinhole_undistorted"
/// Frame of the answer: "plane" (z towards the camera) or "camera" (x right, y down, z forward).
std::string_view frame_name(Sight sight);

/// One image of the target, in the target's order of points. Only the members of the solver's sight
/// are read.
struct Observation {
  std::span<const Ray> rays;  ///< kRays: one per point, mm in the plane frame
  RayPlanes planes;           ///< kRays
  /// Pinhole sights: (x/z, y/z) of each point in the camera frame, made by the camera model of the
  /// sight.
  std::span<const Vector2d> normalised;
};

enum class SolveStatus {
  kConverged,
  kHeightUndefined,  ///< attitude converged; the rays are too parallel to tell the height
  kNotConverged,     ///< max_iterations passed; the last iterate is in the solution
  kDegenerate,  ///< the observation does not determine an attitude (coincident rays, points behind
                ///< the camera, divergence)
  kInvalidInput,  ///< wrong number of points, NaN or infinity, planes out of order
};
/// "converged", "height_undefined", "not_converged", "degenerate", "invalid_input".
std::string_view status_name(SolveStatus status);

struct SolveOptions {
  /// Largest change of any point's iterate from pass to pass; in `Solver::tolerance_unit`.
  double tolerance = 1e-9;
  int max_iterations = 200;
};

/// What a solve came to. Every number is finite when the status is kConverged.
struct Solution {
  SolveStatus status = SolveStatus::kInvalidInput;
  /// R_plane_from_target (kRays) or R_camera_from_target (pinhole sights): the rotation nearest to
  /// rows_ijk.
  Matrix3d R = Matrix3d::Constant(kNaN);
  /// i, j, k as the method leaves them: not exactly orthonormal under noise.
  Matrix3d rows_ijk = Matrix3d::Constant(kNaN);
  /// M0 in the same frame, mm; z is the paper's m (kRays) or Z0 (pinhole). z is NaN when the height
  /// is undefined.
  Vector3d position_mm = Vector3d::Constant(kNaN);
  int iterations = 0;
  /// Root mean square over the points: distance from the ray, mm (kRays), or reprojection, in
  /// normalised units (pinhole; times the focal length it is in pixels).
  double residual = kNaN;

  bool has_attitude() const {
    return status == SolveStatus::kConverged || status == SolveStatus::kHeightUndefined;
  }

  static constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
};

/// Rows i and j are perpendicular without noise. When the sine of their angle ends below this, what
/// is left is not an attitude with an error but no attitude: kDegenerate.
constexpr double kMinSine = 0.1;

/// Never throws, never allocates, and may be called from several threads at once.
using SolveFunction = Solution (*)(const TargetModel&, const Observation&, const SolveOptions&);

struct Solver {
  std::string_view name;   ///< for command lines and tables
  std::string_view title;  ///< for people
  Sight sight;
  SolveFunction function;
  SolveOptions defaults;
  std::string_view tolerance_unit;
  std::string_view reference;  ///< where the method is published

  Solution operator()(const TargetModel& target, const Observation& observation) const {
    return function(target, observation, defaults);
  }
};

extern const std::span<const Solver> kSolvers;
/// @return nullptr if there is no such row.
const Solver* find_solver(std::string_view name);

}  // namespace turntable
