// One degree of freedom, whatever turns it.
#pragma once

#include <string>

#include "src/core/units.h"

namespace turntable {

/// What an axis may be asked for.
template <class Q>
struct AxisLimits {
  Q lower;
  Q upper;
};

/// How a move ended. `missed` is data, not an error: it is written beside the pose.
template <class Q>
struct Arrival {
  Q position;           ///< read back from the controller after settling
  Q requested;          ///< what was asked for
  bool missed = false;  ///< still outside the tolerance after all retries
  int retries = 0;
  bool overshot = false;  ///< approached from the far side (one-sided approach)
};

/// Contract: limits are checked before any byte leaves; a motion command is sent exactly once;
/// every wait has a deadline; after any exception the caller calls `stop()`, which is allowed in
/// every state and from any thread.
template <class Q>
class Axis {
 public:
  virtual ~Axis() = default;
  virtual const std::string& name() const = 0;
  virtual AxisLimits<Q> limits() const = 0;

  /// Checks `target`, including the overshoot of a one-sided approach. @throws LimitError.
  virtual void check(Q target) const = 0;

  virtual bool homed() const = 0;
  /// Finds the reference; bounded in time. @throws TimeoutError, DeviceError, LineError,
  /// ProtocolError.
  virtual void home() = 0;

  /// Begins a move; several axes may be moving at once. @throws LimitError before anything is sent;
  /// DeviceError if not homed.
  virtual void start(Q target) = 0;
  /// Carries the move on without blocking for long. @return true once arrived and settled (see
  /// `arrival`).
  /// @throws TimeoutError past the move's deadline or when the axis stalls, DeviceError when the
  /// controller reports one.
  virtual bool advance() = 0;
  virtual Arrival<Q> arrival() const = 0;

  /// The controller's position (a pulse counter on open-loop stages).
  virtual Q position() = 0;
  /// What the controller tells of the axis now, for people: "stands", "moves, upper limit switch".
  virtual std::string condition() { return {}; }
  /// Time a move would take, s; used for plans and ETA.
  virtual double move_seconds(Q from, Q to) const = 0;
  /// Halts and verifies the halt; forgets any move under way. Never throws LimitError.
  virtual void stop() = 0;
};

}  // namespace turntable
