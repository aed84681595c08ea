// Several simulated Modbus controllers on one RS-485 line. Half duplex: everybody hears what the master
// sends, and who talks into an answer spoils it and is not heard.
#pragma once

#include <optional>
#include <vector>

#include "drivers/sim/controller_simulator.h"

namespace turntable::sim {

class Bus final : public Actor {
 public:
  /// @param simulators have to outlive it. @param gateway they are behind one Modbus TCP gateway, which
  /// keeps frames apart by itself.
  explicit Bus(std::vector<ControllerSimulator*> simulators, bool gateway = false);
  ~Bus() override;
  Bus(const Bus&) = delete;
  Bus& operator=(const Bus&) = delete;

  /// Takes the far end of the line; drops the one it had.
  void plug(Line line) { line_.emplace(std::move(line)); }
  bool plugged() const { return line_.has_value(); }

  /// Requests that were sent into an answer, and those that came too soon after what was before.
  int collisions() const { return collisions_; }
  int too_soon() const { return too_soon_; }

  int descriptor() const override { return line_ ? line_->descriptor() : -1; }
  std::optional<Time> next_due() const override { return std::nullopt; }
  void act(Time now) override;

 private:
  std::optional<Line> line_;
  std::vector<ControllerSimulator*> simulators_;
  bool gateway_;
  int collisions_ = 0, too_soon_ = 0;
};

}  // namespace turntable::sim
