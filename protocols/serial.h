// Serial ports and ptys.
#pragma once

#include <string>
#include <vector>

#include "protocols/line.h"
#include "src/core/rig_file.h"

namespace turntable {

/// Opens `path` with 8 data bits, without flow control. Symbolic links are followed. A pty is opened
/// raw through termios, because libserialport knows only ports listed by the kernel. The port is held
/// with flock, as terminals and other libraries hold it, and with TIOCEXCL.
/// @param baud bits per second; has no effect on a pty.
/// @throws LineError; where another program has the port, it is named as far as the system tells.
Line open_serial(const std::string& path, int baud, Parity parity = Parity::kNone,
                 int stop_bits = 1);

/// What stands for a line, whichever way a rig file names it: the port's own path, or "host:port".
/// Empty for a simulated line.
std::string line_id(const LineConfig& line);

/// A serial port that the system lists.
struct SerialPort {
  std::string path;         ///< /dev/ttyUSB0
  std::string description;  ///< "FT232R USB UART"
  std::string usb_id;       ///< "0403:6001 A10K0XYZ", empty if it is not on USB
  std::string by_id;        ///< "/dev/serial/by-id/...", which stays when numbers change; or empty
};
std::vector<SerialPort> list_serial_ports();

/// A new pty whose far end any program may open as if it were a serial port.
struct Pty {
  Line master;
  std::string path;  ///< of the far end, /dev/pts/N
};
/// The far end is also held open here, so that clients may come and go. @throws LineError.
Pty make_pty();

}  // namespace turntable
