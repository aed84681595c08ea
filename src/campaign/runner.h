// Takes every pose of a plan: move, settle, trigger, archive, journal. The rig moves to pose k
// while a worker archives and inspects pose k-1; the journal keeps the plan's order.
#pragma once

#include <cstddef>
#include <functional>
#include <map>
#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <string>
#include <string_view>

#include "src/campaign/pace.h"
#include "src/core/rig.h"
#include "src/core/rig_file.h"
#include "src/record/image_archive.h"
#include "src/record/plan.h"
#include "src/record/run_folder.h"
#include "src/record/run_journal.h"

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
  /// What earlier runs on this rig have taught about its pace.
  Overheads overheads = {};

  int session() const {
    return before == nullptr ? 1 : static_cast<int>(before->sessions.size()) + 1;
  }
};

struct Progress {
  std::size_t done = 0;  ///< poses taken
  std::size_t total = 0;
  std::string_view phase;   ///< "homing", "mounting", "moving", "settling", "exposing", "paused",
                            ///< "suspended", "finishing"
  std::string_view reason;  ///< of a suspension
  double elapsed_s = 0.0;   ///< wall time
  double eta_s = 0.0;       ///< wall time left
  double rig_eta_s = 0.0;   ///< the same on the rig's clock: plan and overheads (pace.h)
};

/// Rig time, except `archive_s` (worker), `inspect_s` and `wall_s`.
struct AcquireSummary {
  std::size_t poses = 0;     ///< taken and journaled
  std::size_t failed = 0;    ///< of these: an axis missed its target, or too few spots were seen
  std::size_t doubtful = 0;  ///< of the others: with a complaint about an image after all retakes
  std::size_t trigger_retries = 0;
  std::size_t retakes = 0;  ///< images found bad at once and taken again
  double homing_s = 0.0, mount_s = 0.0, motion_s = 0.0, settle_s = 0.0, trigger_s = 0.0,
         transfer_s = 0.0;
  double held_s = 0.0;     ///< paused or suspended
  double rig_s = 0.0;      ///< all of it, with what no phase names
  double inspect_s = 0.0;  ///< wall time
  double archive_s = 0.0;  ///< worker busy, wall time; overlaps motion
  double waited_s = 0.0;   ///< rig waiting for the worker, wall time
  double wall_s = 0.0;
  Overheads overheads;  ///< as known at the end

  /// Seconds by phase, as the journal's stream "time" has them.
  std::map<std::string, double> phases() const;
};

/// What the devices said before anything moved.
struct DeviceCheck {
  std::optional<double> frame_s;   ///< trigger to frame, s; nothing if the camera does not expose
  int darkest = 0, brightest = 0;  ///< grey values of that frame
  std::optional<TelemetryReading> telemetry;
  std::string outside;  ///< channels that would hold the first pose, and why; empty if none
};

/// Asks the devices themselves whether they can carry the whole plan out: limits, image size, images
/// taken earlier, every channel of telemetry, and one exposure of a camera that exposes. Nothing
/// moves. Of a run that goes on, only what is still to be taken is asked for.
/// @throws LimitError, DeviceError, ConfigError, TimeoutError after as many triggers as the rig file
/// allows.
DeviceCheck check_devices(Rig& rig, const RigFile& rig_file, const Plan& plan,
                          const AcquireOptions& options = {});

/// Places in the plan of what is taken, in this order: overlap poses first (see
/// `AcquireOptions::overlap`), then the missing ones. Overlap poses stand before the first missing
/// one in the plan and show the same payload.
struct Schedule {
  std::vector<std::size_t> overlap, missing;
  std::vector<std::size_t> all() const;
};
Schedule schedule_of(const Plan& plan, const AcquireOptions& options);

/// Between poses it waits as long as a pause is asked for (core/interrupt.h) or a channel of telemetry
/// is outside its band, and journals it; the first Ctrl-C asks for a pause. An image that is found
/// bad at once (inspection.h) is taken again in place, as often as the rig file allows.
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
