#include "protocols/serial.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <libserialport.h>
#include <stdlib.h>
#include <sys/ioctl.h>
#include <termios.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <filesystem>

#include "src/core/errors.h"

namespace turntable {
namespace {

[[noreturn]] void fail(const std::string& path, const std::string& why) {
  throw LineError(
      fmt::format("serial port {}: {}. Check that the device is plugged in and that you may use it "
                  "(on Debian: be a "
                  "member of the group dialout).",
                  path, why));
}

/// Without this the terminal would echo, and turn CR into LF.
void make_raw(int fd, const std::string& path) {
  termios settings{};
  if (::tcgetattr(fd, &settings) != 0) fail(path, std::strerror(errno));
  ::cfmakeraw(&settings);
  settings.c_cflag |= CLOCAL | CREAD;
  if (::tcsetattr(fd, TCSANOW, &settings) != 0) fail(path, std::strerror(errno));
}

Line open_pty(const std::string& path) {
  const int fd = ::open(path.c_str(), O_RDWR | O_NOCTTY | O_NONBLOCK | O_CLOEXEC);
  if (fd < 0) fail(path, std::strerror(errno));
  Line line(fd, path);
  make_raw(fd, path);
  return line;
}

Line open_port(const std::string& path, const std::string& shown, int baud, Parity parity,
               int stop_bits) {
  const auto last_error = [] {
    char* text = sp_last_error_message();
    std::string message = text != nullptr ? text : "unknown error";
    sp_free_error_message(text);
    return message;
  };
  const auto check = [&](sp_return result) {
    if (result == SP_OK) return;
    fail(shown, result == SP_ERR_FAIL
                    ? last_error()
                    : fmt::format("refused by the system ({})", static_cast<int>(result)));
  };
  sp_port* raw = nullptr;
  if (sp_get_port_by_name(path.c_str(), &raw) != SP_OK) fail(shown, "no such serial port");
  // The descriptor belongs to the port: closing it any other way would leave changed settings
  // behind.
  const std::shared_ptr<sp_port> port(raw, [](sp_port* p) {
    sp_close(p);
    sp_free_port(p);
  });
  check(sp_open(raw, SP_MODE_READ_WRITE));
  check(sp_set_baudrate(raw, baud));
  check(sp_set_bits(raw, 8));
  check(sp_set_parity(raw, parity == Parity::kEven  ? SP_PARITY_EVEN
                           : parity == Parity::kOdd ? SP_PARITY_ODD
                                                    : SP_PARITY_NONE));
  check(sp_set_stopbits(raw, stop_bits));
  check(sp_set_flowcontrol(raw, SP_FLOWCONTROL_NONE));
  check(sp_flush(raw, SP_BUF_BOTH));
  int fd = -1;
  check(sp_get_port_handle(raw, &fd));
  ::ioctl(fd, TIOCEXCL);  // two programs on one controller is an accident waiting to happen
  return Line(fd, shown, port);
}

}  // namespace

Line open_serial(const std::string& path, int baud, Parity parity, int stop_bits) {
  std::error_code error;
  const std::string real = std::filesystem::canonical(path, error);
  if (error) fail(path, error.message());
  return real.starts_with("/dev/pts/") ? open_pty(real)
                                       : open_port(real, path, baud, parity, stop_bits);
}

std::vector<SerialPort> list_serial_ports() {
  std::vector<SerialPort> ports;
  sp_port** list = nullptr;
  if (sp_list_ports(&list) != SP_OK) return ports;
  const auto text = [](const char* s) { return std::string(s != nullptr ? s : ""); };
  for (sp_port** port = list; *port != nullptr; ++port) {
    SerialPort found{sp_get_port_name(*port), text(sp_get_port_description(*port)), ""};
    int vendor = 0, product = 0;
    if (sp_get_port_usb_vid_pid(*port, &vendor, &product) == SP_OK)
      found.usb_id =
          fmt::format("{:04x}:{:04x} {}", vendor, product, text(sp_get_port_usb_serial(*port)));
    ports.push_back(std::move(found));
  }
  sp_free_port_list(list);
  return ports;
}

Pty make_pty() {
  const int master = ::posix_openpt(O_RDWR | O_NOCTTY | O_CLOEXEC);
  if (master < 0) fail("/dev/ptmx", std::strerror(errno));
  const std::shared_ptr<void> close_master(nullptr, [master](void*) { ::close(master); });
  char path[64];
  if (::grantpt(master) != 0 || ::unlockpt(master) != 0 ||
      ::ptsname_r(master, path, sizeof path) != 0)
    fail("/dev/ptmx", std::strerror(errno));
  const int held = ::open(path, O_RDWR | O_NOCTTY | O_CLOEXEC);
  if (held < 0) fail(path, std::strerror(errno));
  const std::shared_ptr<void> close_both(nullptr, [held, close_master](void*) { ::close(held); });
  make_raw(held, path);
  return {Line(master, fmt::format("far end of {}", path), close_both), path};
}

}  // namespace turntable
