#include "protocols/line.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>

#include "src/core/errors.h"

namespace turntable {
namespace {

using std::chrono::milliseconds;

constexpr std::size_t kMostDrained = 64 * 1024;

bool would_block(int error) { return error == EAGAIN || error == EWOULDBLOCK || error == EINTR; }

bool is_socket(int fd) {
  struct stat status {};
  return ::fstat(fd, &status) == 0 && S_ISSOCK(status.st_mode);
}

std::shared_ptr<void> closes(int fd) {
  return {nullptr, [fd](void*) { ::close(fd); }};
}

}  // namespace

Line::Line(int descriptor, std::string name, std::shared_ptr<void> owner)
    : descriptor_(descriptor),
      socket_(is_socket(descriptor)),
      name_(std::move(name)),
      owner_(owner.use_count() > 0 ? std::move(owner) : closes(descriptor)) {
  const int flags = ::fcntl(descriptor_, F_GETFL);
  if (flags < 0 || ::fcntl(descriptor_, F_SETFL, flags | O_NONBLOCK) < 0)
    throw LineError(fmt::format("{}: cannot be used: {}", name_, std::strerror(errno)));
}

void Line::gone(const char* what) const {
  throw LineError(fmt::format(
      "{}: {}: the other end is gone. Check cable and power, then connect again.", name_, what));
}

std::size_t Line::write_available(std::string_view bytes, Time now) {
  // A peer that is gone must be an error here, not a SIGPIPE.
  const ssize_t n = socket_ ? ::send(descriptor_, bytes.data(), bytes.size(), MSG_NOSIGNAL)
                            : ::write(descriptor_, bytes.data(), bytes.size());
  if (n < 0 && !would_block(errno)) gone(std::strerror(errno));
  const std::size_t sent = n > 0 ? static_cast<std::size_t>(n) : 0;
  if (sent > 0) last_byte_ = now + static_cast<Time::rep>(sent) * byte_time_;
  if (log_ && sent > 0) log_(Direction::kSent, bytes.substr(0, sent), now);
  return sent;
}

void Line::write(std::string_view bytes, Clock& clock, Time deadline) {
  for (;;) {
    bytes.remove_prefix(write_available(bytes, clock.now()));
    if (bytes.empty()) return;
    if (clock.now() >= deadline)
      throw TimeoutError(
          fmt::format("{}: {} bytes could not be written in time: the other end does not read.",
                      name_, bytes.size()));
    clock.sleep_until(std::min<Time>(deadline, clock.now() + milliseconds{1}));
  }
}

std::size_t Line::read_available(std::span<char> buffer, Time now) {
  const ssize_t n = ::read(descriptor_, buffer.data(), buffer.size());
  if (n < 0 && would_block(errno)) return 0;
  if (n < 0) gone(std::strerror(errno));
  if (n == 0) gone("closed");
  const auto got = static_cast<std::size_t>(n);
  last_byte_ = now;
  if (log_) log_(Direction::kReceived, {buffer.data(), got}, now);
  return got;
}

std::size_t Line::read(std::span<char> buffer, Clock& clock, Time deadline) {
  for (;;) {
    if (!clock.wait_readable(descriptor_, deadline))
      throw TimeoutError(fmt::format("{}: no answer in time", name_));
    if (const std::size_t n = read_available(buffer, clock.now()); n > 0) return n;
  }
}

std::size_t Line::drain(Time now) {
  std::array<char, 512> buffer;
  std::size_t total = 0;
  while (total < kMostDrained) {
    const std::size_t n = read_available(buffer, now);
    if (n == 0) break;
    total += n;
  }
  return total;
}

std::pair<Line, Line> line_pair(const std::string& name) {
  int ends[2];
  if (::socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0, ends) != 0)
    throw LineError(fmt::format("{}: cannot be opened: {}", name, std::strerror(errno)));
  return {Line(ends[0], name), Line(ends[1], name + " (far end)")};
}

}  // namespace turntable
