// The rig's channels while a run goes on: read when due, and a reason to wait while one of them is
// outside its band. Leaving takes the wide band, coming back the narrow one and some time in it, so
// that a value at the edge does not make the run stutter.
#pragma once

#include <optional>
#include <string>

#include "src/core/rig.h"
#include "src/record/run_journal.h"

namespace turntable {

class TelemetryWatch {
 public:
  /// Both must outlive it. @throws ConfigError if the rig has not the channels of the file.
  TelemetryWatch(const Rig& rig, const TelemetryConfig& config);

  /// Nothing if there are no channels, or the last reading is not `every_s` old.
  std::optional<TelemetryReading> read_if_due();
  /// Now. A channel that cannot be read has no value, and says why in `trouble`.
  TelemetryReading read();
  /// Of the last reading: "room 25.1 degC, allowed: 18 to 24 degC"; empty if poses may be taken. A
  /// channel that holds poses and cannot be read counts as outside.
  std::string outside() const { return complaint(false); }
  /// The same while the run waits: the narrower band.
  std::string not_yet_back() const { return complaint(true); }
  /// The longest of those that are outside: so long they have to be back. s
  double for_s() const;
  /// The shortest of those that are outside, s; infinite if none gives up.
  double give_up_s() const;

 private:
  std::string complaint(bool coming_back) const;
  bool out(std::size_t channel, bool coming_back) const;

  const Rig& rig_;
  const TelemetryConfig& config_;
  std::optional<TelemetryReading> last_;
};

}  // namespace turntable
