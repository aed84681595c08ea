// How long it takes from asking for a stop until its first byte is on the wire, by the wall, with real
// processes: Ctrl-C at the mover, and `turntable stop` from another one (its start included), also while
// both cores are busy, while the mover is suspended, and from another user. The rig is an MC600 that
// `turntable simulate` serves at the pace of a real one; the bytes are seen on a pty in between.
#include <benchmark/benchmark.h>
#include <fmt/format.h>
#include <poll.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <chrono>
#include <csignal>
#include <filesystem>
#include <fstream>
#include <mutex>
#include <optional>
#include <regex>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include "protocols/serial.h"
#include "src/core/errors.h"
#include "src/core/random.h"
#include "tests/support/temporary_folder.h"

namespace turntable {
namespace {

namespace fs = std::filesystem;
using std::chrono::milliseconds;
using Wall = std::chrono::steady_clock;

constexpr int kTrials = 50;

/// A process of its own that ends with this one.
class Process {
 public:
  explicit Process(std::vector<std::string> words) {
    pid_ = ::fork();
    if (pid_ != 0) return;
    ::prctl(PR_SET_PDEATHSIG, SIGKILL);
    if (::freopen("/dev/null", "w", stdout) == nullptr ||
        ::freopen("/dev/null", "w", stderr) == nullptr ||
        ::freopen("/dev/null", "r", stdin) == nullptr)
      ::_exit(126);
    std::vector<char*> argv;
    for (std::string& word : words) argv.push_back(word.data());
    argv.push_back(nullptr);
    ::execvp(argv[0], argv.data());
    ::_exit(127);
  }
  ~Process() {
    if (pid_ <= 0) return;
    ::kill(pid_, SIGKILL);
    ::waitpid(pid_, nullptr, 0);
  }
  Process(const Process&) = delete;
  Process& operator=(const Process&) = delete;
  void signal(int number) const { ::kill(pid_, number); }
  /// Waits for its end. @return exit code, or 128 + signal.
  int ended() {
    int status = 0;
    ::waitpid(std::exchange(pid_, -1), &status, 0);
    return WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
  }

 private:
  pid_t pid_;
};

/// Carries bytes between the program and the served controller, and notes when a word first passes.
class Relay {
 public:
  explicit Relay(const std::string& served)
      : near_(make_pty()), far_(open_serial(served, 19200)), thread_([this] { carry(); }) {}
  ~Relay() {
    ending_ = true;
    thread_.join();
  }
  const std::string& path() const { return near_.path; }
  void await(const std::string& word) {
    const std::lock_guard lock(mutex_);
    word_ = word;
    seen_.clear();
    at_.reset();
  }
  /// @return when the word has passed; nothing if it has not within 10 s.
  std::optional<Wall::time_point> passed() const {
    for (int i = 0; i < 10'000; ++i) {
      {
        const std::lock_guard lock(mutex_);
        if (at_) return at_;
      }
      std::this_thread::sleep_for(milliseconds{1});
    }
    return std::nullopt;
  }

 private:
  void carry() {
    SystemClock clock;
    std::array<char, 512> buffer;
    while (!ending_) {
      std::array<pollfd, 2> ends{
          {{near_.master.descriptor(), POLLIN, 0}, {far_.descriptor(), POLLIN, 0}}};
      if (::poll(ends.data(), ends.size(), 20) <= 0) continue;
      if (const std::size_t n = near_.master.read_available(buffer, clock.now()); n > 0) {
        const auto now = Wall::now();
        {
          const std::lock_guard lock(mutex_);
          seen_.append(buffer.data(), n);
          if (!at_ && !word_.empty() && seen_.find(word_) != seen_.npos) at_ = now;
        }
        far_.write_available({buffer.data(), n}, clock.now());
      }
      if (const std::size_t n = far_.read_available(buffer, clock.now()); n > 0)
        near_.master.write_available({buffer.data(), n}, clock.now());
    }
  }

