#include "src/record/journal.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/random.h>
#include <time.h>
#include <unistd.h>

#include <array>
#include <boost/crc.hpp>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <ctime>
#include <fstream>
#include <limits>
#include <nlohmann/json.hpp>

#include "src/core/clock.h"
#include "src/core/errors.h"
#include "src/core/file_errors.h"
#include "src/record/atomic_file.h"

namespace turntable {
namespace {

constexpr std::string_view kCrcKey = R"(,"crc":")";
constexpr std::size_t kCrcMember = kCrcKey.size() + 8 + 1;  // with its closing quote

/// Over `body` + "}", the line as it would be without the crc member.
std::string crc_of(std::string_view body) {
  boost::crc_32_type crc;
  crc.process_bytes(body.data(), body.size());
  crc.process_byte('}');
  return fmt::format("{:08x}", crc.checksum());
}

double monotonic_s() {
  timespec t{};
  ::clock_gettime(CLOCK_MONOTONIC, &t);
  return static_cast<double>(t.tv_sec) + 1e-9 * static_cast<double>(t.tv_nsec);
}

[[noreturn]] void fail_recording(const std::filesystem::path& file, const char* what, int error) {
  throw RecordError(fmt::format("{}: {} failed: {}. What was recorded before is safe. {}",
                                file.string(), what, std::strerror(error), file_advice(error)));
}

/// @return what is wrong with the line; empty if nothing is.
std::string check_line(std::string_view line, std::uint64_t expected_seq, Json& out) {
  if (line.size() < kCrcMember + 2 || line.back() != '}') return "is not a whole journal line";
  const std::string_view body = line.substr(0, line.size() - kCrcMember - 1);
  const std::string_view member = line.substr(body.size());
  if (!member.starts_with(kCrcKey)) return "has no CRC at its end";
  if (member.substr(kCrcKey.size(), 8) != crc_of(body)) return "does not match its CRC";
  out = Json::parse(line, nullptr, /*allow_exceptions=*/false);
  if (!out.is_object() || !out.contains("name") || !out["name"].is_string() ||
      !out.contains("doc") || !out["doc"].is_object() || !out.contains("seq") ||
      !out["seq"].is_number_unsigned() || !out.contains("utc") || !out["utc"].is_string() ||
      !out.contains("mono_s") || !out["mono_s"].is_number())
    return "is not a journal document";
  if (const auto seq = out["seq"].get<std::uint64_t>(); seq != expected_seq)
    return fmt::format("has sequence number {} where {} was expected", seq, expected_seq);
  return {};
}

}  // namespace

Journal::Journal(std::filesystem::path file) : file_(std::move(file)) {
  fd_ = uninterrupted([this] {
    return ::open(file_.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_APPEND | O_CLOEXEC, 0644);
  });
  if (fd_ < 0) fail_recording(file_, "creating the journal", errno);
  try {
    sync_folder(file_.parent_path());
  } catch (...) {
    ::close(fd_);
    throw;
  }
}

Journal::Journal(std::filesystem::path file, const JournalReadout& readout)
    : file_(std::move(file)),
      next_seq_(readout.next_seq),
      size_(static_cast<std::int64_t>(readout.valid_bytes)) {
  // A run that was ended before its journal was made goes on with a new one.
  const int create = size_ == 0 ? O_CREAT : 0;
  fd_ = uninterrupted(
      [&] { return ::open(file_.c_str(), O_WRONLY | O_APPEND | O_CLOEXEC | create, 0644); });
  if (fd_ < 0) fail_recording(file_, "opening the journal", errno);
  try {
    if (create != 0) sync_folder(file_.parent_path());
  } catch (...) {
    ::close(fd_);
    throw;
  }
  const off_t found = ::lseek(fd_, 0, SEEK_END);
  if (found < size_ || (!readout.torn && found > size_)) {
    ::close(fd_);
    throw RecordError(fmt::format("{}: has changed since it was read: somebody else writes to it.",
                                  file_.string()));
  }
  if (found > size_ && uninterrupted([this] { return ::ftruncate(fd_, size_); }) != 0) {
    const int error = errno;
    ::close(fd_);
    fail_recording(file_, "cutting off its torn last line", error);
  }
}

Journal::~Journal() {
  if (fd_ >= 0) ::close(fd_);
}

bool Journal::cut() {
  torn_ = uninterrupted([this] { return ::ftruncate(fd_, size_); }) != 0;
  return !torn_;
}

