#include "src/app/rig_lock.h"

#include <fmt/format.h>
#include <poll.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <array>
#include <atomic>
#include <cerrno>
#include <csignal>
#include <cstddef>
#include <cstring>
#include <fstream>
#include <functional>
#include <optional>
#include <set>
#include <thread>

#include "protocols/serial.h"
#include "src/core/clock.h"
#include "src/core/errors.h"
#include "src/core/interrupt.h"

namespace turntable {
namespace {

using std::chrono::milliseconds;
using std::chrono::steady_clock;

constexpr milliseconds kPatience{2000};

class Descriptor {
 public:
  explicit Descriptor(int fd) : fd_(fd) {}
  Descriptor(Descriptor&& other) noexcept : fd_(std::exchange(other.fd_, -1)) {}
  Descriptor& operator=(Descriptor&& other) noexcept {
    std::swap(fd_, other.fd_);
    return *this;
  }
  ~Descriptor() {
    if (fd_ >= 0) ::close(fd_);
  }
  int get() const { return fd_; }
  int* address() { return &fd_; }

 private:
  int fd_;
};

/// What stands for a serial port or "host:port", whichever way it is named.
std::string line_id(const std::string& line) {
  std::error_code error;
  const auto real = std::filesystem::canonical(line, error);
  return error ? line : real.string();
}

std::set<std::string> line_ids(const RigFile& rig) {
  std::set<std::string> ids;
  for (const ControllerConfig& controller : rig.controllers)
    if (std::string id = line_id(controller.line); !id.empty()) ids.insert(std::move(id));
  for (const ChannelConfig& channel : rig.telemetry.channels)
    if (std::string id = line_id(channel.line); !id.empty()) ids.insert(std::move(id));
  return ids;
}

/// The folder of a run, whichever way it is named, made already or not.
std::string run_id(const std::filesystem::path& run) {
  std::error_code error;
  return "run " + std::filesystem::weakly_canonical(std::filesystem::absolute(run), error).string();
}

struct Address {
  sockaddr_un address{};
  socklen_t size = 0;
};

/// An abstract name: its first byte is 0, and no file stands for it.
Address address_of(const std::string& id) {
  Address a;
  a.address.sun_family = AF_UNIX;
  std::string name = "turntable-line:" + id;
  if (name.size() > sizeof a.address.sun_path - 1)
    name = fmt::format("turntable-line#{:016x}", std::hash<std::string>{}(id));
  std::memcpy(a.address.sun_path + 1, name.data(), name.size());
  a.size = static_cast<socklen_t>(offsetof(sockaddr_un, sun_path) + 1 + name.size());
  return a;
}

Descriptor new_socket() { return Descriptor(::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0)); }

bool readable(int fd, milliseconds wait) {
  pollfd p{fd, POLLIN, 0};
  return ::poll(&p, 1, static_cast<int>(wait.count())) > 0;
}

/// Connects to whoever has the line and says a word. @return nothing if nobody is there; -1 if there
/// is somebody who does not answer.
std::optional<Descriptor> call(const std::string& id, std::string_view word) {
  Descriptor fd = new_socket();
  const timeval patience{1, 0};  // a holder that hangs answers nobody, and his queue fills up
  ::setsockopt(fd.get(), SOL_SOCKET, SO_SNDTIMEO, &patience, sizeof patience);
  const Address a = address_of(id);
  if (::connect(fd.get(), reinterpret_cast<const sockaddr*>(&a.address), a.size) != 0) {
    if (errno == ECONNREFUSED) return std::nullopt;
    return Descriptor(-1);
  }
  ::send(fd.get(), word.data(), word.size(), MSG_NOSIGNAL);
  return fd;
}

/// What comes until a line ends or nothing more does.
std::string heard(int fd, milliseconds wait) {
  std::string text;
  std::array<char, 512> buffer;
  while (text.find('\n') == text.npos && readable(fd, wait)) {
    const ssize_t n = ::recv(fd, buffer.data(), buffer.size(), 0);
    if (n <= 0) break;
    text.append(buffer.data(), static_cast<std::size_t>(n));
  }
  return text.substr(0, text.find('\n'));
}

/// A holder that somebody has suspended (Ctrl-Z, SIGSTOP, a debugger) hears nothing, and his axes move on.
/// @return what to do where he cannot be woken from here; empty otherwise.
std::string wake(int fd) {
  ucred holder{};
  socklen_t size = sizeof holder;
  if (::getsockopt(fd, SOL_SOCKET, SO_PEERCRED, &holder, &size) != 0 || holder.pid <= 0) return {};
  std::ifstream stat(fmt::format("/proc/{}/stat", holder.pid));
  std::string text;
  std::getline(stat, text);
  const std::size_t name_end = text.rfind(')');  // the name may hold anything
  if (name_end == text.npos || text.size() < name_end + 3) return {};
  const char state = text[name_end + 2];
  if ((state != 'T' && state != 't') || ::kill(holder.pid, SIGCONT) == 0) return {};
  return fmt::format(
      " It is suspended, and only its own user or root may wake it: \"kill -CONT {}\" lets it "
      "stop.",
      holder.pid);
}

std::string answer_of(int fd) {
  const std::string who = heard(fd, milliseconds{1000});
  return who.empty() ? "a process that does not answer" : who;
}

}  // namespace

