#include "drivers/sim/bus.h"

#include <algorithm>
#include <array>

#include "drivers/sim/modbus_framer.h"
#include "src/core/errors.h"

namespace turntable::sim {
Bus::Bus(std::vector<ControllerSimulator*> simulators, bool gateway)
    : simulators_(std::move(simulators)), gateway_(gateway) {
  for (ControllerSimulator* simulator : simulators_)
    simulator->join_bus([this](std::string_view answer, Time now) {
      if (!line_) return;
      try {
        line_->write_available(answer, now);
      } catch (const LineError&) {
        line_.reset();
      }
    });
}

Bus::~Bus() {
  for (ControllerSimulator* simulator : simulators_) simulator->join_bus({});
}

void Bus::act(Time now) {
  std::array<char, 512> buffer;
  while (line_) {
    const auto last = line_->last_byte();
    const Time silence = last ? now - *last : Time::max();
    std::size_t n = 0;
    try {
      n = line_->read_available(buffer, now);
    } catch (const LineError&) {
      line_.reset();
      return;
    }
    if (n == 0) return;
    if (!gateway_ && silence < kRtuSilence) ++too_soon_;
    if (!gateway_ && std::ranges::any_of(simulators_, &ControllerSimulator::answering)) {
      ++collisions_;
      for (ControllerSimulator* simulator : simulators_) simulator->interrupt_answers();
      continue;
    }
    for (ControllerSimulator* simulator : simulators_)
      simulator->hear({buffer.data(), n}, now, silence);
  }
}

}  // namespace turntable::sim
