// From scenarios to a frozen plan, and the checks that a whole plan has to pass before anything
// moves.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <limits>
#include <string>
#include <vector>

#include "src/campaign/scenario.h"
#include "src/core/rig_file.h"
#include "src/record/image_archive.h"
#include "src/record/plan.h"

namespace turntable {

/// Every pose in order of execution. Each repeat of an attitude scenario begins with a reference
/// pose. A calibration takes its planes repeat by repeat, then its pinhole views once (repeat 1),
/// then the return to the first plane (of the last repeat).
/// @throws ConfigError for more than kMaxPoses.
Plan plan_campaign(const Campaign& campaign, const RigFile& rig);

/// Where a disc should be seen, by the nominal camera: pixel centres at whole numbers, u to the
/// right, v down, origin top left.
struct ImagePoint {
  double depth_mm = 0.0;                                                ///< below the camera
  double u_px = std::numeric_limits<double>::quiet_NaN(), v_px = u_px;  ///< NaN if not visible
  double radius_px = u_px;
  bool visible() const { return radius_px >= 0.0; }  ///< false: at the camera's height or above it
};
/// What a pose should show: of the LED target every LED, in the rig file's order; of the pattern the
/// direction circles in that order, or, if it has none, the ends of its outer rows. No point is left
/// out, also not one outside the image; lens distortion is not known to the nominal camera.
std::vector<ImagePoint> predicted_points(const PlannedPose& pose, const RigFile& rig);

struct CheckOptions {
  ArchiveMode archive = ArchiveMode::kRegions;
  std::filesystem::path out;  ///< the run folder to be, for the free space; empty = not checked
};

/// Unit of the axis.
struct AxisSweep {
  double target_lower = 0.0, target_upper = 0.0;  ///< what is asked for
  double swept_lower = 0.0, swept_upper = 0.0;    ///< with overshoot and zero
  double limit_lower = 0.0, limit_upper = 0.0;    ///< soft limits
  double cable_lower = 0.0, cable_upper = 0.0;    ///< infinite = not stated
  std::size_t off_grid = 0;  ///< poses whose target is no place that the axis can be sent to
  double sent_step = 0.0;    ///< of the controller, where that is coarser than a pulse
  double margin() const;     ///< to the nearest soft limit or end of the cable
};

/// Transfer and inspection of one frame, before a rig has shown its own: what a triggered 1 Mpx camera
/// takes beside an exposure and a latency that the rig file states. s
constexpr double kFrameSeconds = 0.05;

struct PhaseTimes {
  double motion_s = 0.0, settle_s = 0.0, trigger_s = 0.0;
  AxisId slowest{};  ///< of the axes that move
  int legs = 0;      ///< its commands: two if it overshoots
  double total_s() const { return motion_s + settle_s + trigger_s; }
};

struct PlanReport {
  std::array<AxisSweep, kAllAxes.size()> axes;  ///< by order of kAllAxes
  PhaseTimes time;                ///< estimate, homing and changes of the payload by hand apart
  double field_margin_px = 0.0;   ///< nearest any predicted point comes to the edge of the image
  std::uintmax_t disk_bytes = 0;  ///< estimate of what will be written
  std::uintmax_t free_bytes = 0;  ///< 0 if not checked
  std::size_t images = 0;
  std::vector<std::string> remarks;  ///< what no check can decide and somebody should look at
};

/// One entry per pose: what it takes from the pose before it, the first one from zero angles.
/// Changing the payload leads through zero.
std::vector<PhaseTimes> pose_times(const Plan& plan, const RigFile& rig);
/// The same for some places of the plan, in the order in which they are taken.
std::vector<PhaseTimes> pose_times(const Plan& plan, const RigFile& rig,
                                   const std::vector<std::size_t>& places);

struct OrderTime {
  std::size_t scenario = 0;  ///< in the campaign
  PoseOrder order = PoseOrder::kAsWritten;
  bool chosen = false;
  double motion_s = 0.0;  ///< of all repeats
};
/// What each order of poses would take in motion, attitude scenarios only; "nearest" only where it
/// is allowed.
std::vector<OrderTime> order_times(const Campaign& campaign, const RigFile& rig);

/// Refuses, never clamps. @throws ConfigError listing the first ten violations and their number: a
/// target or its overshoot outside soft limits or cable range, a point outside the image, not enough disk. File
/// and pointer are the first one's.
PlanReport check_plan(const Plan& plan, const RigFile& rig, const CheckOptions& options = {});

/// What `turntable plan` prints.
std::string plan_summary(const Plan& plan, const PlanReport& report);
/// One row per pose: targets, estimated time of each phase and since the start (`time_s`, at its
/// end), and the box around all discs that it should show. @throws RecordError.
void write_plan_csv(const Plan& plan, const RigFile& rig, const std::filesystem::path& file);

/// JSON pointer, in the scenario's file, of what a pose's target on `axis` comes from.
std::string pointer_of(const Plan& plan, const PlannedPose& pose, AxisId axis);

}  // namespace turntable
