// Errors about the world, by cause, under one root. What is only a result (a solver that did not
// converge, a target not seen) is a value that becomes a row of a table, never an exception.
#pragma once

#include <stdexcept>
#include <string>

namespace turntable {

/// Root of everything the project throws about the world. Messages name the axis or place, what was
/// found, what is allowed (with unit) and what to do.
class Error : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// The byte channel is gone or cannot be opened (unplugged, refused, closed by the peer).
class LineError : public Error {
 public:
  using Error::Error;
};
/// Nothing, or not enough, arrived before a deadline.
class TimeoutError : public Error {
 public:
  using Error::Error;
};
/// The device, or a gateway before it, says that it is busy: the same may be asked again a little later.
class BusyError : public TimeoutError {
 public:
  using TimeoutError::TimeoutError;
};
/// An exchange ended early because a stop waited for the line: nothing is wrong with the device.
class GaveWay : public TimeoutError {
 public:
  using TimeoutError::TimeoutError;
};
/// Bytes arrived that the protocol does not allow.
class ProtocolError : public Error {
 public:
  using Error::Error;
};
/// A target lies outside what is allowed. Thrown before any byte leaves.
class LimitError : public Error {
 public:
  using Error::Error;
};
/// The device answered, and said no; or it is not in a state in which it may move.
class DeviceError : public Error {
 public:
  using Error::Error;
};
/// An axis could not be stopped, or not be seen to stand: a person has to.
class NotStopped : public DeviceError {
 public:
  using DeviceError::DeviceError;
};
/// A run folder cannot be read or written.
class RecordError : public Error {
 public:
  using Error::Error;
};
/// A person asked to stop (signal). Level 1 is honoured between poses, level 2 at once.
class Interrupted : public Error {
 public:
  using Error::Error;
};

/// Bad input: a file, an argument, an image.
class ConfigError : public Error {
 public:
  /// `pointer` is an RFC 6901 JSON pointer into `file`; empty for input that is not JSON.
  ConfigError(std::string file, std::string pointer, const std::string& message)
      : Error(file + (pointer.empty() ? "" : " at " + pointer) + ": " + message),
        file_(std::move(file)),
        pointer_(std::move(pointer)),
        message_(message) {}

  const std::string& file() const { return file_; }
  const std::string& pointer() const { return pointer_; }
  /// Without file and pointer.
  const std::string& message() const { return message_; }

 private:
  std::string file_;
  std::string pointer_;
  std::string message_;
};

}  // namespace turntable