  Pty near_;
  Line far_;
  std::atomic<bool> ending_{false};
  mutable std::mutex mutex_;
  std::string word_, seen_;
  std::optional<Wall::time_point> at_;
  std::thread thread_;
};

std::string text_of(const fs::path& file) {
  std::ifstream in(file);
  return {std::istreambuf_iterator<char>(in), {}};
}

/// The served rig, homed, and the file with which others reach it through the relay.
struct ServedRig {
  ServedRig() {
    fs::permissions(folder.path(), fs::perms::all);  // for another user
    const fs::path rigs = fs::path(TURNTABLE_SOURCE_DIR) / "scenarios/rigs";
    const auto written = [&](const std::string& name, const std::string& port) {
      std::string text = text_of(rigs / "simulated.json");
      text = std::regex_replace(text, std::regex(R"(\{"simulated": \{\}\})"),
                                fmt::format(R"({{"serial": {{"port": "{}"}}}})", port));
      text = std::regex_replace(
          text, std::regex(R"(\.\./calibration_sweep\.json)"),
          (fs::path(TURNTABLE_SOURCE_DIR) / "scenarios/calibration_sweep.json").string());
      std::ofstream(folder / name) << text;
      return (folder / name).string();
    };
    const std::string link = (folder / "mc1").string();
    server.emplace(std::vector<std::string>{TURNTABLE_PROGRAM, "simulate",
                                            written("served.json", link), "--links",
                                            folder.path().string()});
    for (int i = 0; i < 1000 && !fs::exists(link); ++i)
      std::this_thread::sleep_for(milliseconds{10});
    relay.emplace(link);
    file = written("rig.json", relay->path());
    if (Process(with_rig({"home"})).ended() != 0) throw std::runtime_error("cannot be homed");
  }
  std::vector<std::string> with_rig(std::vector<std::string> words) const {
    words.insert(words.begin(), TURNTABLE_PROGRAM);
    words.insert(words.end(), {"--rig", file});
    return words;
  }

  TemporaryFolder folder;
  std::optional<Process> server;
  std::optional<Relay> relay;
  std::string file;
};

enum class Asked { kCtrlC, kStop, kStopOfSuspended, kStopByOther };

void stop_latency(benchmark::State& state, Asked asked, bool busy) {
  ServedRig rig;
  Random draws(1, "stop bench");
  std::vector<double> times_ms;
  for (auto _ : state) {
    std::vector<std::unique_ptr<Process>> load;
    for (unsigned i = 0; busy && i < std::thread::hardware_concurrency(); ++i)
      load.push_back(
          std::make_unique<Process>(std::vector<std::string>{"sh", "-c", "while :; do :; done"}));
    for (int k = 0; k < kTrials; ++k) {
      rig.relay->await("GoPosition");
      const char* to = k % 2 == 0 ? "80" : "-80";
      Process mover(
          rig.with_rig({"move", "yaw", to, "stage", k % 2 == 0 ? "190" : "10", "--homed"}));
      if (!rig.relay->passed()) return state.SkipWithError("nothing was moved");
      std::this_thread::sleep_for(milliseconds{static_cast<int>(draws.uniform(0.0, 400.0))});
      if (asked == Asked::kStopOfSuspended) mover.signal(SIGSTOP);
      rig.relay->await("Stop ");
      const auto begin = Wall::now();
      std::optional<Process> other;
      if (asked == Asked::kCtrlC) {
        mover.signal(SIGINT);
      } else {
        std::vector<std::string> words = rig.with_rig({"stop"});
        if (asked == Asked::kStopByOther)
          words.insert(words.begin(),
                       {"setpriv", "--reuid", "65534", "--regid", "65534", "--clear-groups"});
        other.emplace(words);
      }
      const auto at = rig.relay->passed();
      if (!at) return state.SkipWithError("no stop has come");
      times_ms.push_back(std::chrono::duration<double, std::milli>(*at - begin).count());
      if (mover.ended() != 130) return state.SkipWithError("the mover did not stop its axes");
      // The line is the other user's only to order a stop on, not to open.
      if (other && asked != Asked::kStopByOther && other->ended() != 0)
        return state.SkipWithError("the axes are not known to stand");
    }
  }
  std::ranges::sort(times_ms);
  state.counters["trials"] = static_cast<double>(times_ms.size());
  state.counters["median_ms"] = times_ms[times_ms.size() / 2];
  state.counters["p90_ms"] = times_ms[times_ms.size() * 9 / 10];
  state.counters["max_ms"] = times_ms.back();
}

const int registered = [] {
  const auto add = [](const char* name, Asked asked, bool busy) {
    benchmark::RegisterBenchmark(
        name, [asked, busy](benchmark::State& state) { stop_latency(state, asked, busy); })
        ->Iterations(1)
        ->Unit(benchmark::kSecond);
  };
  add("stop/ctrl_c", Asked::kCtrlC, false);
  add("stop/ctrl_c/busy_cores", Asked::kCtrlC, true);
  add("stop/turntable_stop", Asked::kStop, false);
  add("stop/turntable_stop/busy_cores", Asked::kStop, true);
  add("stop/turntable_stop/suspended_mover", Asked::kStopOfSuspended, false);
  if (::geteuid() == 0) add("stop/turntable_stop/another_user", Asked::kStopByOther, false);
  return 0;
}();

}  // namespace
}  // namespace turntable
