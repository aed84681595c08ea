// A simulated controller: device models behind a wire format, at the far end of a line.
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <vector>

#include "drivers/sim/axis_model.h"
#include "drivers/sim/faults.h"
#include "protocols/line.h"
#include "src/core/clock.h"
#include "src/core/rig_file.h"

namespace turntable::sim {

/// What a simulator is made from.
struct SimulatorSetup {
  std::vector<AxisConfig> axes;       ///< those on this controller, as it is set up at power-up
  std::map<AxisId, AxisTruth> truth;  ///< missing = ideal
  std::uint64_t seed = 0;
};

/// Keeps its state while clients come and go, as a controller does while its cable is plugged and
/// unplugged.
class ControllerSimulator : public Actor {
 public:
  /// Takes the far end of a line; drops the one it had.
  void plug(Line line) { line_.emplace(std::move(line)); }
  void unplug() { line_.reset(); }
  bool plugged() const { return line_.has_value(); }
  int descriptor() const override { return line_ ? line_->descriptor() : -1; }

  virtual void add_fault(Fault fault) = 0;
  /// @throws std::out_of_range if the axis is not on this controller.
  virtual const AxisModel& axis(AxisId id) const = 0;

 protected:
  std::optional<Line> line_;
};

}  // namespace turntable::sim
