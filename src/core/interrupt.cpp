#include "src/core/interrupt.h"

#include <unistd.h>

#include <atomic>
#include <csignal>
#include <cstdlib>

#include "src/core/errors.h"

namespace turntable {
namespace {

std::atomic<int> g_level{0};
std::atomic<int> g_presses{0};  ///< of Ctrl-C
static_assert(std::atomic<int>::is_always_lock_free, "the signal handler touches it");
std::atomic<bool> g_stop_at_first{false};
std::atomic<bool> g_pause_at_first{false};
std::atomic<bool> g_pause{false};
thread_local int t_shields = 0;

extern "C" void on_signal(int signal) {
  // The third press kills, whatever the first two meant: the way out needs its time.
  if (signal == SIGINT && ++g_presses > 2) {
    constexpr char kSaid[] =
        "\nturntable: killed. Axes may still be moving: use the emergency stop, or "
        "\"turntable stop --rig RIG\".\n";
    [[maybe_unused]] const auto ignored = ::write(STDERR_FILENO, kSaid, sizeof kSaid - 1);
    std::_Exit(kKilledByPress);
  }
  const int before = g_level.load();
  if (signal == SIGINT && g_presses == 1 && before == 0 && g_pause_at_first && !g_pause) {
    g_pause = true;
    return;
  }
  const int level =
      signal == SIGINT && before == 0 && !g_stop_at_first && !g_pause_at_first ? 1 : 2;
  if (level > before) g_level.store(level);
}

}  // namespace

int interrupt_level() { return g_level.load(); }
void set_interrupt_level(int level) {
  g_level.store(level);
  if (level == 0) g_presses = 0;
}

bool pause_requested() { return g_pause; }
void request_pause(bool pause) {
  g_pause = pause;
  if (!pause && g_level == 0) g_presses = 0;
}

PauseAtFirstInterrupt::PauseAtFirstInterrupt() { g_pause_at_first = true; }
PauseAtFirstInterrupt::~PauseAtFirstInterrupt() {
  g_pause_at_first = false;
  request_pause(false);  // what comes after the poses does not pause
}

void stop_at_first_interrupt() {
  g_stop_at_first = true;
  int first = 1;  // one that has come already counts as well
  g_level.compare_exchange_strong(first, 2);
}

void install_interrupt_handlers() {
  struct sigaction action {};
  action.sa_handler = on_signal;
  sigemptyset(&action.sa_mask);
  sigaction(SIGINT, &action, nullptr);
  sigaction(SIGTERM, &action, nullptr);
  sigaction(SIGHUP, &action, nullptr);
  std::signal(SIGPIPE, SIG_IGN);
}

void throw_if_interrupted(const char* told) {
  if (g_level.load() >= 1) throw Interrupted(told);
}

void throw_if_stopping_now() {
  if (g_level.load() >= 2 && t_shields == 0)
    throw Interrupted("interrupted: axes are being stopped");
}

InterruptShield::InterruptShield() { ++t_shields; }
InterruptShield::~InterruptShield() { --t_shields; }

}  // namespace turntable
