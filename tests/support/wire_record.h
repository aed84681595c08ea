// What passed on a line, as text, with the time at which it passed.
#pragma once

#include <algorithm>
#include <functional>
#include <mutex>
#include <string>
#include <vector>

#include "protocols/line.h"

namespace turntable {

class WireRecord {
 public:
  WireLog log() {
    return [this](Direction direction, std::string_view bytes, Time time) {
      {
        const std::lock_guard lock(mutex_);
        (direction == Direction::kSent ? sent_ : received_) += bytes;
      }
      if (direction == Direction::kSent && on_sent) on_sent(bytes, time);
    };
  }
  /// Called with what is sent, on the sending thread, before anything is answered.
  std::function<void(std::string_view bytes, Time)> on_sent;

  std::string sent() const {
    const std::lock_guard lock(mutex_);
    return sent_;
  }
  std::string received() const {
    const std::lock_guard lock(mutex_);
    return received_;
  }
  void clear() {
    const std::lock_guard lock(mutex_);
    sent_.clear();
    received_.clear();
  }
  /// Commands whose text begins with `verb`.
  std::vector<std::string> commands(std::string_view verb) const {
    std::vector<std::string> found;
    std::string text = sent();
    for (std::size_t begin = 0; begin < text.size();) {
      const std::size_t end = std::min(text.find('\r', begin), text.size());
      if (const std::string command = text.substr(begin, end - begin); command.starts_with(verb))
        found.push_back(command);
      begin = end + 1;
    }
    return found;
  }

 private:
  mutable std::mutex mutex_;
  std::string sent_, received_;
};

}  // namespace turntable
