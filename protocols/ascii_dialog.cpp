#include "protocols/ascii_dialog.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <utility>

#include "src/core/errors.h"

namespace turntable {
namespace {

constexpr Time kSlice = std::chrono::milliseconds{20};

/// For messages: noise must not spoil a terminal or a journal.
std::string printable(std::string_view text) {
  std::string shown;
  for (const char c : text.substr(0, 60)) {
    if (c >= ' ' && c <= '~')
      shown += c;
    else
      shown += fmt::format("\\x{:02x}", static_cast<unsigned char>(c));
  }
  return shown;
}

}  // namespace

std::string upper(std::string_view text) {
  std::string s(text);
  for (char& c : s) c = c >= 'a' && c <= 'z' ? static_cast<char>(c - 'a' + 'A') : c;
  return s;
}

AsciiDialog::AsciiDialog(Line line, Clock& clock, Predicate unsolicited)
    : line_(std::move(line)), clock_(&clock), unsolicited_(std::move(unsolicited)) {}

/// Reads what is there into `pending_`. @return number of bytes.
std::size_t AsciiDialog::read_pending() {
  std::array<char, 512> buffer;
  const std::size_t n = line_.read_available(buffer, clock_->now());
  pending_.append(buffer.data(), n);
  return n;
}

std::optional<std::string> AsciiDialog::next_line() {
  for (;;) {
    const std::size_t end = pending_.find('\r');
    if (end == std::string::npos) {
      if (pending_.size() > kLongestLine) {
        overlong_ = true;
        pending_.clear();
      }
      return std::nullopt;
    }
    std::string text = pending_.substr(0, end);
    pending_.erase(0, end + 1);
    std::erase(text, '\n');  // some serial servers add one
    if (overlong_ || text.size() > kLongestLine || text.empty()) {
      overlong_ = false;
      continue;
    }
    if (!unsolicited_ || !unsolicited_(text)) return text;
  }
}

void AsciiDialog::pump() {
  do {
    while (next_line()) {
    }
  } while (read_pending() > 0);
}

/// Ends what was half said; a command that was cut off must not be carried out as it stands.
std::string AsciiDialog::line_end() const { return cut_off_ ? "!\r" : "\r"; }

void AsciiDialog::send(std::string_view bytes, Time deadline) {
  cut_off_ = true;
  line_.write(bytes, *clock_, deadline);
  cut_off_ = false;
}

void AsciiDialog::tell(std::string_view command, Time timeout) {
  pump();
  std::string bytes = in_step_ ? "" : line_end();
  bytes.append(command).push_back('\r');
  const bool was_in_step = std::exchange(in_step_, false);
  send(bytes, clock_->now() + timeout);
  in_step_ = was_in_step;
}

void AsciiDialog::resync(Time quiet, Time at_most) {
  in_step_ = false;
  const Time end = clock_->now() + at_most;
  send(line_end(), end);
  while (clock_->wait_readable(line_.descriptor(), std::min(end, clock_->now() + quiet)) &&
         clock_->now() < end)
    pump();
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
  bytes.append(command).push_back('\r');
  in_step_ = false;
  const Time deadline = clock_->now() + timeout;
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
    if (read_pending() > 0) continue;
    const Time slice = give_way ? std::min(deadline, clock_->now() + kSlice) : deadline;
    if (clock_->wait_readable(line_.descriptor(), slice)) continue;
    if (clock_->now() >= deadline) break;
    if (give_way())
      throw GaveWay(fmt::format("{}: \"{}\" gave way to a stop", line_.name(), command));
  }
  if (!skipped.empty() || !pending_.empty())
    throw ProtocolError(
        fmt::format("{}: \"{}\" was answered by \"{}\", which is no answer to it. Check baud "
                    "rate and cable.",
                    line_.name(), command, printable(skipped.empty() ? pending_ : skipped)));
  throw TimeoutError(
      fmt::format("{}: no answer to \"{}\" within {:g} s. Check power, cable and baud rate.",
                  line_.name(), command, seconds(timeout)));
}

}  // namespace turntable