void Journal::append(std::string_view name, const Json& doc) {
  // Behind half a line every other would be lost: as the last one it is what a reader leaves out.
  if (torn_ && !cut()) fail_recording(file_, "taking back a line that was cut off", errno);
  // Devices may say anything about themselves: what is not UTF-8 is replaced, not refused.
  std::string line = fmt::format(R"({{"name":"{}","doc":{},"seq":{},"utc":"{}","mono_s":{:.6f})",
                                 name, doc.dump(-1, ' ', false, Json::error_handler_t::replace),
                                 next_seq_, utc_now(), monotonic_s());
  const std::string crc = crc_of(line);
  line.append(kCrcKey).append(crc).append("\"}\n");

  // Nearly always one write takes it all; what a disk or a share takes in parts, it gets in parts.
  for (std::string_view rest = line; !rest.empty();) {
    const ssize_t written = uninterrupted([&] { return ::write(fd_, rest.data(), rest.size()); });
    if (written > 0) {
      rest.remove_prefix(static_cast<std::size_t>(written));
      continue;
    }
    const int error = written < 0 ? errno : ENOSPC;
    if (rest.size() < line.size()) cut();
    fail_recording(file_, "writing", error);
  }
  size_ += static_cast<std::int64_t>(line.size());
  ++next_seq_;
}

void Journal::sync() {
  if (uninterrupted([this] { return ::fdatasync(fd_); }) != 0)
    fail_recording(file_, "syncing", errno);
}

JournalReadout read_journal(const std::filesystem::path& file,
                            const std::function<void(const JournalEntry&)>& visit) {
  std::ifstream in(file, std::ios::binary);
  const int cause = errno;
  std::error_code error;
  if (!in && cause != ENOENT)
    throw RecordError(fmt::format("{}: cannot be read: {}. {}", file.string(), std::strerror(cause),
                                  file_advice(cause)));
  if (!in || std::filesystem::is_directory(file, error))
    throw ConfigError(
        file.string(), "",
        "is no journal. A run folder has one once it was started: \"turntable resume\" "
        "goes on with a run that was ended before.");
  JournalReadout out;
  std::string line;
  Json parsed;
  while (std::getline(in, line)) {
    const bool ended = !in.eof();
    std::string wrong = check_line(line, out.next_seq, parsed);
    if (wrong.empty() && !ended) wrong = "has no line end";
    if (!wrong.empty()) {
      const std::string what = fmt::format("line {} {}", out.next_seq, wrong);
      if (ended && in.peek() != std::ifstream::traits_type::eof())
        throw ConfigError(
            file.string(), "",
            what +
                ". The journal was altered or damaged; only its last line may be cut off. "
                "Restore the file from a copy.");
      out.torn = what;
      break;
    }
    visit({parsed["name"].get<std::string>(), parsed["doc"], out.next_seq,
           parsed["utc"].get<std::string>(), parsed["mono_s"].get<double>()});
    ++out.next_seq;
    out.valid_bytes += line.size() + 1;
  }
  // Not its end: what is behind it is there and may not be taken for lost.
  if (in.bad())
    throw RecordError(fmt::format("{}: reading failed behind line {}. {}", file.string(),
                                  out.next_seq - 1, file_advice(EIO)));
  return out;
}

std::string new_uid() {
  std::array<unsigned char, 16> b{};
  if (::getrandom(b.data(), b.size(), 0) != static_cast<ssize_t>(b.size()))
    throw RecordError("the operating system gives no random numbers");
  b[6] = static_cast<unsigned char>((b[6] & 0x0fu) | 0x40u);
  b[8] = static_cast<unsigned char>((b[8] & 0x3fu) | 0x80u);
  std::string uid;
  for (std::size_t i = 0; i < b.size(); ++i) {
    if (i == 4 || i == 6 || i == 8 || i == 10) uid += '-';
    uid += fmt::format("{:02x}", b[i]);
  }
  return uid;
}

double unix_time_s() {
  return std::chrono::duration<double>(std::chrono::system_clock::now().time_since_epoch()).count();
}

double unix_time_of(const std::string& utc) {
  std::tm day{};
  double second = 0.0;
  char zone = 0;
  if (std::sscanf(utc.c_str(), "%4d-%2d-%2dT%2d:%2d:%lf%c", &day.tm_year, &day.tm_mon, &day.tm_mday,
                  &day.tm_hour, &day.tm_min, &second, &zone) != 7 ||
      zone != 'Z')
    return std::numeric_limits<double>::quiet_NaN();
  day.tm_year -= 1900;
  day.tm_mon -= 1;
  return static_cast<double>(::timegm(&day)) + second;
}

}  // namespace turntable
