// Command and answer in lines of text that end in CR, or in what a controller has instead, over a line
// that may be noisy: one command at a time, unsolicited lines told apart from answers, a way back into
// step after anything odd.
#pragma once

#include <deque>
#include <functional>
#include <optional>
#include <string>
#include <string_view>

#include "protocols/shared_line.h"

namespace turntable {

/// The same text with its ASCII letters in upper case.
std::string upper(std::string_view text);
/// In upper case, without blanks beside its commas: "?x, 12" -> "?X,12".
std::string tidy(std::string_view text);
/// In quotes, as it stands in a message: noise must not spoil a terminal or a journal.
std::string in_quotes(std::string_view text);

class AsciiDialog {
 public:
  using Predicate = std::function<bool(std::string_view line)>;

  /// Longer lines are noise and are dropped; blanks at the ends of lines are.
  static constexpr std::size_t kLongestLine = 256;

  /// @param unsolicited is shown every line first; true = it was one the device sends by itself,
  /// and has been dealt with. Called from within the functions below.
  AsciiDialog(SharedLine line, Clock& clock, Predicate unsolicited);

  /// From now on commands end in `command_end` and answers in `answer_end`, in which CR and LF are
  /// blanks unless they are the end. Neither may be empty. Where answers end in a prompt, a prompt alone is
  /// an answer too.
  void set_ends(std::string command_end, std::string answer_end);

  /// From now on a line that repeats what was sent is the echo of an adapter or of the device, and
  /// no answer. Only where no answer ever looks like its command.
  void drop_echo() { drops_echo_ = true; }

  /// Sends `command` and its end once; returns the first line that `accept` takes for its answer. Stale
  /// input is dealt with before sending, lines that nobody takes are skipped.
  /// @param give_way asked every 20 ms while waiting: true ends the wait (somebody more urgent
  /// needs the line). The wait ends at its deadline whatever arrives.
  /// @throws TimeoutError if nothing came in time, ProtocolError if only lines came that nobody
  /// took, LineError.
  std::string ask(std::string_view command, Time timeout, const Predicate& accept,
                  const std::function<bool()>& give_way = {});
  /// Sends `command` and its end once, where no answer is due. @throws TimeoutError, LineError.
  void tell(std::string_view command, Time timeout);
  /// Deals with what has arrived by itself, 64 KiB at most, without waiting. @throws LineError.
  void pump();
  /// The same, and lets a line that is half here arrive, for a tenth of a second at most: the echo of
  /// what is said now would end up in the middle of it.
  /// @param give_way as in `ask`. @throws LineError.
  void hear_out(const std::function<bool()>& give_way);
  /// Ends a half-sent command so that it is not carried out, then discards answers until the line
  /// has been quiet for `quiet`, at most `at_most`. Unsolicited lines are still dealt with.
  /// @param answer where a lone CR is answered: quiet does not count before that answer has come.
  /// @param give_way as in `ask`; the line is still out of step then.
  /// @throws LineError.
  void resync(Time quiet, Time at_most, const Predicate& answer = {},
              const std::function<bool()>& give_way = {});
  /// False after an exchange that failed: a late answer may still come. `ask` then ends a half-sent
  /// command with CR first, but does not wait; call `resync` where there is time for it.
  bool in_step() const { return in_step_; }

  Line& line() { return line_.line(); }
  Clock& clock() { return *clock_; }

 private:
  std::string line_end() const;
  void send(std::string_view bytes, Time deadline);
  std::size_t read_pending();
  std::optional<std::string> next_line();
  bool is_echo(std::string_view text);

  /// Nothing that was begun on an earlier connection goes on after the line was opened again.
  void notice_reopening();

  SharedLine line_;
  unsigned opened_;  ///< the line's count of openings, as last seen
  Clock* clock_;
  Predicate unsolicited_;
  std::string command_end_ = "\r", answer_end_ = "\r";
  bool prompts_ = false;       ///< answers end in a prompt: an empty one says something
  std::string pending_;        ///< bytes not yet made into lines
  std::size_t heard_out_ = 0;  ///< of them, whose end was waited for in vain
  bool overlong_ = false;      ///< inside a line that is too long: dropping until CR
  bool drops_echo_ = false;
  std::deque<std::string> sent_;  ///< the last commands that no echo has come of
  bool in_step_ = true;
  bool cut_off_ =
      true;  ///< a command may have been sent in part: by us, or by whoever was here before
};

}  // namespace turntable
