// What is asked: scenario and campaign files (scenarios/README.md lists every field with its unit).
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "src/record/plan.h"

namespace turntable {

/// One axis and the angles it visits, deg, in the file's order.
struct AxisRange {
  AxisId axis{};
  std::vector<double> values_deg;
};

enum class PoseOrder {
  kAsWritten,  ///< every inner range starts again at its first value
  kSnake,      ///< inner ranges run back and forth: no long way back
  kNearest,    ///< always on to the pose that is reached soonest, by the axes' own move times
  kRandom,     ///< shuffled by `order_seed`: drift cannot look like an effect of an angle
};
std::string_view pose_order_name(PoseOrder order);  ///< "as_written", "snake", "nearest", "random"
inline constexpr PoseOrder kPoseOrders[] = {PoseOrder::kAsWritten, PoseOrder::kSnake,
                                            PoseOrder::kNearest, PoseOrder::kRandom};

struct CalibrationPlane {
  double stage_mm = 0.0;
  bool fit = true;  ///< false: kept out of the fit, to judge it
};

struct PinholeView {
  double stage_mm = 0.0, yaw_deg = 0.0, roll_deg = 0.0, pitch_deg = 0.0;
};

struct Scenario {
  std::string file;  ///< as named in messages
  std::string text;  ///< as read, for the frozen copy
  std::string name;
  std::string title;
  ScenarioKind kind = ScenarioKind::kAttitude;
  double dwell_s = 0.0;
  /// Attitude: of the whole series, each with its reference pose. Calibration: of the sweep of planes;
  /// pinhole views are taken once, behind the last.
  int repeats = 1;
  std::size_t pose_count() const;  ///< of one repeat, with its reference pose
  std::size_t total_poses() const;

  // attitude
  Payload payload = Payload::kLedTarget;
  std::optional<int> table;
  double stage_mm = 0.0;
  std::vector<AxisRange> ranges;  ///< outermost first
  PoseOrder order = PoseOrder::kAsWritten;
  std::uint64_t order_seed = 1;  ///< kRandom; repeats are shuffled differently
  int return_every = 0;  ///< a pose at zero angles after so many poses, to see drift; 0 = never
  int images_per_pose = 1;

  // calibration
  std::vector<CalibrationPlane> planes;
  int images_per_plane = 1;
  int polynomial_order = 5;            ///< or kOrderByResiduals
  bool return_to_first_plane = false;  ///< once more at the very end: what has drifted?
  std::vector<PinholeView> pinhole_views;
};

struct Campaign {
  std::string file;
  std::string text;
  std::string name;
  std::string title;
  std::vector<Scenario> scenarios;  ///< in order; `repeats` already as the campaign's step says
};

/// Most poses a plan may have: more is a slip of the pen (a step of 0.001 on three axes).
constexpr std::size_t kMaxPoses = 1'000'000;
/// Most poses of one repeat in order "nearest", whose planning takes their square.
constexpr std::size_t kMaxNearestPoses = 10'000;

/// @throws ConfigError with file and JSON pointer: schema, step 0 or of the wrong sign, a range
/// that its step does not divide, an axis given twice, fewer than two planes to fit, keys of the
/// other kind, too many poses.
Scenario load_scenario(const std::filesystem::path& file);
Scenario parse_scenario(const std::string& text, const std::string& name);

/// Reads a campaign, or a single scenario as a campaign of one step.
/// @throws ConfigError as above, and: a missing scenario file, two scenarios of one name.
Campaign load_campaign(const std::filesystem::path& file);

}  // namespace turntable
