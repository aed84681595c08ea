// One program per line. A rig's real lines are claimed by names that the kernel keeps for as long as
// the process lives (abstract sockets): a crash, kill -9 included, leaves nothing behind. Whoever
// asks at such a name is told who is there, and may order a stop: it works while another process
// runs a campaign on the rig, for every user of the machine.
#pragma once

#include <chrono>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "src/core/rig_file.h"

namespace turntable {

class RigLock {
 public:
  /// Claims every serial and TCP line of the rig (none on a simulated rig). While it lives, a stop
  /// ordered by another process acts like SIGTERM: the axes are stopped at once.
  /// Waits for two seconds for somebody who only asks, then gives up.
  /// @param doing for the others: "run scenarios/quick.json".
  /// @param run the folder of the run that is taken, if any: it is claimed too, simulated rig or not,
  /// so that `tell_run` finds this process and no two take the same run.
  /// @throws DeviceError naming who has a line. Nothing has been opened then.
  RigLock(const RigFile& rig, const std::string& doing, const std::filesystem::path& run = {});
  /// The same for one serial port or "host:port".
  RigLock(const std::string& line, const std::string& doing);
  ~RigLock();
  RigLock(RigLock&&) noexcept;

 private:
  class Server;
  std::unique_ptr<Server> server_;
};

/// Who has a line.
struct LineHolder {
  std::string line;  ///< "/dev/ttyUSB0", "10.0.0.7:4001"
  std::string who;   ///< "process 4711: turntable run ..., since 2026-01-31T12:00:00Z"
};

/// Of a rig's lines, those that are claimed.
std::vector<LineHolder> line_holders(const RigFile& rig);
/// The same for one serial port or "host:port"; nothing if it is free.
std::optional<LineHolder> line_holder(const std::string& line);

/// Tells whoever takes poses in `run`: "pause", "resume" or "stop". @return who it was; nothing if
/// nobody does.
std::optional<std::string> tell_run(const std::filesystem::path& run, const std::string& word);

/// An order to stop, to whoever has a line.
class StopOrder {
 public:
  /// Gives it, and wakes a holder that was suspended, as far as this user may. To nobody if the line is
  /// free.
  explicit StopOrder(const LineConfig& line);
  /// Waits until he has let go, which is after his axes have been stopped. @return who it was; nothing
  /// if the line was free. @throws NotStopped if he still holds on, or does not answer.
  std::optional<LineHolder> wait(std::chrono::milliseconds timeout) const;

 private:
  std::optional<LineHolder> holder_;
  std::string asleep_;               ///< why he cannot be woken; empty = he is awake
  std::shared_ptr<int> connection_;  ///< -1 if he does not answer
};

}  // namespace turntable
