#include "protocols/ascii_dialog.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <utility>

#include "src/core/errors.h"

namespace turntable {
namespace {

constexpr Time kSlice = std::chrono::milliseconds{20};
constexpr std::size_t kMostPumped = 64 * 1024;  // a line that is flooded is never empty
constexpr Time kLineRest = std::chrono::milliseconds{100};
constexpr std::size_t kEchoes = 8;  ///< that may still be on their way

bool blank(char c) { return c == ' ' || c == '\t'; }

}  // namespace

std::string in_quotes(std::string_view text) {
  std::string shown = "\"";
  for (const char c : text.substr(0, 60)) {
    if (c >= ' ' && c <= '~')
      shown += c;
    else
      shown += fmt::format("\\x{:02x}", static_cast<unsigned char>(c));
  }
  return shown + "\"";
}

std::string upper(std::string_view text) {
  std::string s(text);
  for (char& c : s) c = c >= 'a' && c <= 'z' ? static_cast<char>(c - 'a' + 'A') : c;
  return s;
}

std::string tidy(std::string_view text) {
  std::string s;
  for (const char c : upper(text)) {
    if (blank(c) && s.ends_with(',')) continue;
    if (c == ',')
      while (!s.empty() && blank(s.back())) s.pop_back();
    s += c;
  }
  return s;
}

AsciiDialog::AsciiDialog(SharedLine line, Clock& clock, Predicate unsolicited)
    : line_(std::move(line)),
      opened_(line_.times_opened()),
      clock_(&clock),
      unsolicited_(std::move(unsolicited)) {}

void AsciiDialog::set_ends(std::string command_end, std::string answer_end) {
  command_end_ = std::move(command_end);
  answer_end_ = std::move(answer_end);
  prompts_ = answer_end_.find_first_not_of("\r\n") != std::string::npos;
}

void AsciiDialog::notice_reopening() {
  if (std::exchange(opened_, line_.times_opened()) == line_.times_opened()) return;
  pending_.clear();
  overlong_ = false;
  in_step_ = true;
  cut_off_ = true;
}

/// Reads what is there into `pending_`. @return number of bytes.
std::size_t AsciiDialog::read_pending() {
  std::array<char, 512> buffer;
  const std::size_t n = line().read_available(buffer, clock_->now());
  pending_.append(buffer.data(), n);
  return n;
}

std::optional<std::string> AsciiDialog::next_line() {
  for (;;) {
    if (pending_.starts_with('\n')) pending_.erase(0, 1);  // of the line before
    if (prompts_) pending_.erase(0, std::min(pending_.find_first_not_of("\r\n"), pending_.size()));
    const std::size_t end = pending_.find(answer_end_);
    if (end == std::string::npos) {
      if (pending_.size() > kLongestLine) {
        overlong_ = true;
        pending_.clear();
      }
      return std::nullopt;
    }
    std::string text = pending_.substr(0, end);
    pending_.erase(0, end + answer_end_.size());
    if (answer_end_ == "\r")
      std::erase(text, '\n');  // some serial servers add one
    else
      std::ranges::replace_if(
          text, [](char c) { return c == '\r' || c == '\n'; }, ' ');
    while (!text.empty() && blank(text.back())) text.pop_back();
    text.erase(0, text.find_first_not_of(" \t"));
    if (overlong_ || text.size() > kLongestLine || (text.empty() && !prompts_)) {
      overlong_ = false;
      continue;
    }
    if (is_echo(text)) continue;
    if (!unsolicited_ || !unsolicited_(text)) return text;
  }
}

bool AsciiDialog::is_echo(std::string_view text) {
  const auto found = std::ranges::find(sent_, text);
  if (found == sent_.end()) return false;
  sent_.erase(sent_.begin(), found + 1);
  return true;
}

void AsciiDialog::pump() {
  notice_reopening();
  for (std::size_t total = 0, n = 1; n > 0 && total < kMostPumped; total += n) {
    while (next_line()) {
    }
    n = read_pending();
  }
  while (next_line()) {
  }
}

void AsciiDialog::hear_out(const std::function<bool()>& give_way) {
  pump();
  const Time end = clock_->now() + kLineRest;
  while (!pending_.empty() && pending_.size() != heard_out_ && clock_->now() < end && !give_way()) {
    if (clock_->wait_readable(line().descriptor(), std::min(end, clock_->now() + kSlice))) pump();
  }
  heard_out_ = pending_.size();
}

/// Ends what was half said; a command that was cut off must not be carried out as it stands.
std::string AsciiDialog::line_end() const { return (cut_off_ ? "!" : "") + command_end_; }

void AsciiDialog::send(std::string_view bytes, Time deadline) {
  cut_off_ = true;
  for (std::string_view rest = bytes; drops_echo_ && !rest.empty();) {
    const std::size_t end = std::min(rest.find(command_end_), rest.size());
    if (end > 0) sent_.emplace_back(rest.substr(0, end));
    rest.remove_prefix(std::min(end + command_end_.size(), rest.size()));
    if (sent_.size() > kEchoes) sent_.pop_front();
  }
  line().write(bytes, *clock_, deadline);
  cut_off_ = false;
}

void AsciiDialog::tell(std::string_view command, Time timeout) {
  pump();
  std::string bytes = in_step_ ? "" : line_end();
  bytes.append(command).append(command_end_);
  const bool was_in_step = std::exchange(in_step_, false);
  send(bytes, clock_->now() + timeout);
  in_step_ = was_in_step;
}

void AsciiDialog::resync(Time quiet, Time at_most, const Predicate& answer,
                         const std::function<bool()>& give_way) {
  notice_reopening();
  in_step_ = false;
  const Time end = clock_->now() + at_most;
  send(answer && cut_off_ ? line_end() + command_end_ : line_end(), end);
  bool answered = !answer;
  for (Time quiet_since = clock_->now(); clock_->now() < end;) {
    const Time silent = answered ? std::min(end, quiet_since + quiet) : end;
    const Time slice = give_way ? std::min(silent, clock_->now() + kSlice) : silent;
    if (clock_->wait_readable(line().descriptor(), slice)) {
      read_pending();
      while (const auto text = next_line()) answered = answered || answer(*text);
      quiet_since = clock_->now();
    } else if (clock_->now() >= silent) {
      break;
    }
    if (give_way && give_way()) return;
  }
  pump();
  pending_.clear();  // the rest of a broken line
  overlong_ = false;
  in_step_ = true;
}

std::string AsciiDialog::ask(std::string_view command, Time timeout, const Predicate& accept,
                             const std::function<bool()>& give_way) {
  pump();
  if (!in_step_) pending_.clear();
  std::string bytes = in_step_ ? "" : line_end();
  bytes.append(command).append(command_end_);
  in_step_ = false;
  const Time deadline = clock_->now() + timeout, patience = clock_->now() + kSlice;
  send(bytes, deadline);
  std::string skipped;
  for (;;) {
    while (auto text = next_line()) {
      if (accept(*text)) {
        in_step_ = true;
        return std::move(*text);
      }
      skipped = std::move(*text);
    }
    const Time now = clock_->now();
    if (now >= deadline) break;
    // An answer that is just arriving is waited for; a flood is not.
    if (give_way && now >= patience && give_way())
      throw GaveWay(fmt::format("{}: \"{}\" gave way to a stop", line_.name(), command));
    if (clock_->wait_readable(line().descriptor(),
                              give_way ? std::min(deadline, now + kSlice) : deadline))
      read_pending();
  }
  if (!skipped.empty() || !pending_.empty())
    throw ProtocolError(
        fmt::format("{}: \"{}\" was answered by {}, which is no answer to it. Check baud rate and "
                    "cable; if answers only come late, raise reply_timeout_ms in the rig file.",
                    line_.name(), command, in_quotes(skipped.empty() ? pending_ : skipped)));
  throw TimeoutError(
      fmt::format("{}: no answer to \"{}\" within {:g} s. Check power, cable and baud rate.",
                  line_.name(), command, seconds(timeout)));
}

}  // namespace turntable
