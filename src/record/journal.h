// journal.jsonl: the truth about a run, one JSON object per line, only ever appended to.
//   {"name":"event","doc":{...},"seq":7,"utc":"...","mono_s":1.5,"crc":"89abcdef"}
// `name` (start, descriptor, event, stop) and `doc` are Bluesky's event model; `seq` counts lines
// from 1; `mono_s` is the machine's monotonic clock, so that a stepped wall clock shows. `crc` is
// CRC-32 (IEEE 802.3, as in zlib; 8 lower-case hex digits) over the bytes of the line with
// `,"crc":"89abcdef"` taken out and without the line end: in Python,
//   zlib.crc32(line[:-18] + b"}")      for `line` without its newline.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <string>
#include <string_view>

namespace turntable {

using Json = nlohmann::json;

/// What reading a journal came to.
struct JournalReadout {
  std::uint64_t next_seq = 1;
  std::uintmax_t valid_bytes = 0;   ///< up to and with the last good line
  std::optional<std::string> torn;  ///< what was wrong with the last line, if it was cut off
};

class Journal {
 public:
  /// Starts a journal; the file must not exist. @throws RecordError.
  explicit Journal(std::filesystem::path file);
  /// Goes on with one that was read. A last line that was cut off goes: it was never acknowledged.
  /// @throws RecordError, also if the file has grown since.
  Journal(std::filesystem::path file, const JournalReadout& readout);
  ~Journal();
  Journal(const Journal&) = delete;
  Journal& operator=(const Journal&) = delete;

  /// One line, as a rule one write(2). A line that does not fit on the disk is taken back. Not thread-safe.
  /// @throws RecordError.
  void append(std::string_view name, const Json& doc);
  /// Returns once every line so far is on the medium (fdatasync). @throws RecordError.
  void sync();

 private:
  bool cut();  ///< takes back what stands behind `size_`

  std::filesystem::path file_;
  int fd_ = -1;
  std::uint64_t next_seq_ = 1;
  std::int64_t size_ = 0;
  bool torn_ = false;  ///< half a line stands behind `size_`
};

/// One line; `doc` lives only during the visit.
struct JournalEntry {
  std::string name;
  const Json& doc;
  std::uint64_t seq = 0;
  std::string utc;
  double mono_s = 0.0;
};

/// Visits every line in order, checking sequence and CRC. A last line that is damaged or has no
/// line end is what a power cut leaves: it is left out and said in `torn`. @throws ConfigError for
/// damage anywhere else, naming the line; RecordError if the disk does not give it all.
JournalReadout read_journal(const std::filesystem::path& file,
                            const std::function<void(const JournalEntry&)>& visit);

/// A random identifier (RFC 4122, version 4) as the event model asks for.
std::string new_uid();
/// Seconds since 1970, UTC.
double unix_time_s();
/// Of a time as the journal writes it ("2026-01-31T12:00:00.000Z"); NaN of anything else.
double unix_time_of(const std::string& utc);

}  // namespace turntable