/// Answers at the names of the lines, on a thread of its own.
class RigLock::Server {
 public:
  Server(const std::set<std::string>& ids, const std::string& doing)
      : who_(fmt::format("process {}: turntable {}, since {}", ::getpid(), doing, utc_now())) {
    for (const std::string& id : ids) claim(id);
    if (!names_.empty()) thread_ = std::thread([this] { answer(); });
  }
  ~Server() {
    ending_ = true;
    if (thread_.joinable()) thread_.join();
  }

 private:
  void claim(const std::string& id) {
    Descriptor fd = new_socket();
    const Address a = address_of(id);
    const auto end = steady_clock::now() + kPatience;
    while (::bind(fd.get(), reinterpret_cast<const sockaddr*>(&a.address), a.size) != 0) {
      if (steady_clock::now() < end) {
        std::this_thread::sleep_for(milliseconds{20});
        continue;
      }
      const auto holder = line_holder(id);
      throw DeviceError(
          fmt::format("{} is in use by {}. Only one program may move what is on it: wait for its "
                      "end, or stop it "
                      "with \"turntable stop\".",
                      id, holder ? holder->who : "another process"));
    }
    if (::listen(fd.get(), 8) != 0)
      throw DeviceError(fmt::format("{} cannot be claimed: {}", id, std::strerror(errno)));
    names_.push_back(std::move(fd));
  }

  void answer() {
    std::vector<pollfd> watched;
    for (const Descriptor& name : names_) watched.push_back({name.get(), POLLIN, 0});
    while (!ending_) {
      if (::poll(watched.data(), watched.size(), 20) <= 0) continue;
      for (const pollfd& p : watched) {
        if ((p.revents & POLLIN) == 0) continue;
        Descriptor caller(::accept4(p.fd, nullptr, nullptr, SOCK_CLOEXEC));
        const std::string word = heard(caller.get(), milliseconds{200});
        if (word == "stop") set_interrupt_level(std::max(interrupt_level(), 2));
        if (word == "pause" || word == "resume") request_pause(word == "pause");
        const std::string text = who_ + "\n";
        ::send(caller.get(), text.data(), text.size(), MSG_NOSIGNAL);
        callers_.push_back(std::move(caller));  // closed when the line is let go
        if (callers_.size() > 64) callers_.erase(callers_.begin());
      }
    }
  }

  std::string who_;
  std::vector<Descriptor> names_, callers_;
  std::atomic<bool> ending_{false};
  std::thread thread_;
};

RigLock::RigLock(const RigFile& rig, const std::string& doing, const std::filesystem::path& run) {
  std::set<std::string> ids = line_ids(rig);
  if (!run.empty()) ids.insert(run_id(run));
  server_ = std::make_unique<Server>(ids, doing);
}
RigLock::RigLock(const std::string& line, const std::string& doing)
    : server_(std::make_unique<Server>(std::set{line_id(line)}, doing)) {}
RigLock::~RigLock() = default;
RigLock::RigLock(RigLock&&) noexcept = default;

std::optional<LineHolder> line_holder(const std::string& line) {
  const std::string id = line_id(line);
  const auto fd = call(id, "who\n");
  if (!fd) return std::nullopt;
  return LineHolder{id, answer_of(fd->get())};
}

std::optional<std::string> tell_run(const std::filesystem::path& run, const std::string& word) {
  const auto fd = call(run_id(run), word + "\n");
  if (!fd) return std::nullopt;
  return answer_of(fd->get());
}

std::vector<LineHolder> line_holders(const RigFile& rig) {
  std::vector<LineHolder> holders;
  for (const std::string& id : line_ids(rig))
    if (auto holder = line_holder(id)) holders.push_back(std::move(*holder));
  return holders;
}

StopOrder::StopOrder(const LineConfig& line) {
  const std::string id = line_id(line);
  auto fd = id.empty() ? std::nullopt : call(id, "stop\n");
  if (!fd) return;
  asleep_ = wake(fd->get());
  holder_ = LineHolder{id, answer_of(fd->get())};
  auto owner = std::make_shared<Descriptor>(std::move(*fd));
  connection_ = std::shared_ptr<int>(owner, owner->address());
}

std::optional<LineHolder> StopOrder::wait(milliseconds timeout) const {
  if (!holder_) return std::nullopt;
  if (*connection_ < 0 || !asleep_.empty())
    throw NotStopped(fmt::format("{} has {}.{}", holder_->who, holder_->line, asleep_));
  const auto end = steady_clock::now() + timeout;
  for (char byte = 0;;) {
    const auto left = std::chrono::duration_cast<milliseconds>(end - steady_clock::now());
    if (left <= milliseconds{0} || !readable(*connection_, left))
      throw NotStopped(fmt::format("{} was told to stop and still has {} after {:.0f} s.",
                                   holder_->who, holder_->line,
                                   std::chrono::duration<double>(timeout).count()));
    if (::recv(*connection_, &byte, 1, 0) <= 0) return holder_;  // closed, or reset: he is gone
  }
}

}  // namespace turntable
