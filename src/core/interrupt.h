// Ctrl-C and SIGTERM, as a level that everybody who waits looks at.
#pragma once

namespace turntable {

/// 0: carry on. 1 (first Ctrl-C): end at the next good place. 2 (second Ctrl-C, SIGTERM, SIGHUP):
/// stop the axes now.
int interrupt_level();
/// Raises the level by one for SIGINT and to 2 for SIGTERM and SIGHUP; ignores SIGPIPE. A third
/// Ctrl-C kills, whatever the way out is waiting for.
void install_interrupt_handlers();
/// From now on the first Ctrl-C already stops the axes: for verbs without poses to finish.
void stop_at_first_interrupt();
/// Exit code after the third Ctrl-C, as after a kill: nothing is known of the axes.
inline constexpr int kKilledByPress = 137;
/// For tests, and for ending `serve`.
void set_interrupt_level(int level);
/// What a run tells that is ended by level 1.
inline constexpr const char* kEndedAfterPose = "interrupted: ended after the last finished pose";
/// @throws Interrupted at level 1 and above; called where nothing is lost by ending.
void throw_if_interrupted(const char* told = "interrupted");
/// @throws Interrupted at level 2 and above; called wherever the program waits, unless shielded.
void throw_if_stopping_now();

/// A pause that somebody asked for: between poses a run waits for its end. Any thread.
bool pause_requested();
/// false: go on; the next Ctrl-C is a first one again.
void request_pause(bool pause);
/// While alive, the first Ctrl-C asks for a pause and leaves the level alone: for the part of a run
/// that takes poses, which can go on as if nothing had been.
class PauseAtFirstInterrupt {
 public:
  PauseAtFirstInterrupt();
  ~PauseAtFirstInterrupt();
  PauseAtFirstInterrupt(const PauseAtFirstInterrupt&) = delete;
  PauseAtFirstInterrupt& operator=(const PauseAtFirstInterrupt&) = delete;
};

/// While alive on this thread, waits are not interrupted: the way out has to talk to the devices.
class InterruptShield {
 public:
  InterruptShield();
  ~InterruptShield();
  InterruptShield(const InterruptShield&) = delete;
  InterruptShield& operator=(const InterruptShield&) = delete;
};

}  // namespace turntable
