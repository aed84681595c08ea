#include "src/app/progress.h"

#include <fmt/format.h>
#include <unistd.h>

#include <cmath>
#include <cstdio>

namespace turntable {
namespace {

using std::chrono::steady_clock;

double seconds_between(steady_clock::time_point a, steady_clock::time_point b) {
  return std::chrono::duration<double>(b - a).count();
}

}  // namespace

ProgressLine::ProgressLine(std::string what)
    : what_(std::move(what)),
      terminal_(::isatty(STDERR_FILENO) != 0),
      start_(steady_clock::now()),
      last_(start_) {}

ProgressLine::~ProgressLine() {
  if (terminal_ && width_ > 0) fmt::print(stderr, "\r{:{}}\r", "", width_);
}

void ProgressLine::update(std::size_t done, std::size_t total, std::string_view phase,
                          double eta_s) {
  const std::lock_guard lock(mutex_);
  done_ = std::max(done_, done);  // threads may report out of order
  if (!is_due()) return;
  if (eta_s < 0 && done_ > 0)
    eta_s = seconds_between(start_, last_) * static_cast<double>(total - done_) /
            static_cast<double>(done_);
  std::string text = fmt::format("{}: {} of {}", what_, done_, total);
  if (!phase.empty()) text += fmt::format(", {}", phase);
  if (eta_s >= 0) text += fmt::format(", {} left", duration_text(eta_s));
  show(text);
}

void ProgressLine::wait(double at_most_s) {
  const std::lock_guard lock(mutex_);
  if (is_due())
    show(fmt::format("{}: {:.0f} s, at most {}", what_, seconds_between(start_, last_),
                     duration_text(at_most_s)));
}

bool ProgressLine::is_due() {
  const auto now = steady_clock::now();
  // Nothing for short work; then often on a terminal, seldom in a log.
  if (seconds_between(start_, now) < (terminal_ ? 0.3 : 2.0) ||
      seconds_between(last_, now) < (terminal_ ? 0.1 : 10.0))
    return false;
  last_ = now;
  return true;
}

void ProgressLine::show(const std::string& text) {
  if (terminal_) {
    fmt::print(stderr, "\r{:{}}", text, width_);
    width_ = std::max(width_, text.size());
  } else {
    fmt::print(stderr, "{}\n", text);
  }
  std::fflush(stderr);
}

std::string duration_text(double seconds) {
  const auto s = static_cast<long>(std::ceil(std::max(0.0, seconds)));
  if (s < 120) return fmt::format("{} s", s);
  if (s < 7200) return fmt::format("{} min {:02} s", s / 60, s % 60);
  return fmt::format("{} h {:02} min", s / 3600, s / 60 % 60);
}

}  // namespace turntable
