// Progress for people: one rewritten line on a terminal, now and then a plain line elsewhere.
#pragma once

#include <chrono>
#include <cstddef>
#include <mutex>
#include <string>
#include <string_view>

namespace turntable {

class ProgressLine {
 public:
  explicit ProgressLine(std::string what);
  ~ProgressLine();
  ProgressLine(const ProgressLine&) = delete;
  ProgressLine& operator=(const ProgressLine&) = delete;

  /// "what: pose 17 of 240, moving, 1 min 20 s left". Thread-safe. @param eta_s negative = work it
  /// out from the pace.
  void update(std::size_t done, std::size_t total, std::string_view phase, double eta_s = -1.0);
  /// "what: 4 s, at most 60 s": of work that does not say how far it is.
  void wait(double at_most_s);

 private:
  /// Whether it is time to show something.
  bool is_due();
  void show(const std::string& text);

  std::string what_;
  bool terminal_;
  std::mutex mutex_;
  std::chrono::steady_clock::time_point start_, last_;
  std::size_t width_ = 0;
  std::size_t done_ = 0;
};

/// "42 s", "3 min 05 s", "2 h 10 min".
std::string duration_text(double seconds);

}  // namespace turntable
