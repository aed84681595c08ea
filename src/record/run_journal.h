// Writes a run's documents into its journal, in the order and shape of Bluesky's event model:
// start, descriptors "primary" (one event per pose), "overlap" (poses that a resumed session took
// again), "baseline" (the axes at start and end), "telemetry", "interruptions" (pause, suspend and
// going on) and "time" (where a session's time went), events, stop. A resumed run goes on in the
// same file with a start document of its own, which names the first one's uid in `resumes`.
#pragma once

#include <array>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "src/record/journal.h"
#include "src/record/run_folder.h"

namespace turntable {

inline constexpr std::string_view kOverlapStream = "overlap";

/// Not thread-safe. Every function @throws RecordError.
class RunJournal {
 public:
  /// Creates the journal of `folder` and writes the start document: `start` (no "." or "/" in its
  /// keys) and what the event model asks for.
  RunJournal(const RunFolder& folder, const Json& start);
  /// Goes on with the journal of `before`. A session that was killed gets the stop document that it
  /// could not write.
  RunJournal(const RunFolder& folder, const Json& start, const RunState& before);

  /// Axis positions (mm, deg) in the order of kAllAxes.
  void baseline(const std::array<double, kAllAxes.size()>& positions);
  /// Not to be relied on before `sync`.
  void pose(const TakenPose& taken, std::string_view scenario_name, bool overlap = false);
  /// @param reading values in the order of `config`
  void telemetry(const TelemetryReading& reading, const TelemetryConfig& config);
  /// Where a session's time went, s by phase. On disk when this returns.
  void time(const std::map<std::string, double>& phases_s);
  /// On disk when this returns. @param what "pause", "suspend", "resume", "end" (of a run in a pause)
  void interruption(std::string_view what, const std::string& reason);
  /// All poses so far are on the medium when this returns.
  void sync() { journal_.sync(); }
  /// On disk when this returns. @param exit_status "success", "abort" (a person asked) or "fail"
  void stop(std::string_view exit_status, const std::string& reason);

 private:
  void begin(Json start);
  void event(const std::string& stream, const Json& data, const Json& data_keys);

  struct Stream {
    std::string descriptor;
    int events = 0;
  };
  Journal journal_;
  std::string run_;
  std::map<std::string, Stream> streams_;
};

}  // namespace turntable
