// A plan: every pose of a run, frozen before anything moves, with copies of the files it was made
// from. Poses are joined with what happened by `PlannedPose::id`, never by their place in a list.
#pragma once

#include <cstddef>
#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "src/core/rig_file.h"
#include "src/geometry/gimbal.h"

namespace turntable {

enum class ScenarioKind { kCalibration, kAttitude };
std::string_view scenario_kind_name(ScenarioKind kind);  ///< "calibration", "attitude"

enum class PoseRole {
  kReference,    ///< zero angles at the start of a repeat; attitudes are relative to it
  kMeasure,      ///< an attitude to be judged
  kReturn,       ///< zero angles again, in the middle of a repeat: what has drifted?
  kPlaneFit,     ///< calibration plane used by the fit
  kPlaneCheck,   ///< calibration plane kept out of the fit
  kPinholeView,  ///< tilted pattern for the pinhole baseline
};
/// "reference", "measure", "return", "plane_fit", "plane_check", "pinhole_view"
std::string_view role_name(PoseRole role);

struct PlannedPose {
  std::size_t index = 0;     ///< place in the order of execution, from 0
  std::string id;            ///< 16 hex digits, unique in the plan (see `pose_id`)
  std::size_t scenario = 0;  ///< in Plan::scenarios
  PoseRole role = PoseRole::kMeasure;
  Payload payload = Payload::kLedTarget;
  int repeat = 1;  ///< from 1; of the series, or of the sweep of planes
  /// Attitude: visit within the repeat, 0 = reference; calibration: entry of planes or
  /// pinhole_views.
  int point = 0;
  double stage_mm = 0.0;
  double yaw_deg = 0.0;
  double roll_deg = 0.0;
  double pitch_deg = 0.0;
  double dwell_s = 0.0;  ///< wait after the axes have settled
  int images = 1;

  double target(AxisId axis) const;  ///< mm or deg
  GimbalAngles angles() const;       ///< rad
};

/// Polynomial order that is left to the residuals ("auto" in scenario files).
constexpr int kOrderByResiduals = 0;

struct ScenarioInfo {
  std::string name;
  std::string title;
  std::string file;  ///< as named in messages
  ScenarioKind kind = ScenarioKind::kAttitude;
  std::optional<int> table;  ///< published table this scenario repeats: 3, 4 or 5
  int polynomial_order = 5;  ///< calibration only; or kOrderByResiduals
  int repeats = 1;
  /// Attitude: axes with a range, outermost first (entry i is /ranges/i).
  std::vector<AxisId> axes;
};

/// A copy of a file as it was when the plan was made.
struct FrozenText {
  std::string file;
  std::string text;
  std::string sha256;
};
FrozenText freeze(std::string file, std::string text);

struct Plan {
  std::string name;
  std::string title;
  FrozenText rig;
  std::vector<FrozenText> sources;  ///< campaign first (if any), then one file per scenario, then
                                    ///< descriptions of controllers that are files
  std::vector<ScenarioInfo> scenarios;
  std::vector<PlannedPose> poses;

  const ScenarioInfo& scenario_of(const PlannedPose& pose) const {
    return scenarios[pose.scenario];
  }
};

/// Hash of scenario name, role, targets and repeat; `occurrence` (from 0) tells visits of the same
/// place apart.
std::string pose_id(const PlannedPose& pose, std::string_view scenario_name, int occurrence);
/// Fills `index` and `id` of every pose.
void number_poses(Plan& plan);

/// plan.json, one line per pose (schema "plan"), piece by piece.
void write_plan(const Plan& plan, const std::function<void(std::string_view)>& write);
std::string plan_text(const Plan& plan);
std::string plan_sha256(const Plan& plan);  ///< of plan.json
/// @throws ConfigError: not a plan, frozen copies or ids that do not match their hashes, ids that
/// are not unique.
Plan parse_plan(std::string_view text, const std::string& name);
Plan load_plan(const std::filesystem::path& file);

}  // namespace turntable
