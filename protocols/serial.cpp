#include "protocols/serial.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <libserialport.h>
#include <stdlib.h>
#include <sys/file.h>
#include <sys/ioctl.h>
#include <termios.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <filesystem>
#include <fstream>

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

/// The first line of a small file of /proc.
std::string first_line(const std::filesystem::path& file) {
  std::ifstream in(file);
  std::string text;
  std::getline(in, text);
  return text;
}

/// Whether that descriptor of a process holds a lock: a served pty is open at its own server, too.
bool flocked(const std::filesystem::path& fd) {
  std::ifstream info(fd.parent_path().parent_path() / "fdinfo" / fd.filename());
  for (std::string line; std::getline(info, line);)
    if (line.starts_with("lock:") && line.find("FLOCK") != line.npos) return true;
  return false;
}

/// Who has the device open, as far as /proc shows: "process 4711 (picocom)". Processes of other users
/// are seen by root only.
std::string holder_of(const std::string& real) {
  namespace fs = std::filesystem;
  std::error_code ignored;
  std::string opener;
  for (fs::directory_iterator process("/proc", ignored), end; process != end;
       process.increment(ignored)) {
    const std::string pid = process->path().filename().string();
    if (pid.find_first_not_of("0123456789") != pid.npos) continue;
    for (fs::directory_iterator fd(process->path() / "fd", ignored); fd != end;
         fd.increment(ignored)) {
      if (fs::read_symlink(fd->path(), ignored) != real) continue;
      const std::string who =
          pid == std::to_string(::getpid())
              ? "this program itself"
              : fmt::format("process {} ({})", pid, first_line(process->path() / "comm"));
      if (flocked(fd->path())) return who;
      if (pid != std::to_string(::getpid())) opener = who;
    }
  }
  if (!opener.empty()) return opener;
  return "another program (which one, only its own user or root can see)";
}

[[noreturn]] void in_use(const std::string& shown, const std::string& real) {
  throw LineError(fmt::format(
      "serial port {} is in use by {}. Two programs on one line get parts of each other's "
      "answers: end that one, or wait for its end.",
      shown, holder_of(real)));
}

/// Takes the lock that terminals, pySerial and others take, so that both sides notice.
void hold(int fd, const std::string& shown, const std::string& real) {
  if (::flock(fd, LOCK_EX | LOCK_NB) != 0 && errno == EWOULDBLOCK) in_use(shown, real);
  ::ioctl(fd, TIOCEXCL);  // keeps out who comes later and asks for no lock
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
  if (fd < 0 && errno == EBUSY) in_use(path, path);
  if (fd < 0) fail(path, std::strerror(errno));
  Line line(fd, path);
  hold(fd, path, path);
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
  const sp_return opened = sp_open(raw, SP_MODE_READ_WRITE);
  if (opened == SP_ERR_FAIL && sp_last_error_code() == EBUSY) in_use(shown, path);
  check(opened);
  int fd = -1;
  check(sp_get_port_handle(raw, &fd));
  hold(fd, shown, path);
  check(sp_set_baudrate(raw, baud));
  check(sp_set_bits(raw, 8));
  check(sp_set_parity(raw, parity == Parity::kEven  ? SP_PARITY_EVEN
                           : parity == Parity::kOdd ? SP_PARITY_ODD
                                                    : SP_PARITY_NONE));
  check(sp_set_stopbits(raw, stop_bits));
  check(sp_set_flowcontrol(raw, SP_FLOWCONTROL_NONE));
  check(sp_flush(raw, SP_BUF_BOTH));
  return Line(fd, shown, port);
}

}  // namespace

Line open_serial(const std::string& path, int baud, Parity parity, int stop_bits) {
  std::error_code error;
  const std::string real = std::filesystem::canonical(path, error);
  if (error == std::errc::no_such_file_or_directory) {
    std::string there;
    for (const SerialPort& port : list_serial_ports())
      there += fmt::format("{}{}{}", there.empty() ? "" : ", ", port.path,
                           port.by_id.empty() ? "" : " (" + port.by_id + ")");
    throw LineError(
        fmt::format("serial port {}: is not there. Ports that are: {}. An adapter that was "
                    "unplugged may come back "
                    "under another number; its name below /dev/serial/by-id stays. \"turntable "
                    "resume RUN --line "
                    "NAME=PORT\" goes on with a run on another port.",
                    path, there.empty() ? "none" : there));
  }
  if (error) fail(path, error.message());
  return real.starts_with("/dev/pts/") ? open_pty(real)
                                       : open_port(real, path, baud, parity, stop_bits);
}

std::string line_id(const LineConfig& line) {
  if (line.kind == LineConfig::Kind::kSimulated) return {};
  if (line.kind != LineConfig::Kind::kSerial) return fmt::format("{}:{}", line.host, line.tcp_port);
  std::error_code error;
  const auto real = std::filesystem::canonical(line.serial_port, error);
  return error ? line.serial_port : real.string();
}

std::vector<SerialPort> list_serial_ports() {
  std::vector<SerialPort> ports;
  sp_port** list = nullptr;
  if (sp_list_ports(&list) != SP_OK) return ports;
  const auto text = [](const char* s) { return std::string(s != nullptr ? s : ""); };
  for (sp_port** port = list; *port != nullptr; ++port) {
    SerialPort found{sp_get_port_name(*port), text(sp_get_port_description(*port)), "", ""};
    int vendor = 0, product = 0;
    if (sp_get_port_usb_vid_pid(*port, &vendor, &product) == SP_OK)
      found.usb_id =
          fmt::format("{:04x}:{:04x} {}", vendor, product, text(sp_get_port_usb_serial(*port)));
    std::error_code ignored;
    for (std::filesystem::directory_iterator link("/dev/serial/by-id", ignored), end; link != end;
         link.increment(ignored))
      if (std::filesystem::canonical(link->path(), ignored) == found.path)
        found.by_id = link->path().string();
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
