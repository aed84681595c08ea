// A motion controller: one line, one or more axes.
#pragma once

#include <exception>
#include <string>
#include <vector>

#include "protocols/shared_line.h"
#include "src/core/axis.h"
#include "src/core/clock.h"
#include "src/core/rig_file.h"

namespace turntable {

class Controller {
 public:
  virtual ~Controller() = default;
  /// What the device says it is, and where it was found.
  virtual std::string identity() const = 0;
  /// Finds out who is there and how it is set up; changes nothing and moves nothing. Differences
  /// from the rig file do not throw: they block motion (every start and home throws DeviceError)
  /// until `configure`.
  /// @return one line per difference: command, wanted, found. @throws TimeoutError, ProtocolError,
  /// DeviceError, LineError.
  virtual std::vector<std::string> connect() = 0;
  /// Writes the set-up of the rig file and verifies it by reading it back. Moves nothing.
  /// @throws DeviceError if the controller keeps another value.
  virtual void configure() = 0;
  /// nullptr if the axis is not on this controller or has the other unit.
  virtual Axis<Millimetres>* linear_axis(AxisId id) = 0;
  virtual Axis<Degrees>* rotary_axis(AxisId id) = 0;
  /// A person vouches that the axis was homed since the controller was switched on, and that nothing
  /// has gone wrong since. @throws DeviceError if the controller knows better.
  virtual void trust_reference(AxisId id) = 0;
  /// Switches a digital output of the rig file on and, after its pulse, off again.
  /// @throws ConfigError if there is no such output, DeviceError if the controller refuses.
  virtual void pulse_output(const std::string& name) = 0;
  /// Says something harmless if the line has been idle for long, and opens it again if it was closed
  /// meanwhile: serial servers close what nobody uses. For whoever waits while the axes stand. Trouble
  /// is left to the next command.
  virtual void keep_alive() = 0;
  /// Stops every axis: forbids all motion, sends all commands, then verifies. Any thread, any state.
  /// The first error of an axis that is not known to stand is thrown after all have been tried.
  void stop_all();
  /// The three parts of it, for a rig of several controllers: from the first on nothing starts. The
  /// second one throws nothing: whether an axis heard its stop is seen by the third.
  virtual void forbid_all() = 0;
  virtual void begin_stop_all() = 0;
  virtual void finish_stop_all() = 0;
};

/// Tries all of several things, and throws the first error afterwards.
class Attempts {
 public:
  template <class F>
  void operator()(F&& action) {
    try {
      action();
    } catch (...) {
      if (!first_) first_ = std::current_exception();
    }
  }
  void rethrow() const {
    if (first_) std::rethrow_exception(first_);
  }

 private:
  std::exception_ptr first_;
};

inline void Controller::stop_all() {
  forbid_all();
  begin_stop_all();
  finish_stop_all();
}

/// What a controller is opened with.
struct ControllerSetup {
  ControllerConfig controller;
  std::vector<AxisConfig> axes;  ///< those on this controller
  SharedLine line;               ///< other controllers may talk on it too
  Clock* clock;
};

}  // namespace turntable
