// Takes every pose of a plan: move, settle, trigger, archive, journal. The rig moves to pose k
// while a worker archives and inspects pose k-1; the journal keeps the plan's order.
#pragma once

#include <cstddef>
#include <functional>
#include <nlohmann/json_fwd.hpp>
#include <string>
#include <string_view>

#include "src/core/rig.h"
#include "src/core/rig_file.h"
#include "src/record/image_archive.h"
#include "src/record/plan.h"
#include "src/record/run_folder.h"

namespace turntable {

struct AcquireOptions {
  ArchiveMode archive = ArchiveMode::kRegions;
  int region_margin_px = kRegionMarginPx;
  std::size_t queued_poses = 8;  ///< poses waiting for the worker before the rig waits for it
  /// What earlier sessions took, if the run goes on: these poses are not taken again. nullptr = new.
  const RunState* before = nullptr;
  /// A run that goes on takes so many of the poses before the first missing one again, beside the
  /// ones that count (stream "overlap"): the difference says what the break has changed.
  std::size_t overlap = 2;

  int session() const {
    return before == nullptr ? 1 : static_cast<int>(before->sessions.size()) + 1;
  }
};

struct Progress {
  std::size_t done = 0;  ///< poses taken
  std::size_t total = 0;
  std::string_view phase;  ///< "homing", "mounting", "moving", "settling", "exposing", "paused",
                           ///< "finishing"
  double elapsed_s = 0.0;  ///< wall time
  double eta_s = 0.0;  ///< wall time left: the plan's kinematics, scaled by what poses took so far
};

/// Rig time, except `archive_s` (worker) and `wall_s`.
struct AcquireSummary {
  std::size_t poses = 0;   ///< taken and journaled
  std::size_t failed = 0;  ///< of these: an axis missed its target, or too few spots were seen
  std::size_t trigger_retries = 0;
  double homing_s = 0.0, motion_s = 0.0, settle_s = 0.0, trigger_s = 0.0, rig_s = 0.0;
  double archive_s = 0.0;  ///< worker busy, wall time; overlaps motion
  double waited_s = 0.0;   ///< rig waiting for the worker, wall time
  double wall_s = 0.0;
};

/// Asks the devices themselves whether they can carry the whole plan out: limits, image size, images
/// taken earlier. Nothing moves. @throws LimitError, DeviceError, ConfigError.
/// @param before of a run that goes on: only what is still to be taken is asked for.
void check_devices(Rig& rig, const RigFile& rig_file, const Plan& plan,
                   const AcquireOptions& options = {});

/// Places in the plan of what is taken, in this order: overlap poses first (see
/// `AcquireOptions::overlap`), then the missing ones. Overlap poses stand before the first missing
/// one in the plan and show the same payload.
struct Schedule {
  std::vector<std::size_t> overlap, missing;
};
Schedule schedule_of(const Plan& plan, const AcquireOptions& options);

/// Between poses it waits as long as a pause is asked for (core/interrupt.h), and journals it.
/// The plan must have passed `check_plan`; every target is checked again by the axes themselves,
/// and every exposure by the camera, before the first move. `provenance` goes into the start document as it is. Whatever ends the
/// run, all axes are stopped and the journal's stop document says why; poses already taken are
/// archived and journaled first.
/// @throws ConfigError if the camera cannot answer the plan; Interrupted, LimitError, TimeoutError, DeviceError, ProtocolError, LineError,
/// RecordError.
AcquireSummary acquire(Rig& rig, const RigFile& rig_file, const Plan& plan, const RunFolder& folder,
                       const nlohmann::json& provenance, const AcquireOptions& options = {},
                       const std::function<void(const Progress&)>& progress = {});

}  // namespace turntable
