// Writes a run's documents into its journal, in the order and shape of Bluesky's event model:
// start, descriptors "primary" (one event per pose) and "baseline" (the axes at start and end),
// events, stop.
#pragma once

#include <array>
#include <map>
#include <string>
#include <string_view>

#include "src/record/journal.h"
#include "src/record/run_folder.h"

namespace turntable {

/// Not thread-safe. Every function @throws RecordError.
class RunJournal {
 public:
  /// Creates the journal of `folder` and writes the start document: `start` (no "." or "/" in its
  /// keys) and what the event model asks for.
  RunJournal(const RunFolder& folder, const Json& start);

  /// Axis positions (mm, deg) in the order of kAllAxes.
  void baseline(const std::array<double, kAllAxes.size()>& positions);
  /// Not to be relied on before `sync`.
  void pose(const TakenPose& taken, std::string_view scenario_name);
  /// All poses so far are on the medium when this returns.
  void sync() { journal_.sync(); }
  /// On disk when this returns. @param exit_status "success", "abort" (a person asked) or "fail"
  void stop(std::string_view exit_status, const std::string& reason);

 private:
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
