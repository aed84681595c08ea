#include "src/core/interrupt.h"

#include <atomic>
#include <csignal>
#include <cstdlib>

#include "src/core/errors.h"

namespace turntable {
namespace {

std::atomic<int> g_level{0};
static_assert(std::atomic<int>::is_always_lock_free, "the signal handler touches it");
std::atomic<bool> g_stop_at_first{false};
thread_local int t_shields = 0;

extern "C" void on_signal(int signal) {
  const int before = g_level.load();
  const int level = signal == SIGINT && !(g_stop_at_first && before == 0) ? before + 1 : 2;
  if (level > 2) std::_Exit(130);
  g_level.store(level);
}

}  // namespace

int interrupt_level() { return g_level.load(); }
void set_interrupt_level(int level) { g_level.store(level); }

void stop_at_first_interrupt() { g_stop_at_first = true; }

void install_interrupt_handlers() {
  struct sigaction action {};
  action.sa_handler = on_signal;
  sigemptyset(&action.sa_mask);
  sigaction(SIGINT, &action, nullptr);
  sigaction(SIGTERM, &action, nullptr);
  sigaction(SIGHUP, &action, nullptr);
  std::signal(SIGPIPE, SIG_IGN);
}

void throw_if_interrupted() {
  if (g_level.load() >= 1) throw Interrupted("interrupted: ended after the last finished pose");
}

void throw_if_stopping_now() {
  if (g_level.load() >= 2 && t_shields == 0)
    throw Interrupted("interrupted: axes are being stopped");
}

InterruptShield::InterruptShield() { ++t_shields; }
InterruptShield::~InterruptShield() { --t_shields; }

}  // namespace turntable
