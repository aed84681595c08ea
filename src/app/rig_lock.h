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
  /// @throws DeviceError naming who has a line. Nothing has been opened then.
  RigLock(const RigFile& rig, const std::string& doing);
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

/// Orders whoever has a line to stop its axes, and waits until he has let go. @return who it was;
/// nothing if the line is free. @throws NotStopped if he still holds on, or does not answer.
std::optional<LineHolder> order_stop(const LineConfig& line, std::chrono::milliseconds timeout);

}  // namespace turntable
