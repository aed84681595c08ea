// The rig: named axes and a camera. A plain struct; what it is made of (real or simulated devices,
// the lines between them) stays alive in `owned` and is nobody else's business.
#pragma once

#include <functional>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "src/core/axis.h"
#include "src/core/camera.h"
#include "src/core/clock.h"
#include "src/core/rig_file.h"

namespace turntable {

/// What the rig file calls a channel of telemetry.
struct Channel {
  std::string name;
  /// In the channel's unit. @throws DeviceError, TimeoutError, ProtocolError, LineError.
  std::function<double()> read;
};

struct Rig {
  Clock* clock = nullptr;
  Axis<Millimetres>* stage = nullptr;
  Axis<Degrees>* yaw = nullptr;
  Axis<Degrees>* roll = nullptr;
  Axis<Degrees>* pitch = nullptr;
  Camera* camera = nullptr;
  std::vector<Channel> channels;  ///< by order of the rig file
  bool simulated = false;
  /// Stops every axis: first all commands, then all verifications. Any thread, any state. Empty =
  /// axis by axis.
  std::function<void()> stop_all;
  /// For whoever waits while the axes stand: keeps lines open that are closed when nobody uses them.
  /// Empty = nothing to keep.
  std::function<void()> keep_alive;
  /// A person vouches that these axes were homed since their controllers were switched on.
  /// Throws if a controller knows better.
  std::function<void(std::span<const AxisId>)> trust_references;
  /// Puts a payload on the table: a person on a real rig, the world on a simulated one. Throws if
  /// refused.
  std::function<void(Payload)> mount;
  /// One line per device: what it says it is.
  std::vector<std::string> identities;

  std::vector<std::shared_ptr<void>> owned;  ///< destroyed last to first

  Rig() = default;
  Rig(Rig&&) = default;
  Rig& operator=(Rig&&) = delete;
  Rig(const Rig&) = delete;
  Rig& operator=(const Rig&) = delete;
  ~Rig() {
    while (!owned.empty()) owned.pop_back();
  }
};

/// Calls f(Axis<Q>&) with the axis' own unit.
template <class F>
auto with_axis(const Rig& rig, AxisId id, F&& f) {
  switch (id) {
    case AxisId::kStage:
      return f(*rig.stage);
    case AxisId::kYaw:
      return f(*rig.yaw);
    case AxisId::kRoll:
      return f(*rig.roll);
    case AxisId::kPitch:
      break;
  }
  return f(*rig.pitch);
}

}  // namespace turntable
