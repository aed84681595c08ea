#include "src/record/atomic_file.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <unistd.h>

#include <cerrno>
#include <csignal>
#include <cstdlib>
#include <cstring>
#include <utility>
#include <vector>

#include "src/core/errors.h"
#include "src/core/file_errors.h"

namespace turntable {
namespace {

[[noreturn]] void fail(const std::filesystem::path& file, const char* what, int error) {
  throw RecordError(fmt::format("{}: {} failed: {}. {}", file.string(), what, std::strerror(error),
                                file_advice(error)));
}

int sync_descriptor(int fd) {
  return uninterrupted([fd] { return ::fsync(fd); });
}

void remove_temporary(const std::string& file) {
  uninterrupted([&] { return ::unlink(file.c_str()); });
}

/// On Linux the descriptor is gone even where close was interrupted.
int close_descriptor(int fd) {
  const int result = ::close(fd);
  return result != 0 && errno == EINTR ? 0 : result;
}

}  // namespace

/// Some file systems sync files but know nothing of folders (shared folders of virtual machines, CIFS
/// before Linux 4.17): they say EINVAL or ENOTSUP. What they keep they keep; EIO is another matter.
void sync_folder(const std::filesystem::path& folder) {
  const std::filesystem::path where = folder.empty() ? "." : folder;
  const int fd =
      uninterrupted([&] { return ::open(where.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC); });
  if (fd < 0) fail(where, "opening the folder", errno);
  const int result = sync_descriptor(fd);
  const int error = errno;
  ::close(fd);
  if (result != 0 && error != EINVAL && error != ENOTSUP && error != ENOSYS)
    fail(where, "syncing the folder", error);
}

StagedFile::StagedFile(const std::filesystem::path& file, std::string_view bytes)
    : StagedFile(file, [bytes](const ByteSink& sink) { sink(bytes); }) {}

StagedFile::StagedFile(const std::filesystem::path& file, const ByteSource& source)
    : target_(file), temporary_(file.string() + fmt::format(".tmp{}", ::getpid())) {
  int fd = uninterrupted([this] {
    return ::open(temporary_.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0644);
  });
  if (fd < 0) fail(target_, "creating it", errno);
  const auto write = [&](std::string_view bytes) {
    while (!bytes.empty()) {
      const ssize_t n = uninterrupted([&] { return ::write(fd, bytes.data(), bytes.size()); });
      if (n < 0) fail(target_, "writing", errno);
      bytes.remove_prefix(static_cast<std::size_t>(n));
    }
  };
  try {
    constexpr std::size_t kTogether = 1u << 16;
    std::string small;  // pieces on their way
    source([&](std::string_view bytes) {
      if (small.size() + bytes.size() >= kTogether) {
        write(small);
        small.clear();
      }
      if (bytes.size() >= kTogether)
        write(bytes);
      else
        small += bytes;
    });
    write(small);
    if (sync_descriptor(fd) != 0) fail(target_, "syncing", errno);
    if (close_descriptor(std::exchange(fd, -1)) != 0) fail(target_, "closing", errno);
  } catch (...) {
    if (fd >= 0) ::close(fd);
    remove_temporary(temporary_);
    throw;
  }
}

StagedFile::StagedFile(StagedFile&& other) noexcept
    : target_(std::move(other.target_)), temporary_(std::exchange(other.temporary_, {})) {}

StagedFile::~StagedFile() {
  if (!temporary_.empty()) remove_temporary(temporary_);
}

void StagedFile::commit() {
  const int result =
      uninterrupted([this] { return ::rename(temporary_.c_str(), target_.c_str()); });
  if (result != 0) fail(target_, "renaming", errno);
  temporary_.clear();
}

bool is_temporary(const std::filesystem::path& file) {
  return file.extension().string().starts_with(".tmp");
}

namespace {

/// By a process that is still there, to tell by the number in its name.
bool is_being_written(const std::filesystem::path& temporary) {
  const std::string ending = temporary.extension().string();
  const int process = std::atoi(ending.c_str() + std::strlen(".tmp"));
  return process > 0 && process != ::getpid() && (::kill(process, 0) == 0 || errno == EPERM);
}

}  // namespace

void remove_temporaries(const std::filesystem::path& folder) {
  std::error_code ignored;
  std::vector<std::filesystem::path> found;
  for (std::filesystem::directory_iterator it(folder, ignored), end; !ignored && it != end;
       it.increment(ignored))
    if (is_temporary(it->path()) && !is_being_written(it->path())) found.push_back(it->path());
  for (const auto& file : found) std::filesystem::remove(file, ignored);
}

void write_atomically(const std::filesystem::path& file, std::string_view bytes) {
  write_atomically(file, [bytes](const ByteSink& sink) { sink(bytes); });
}

void write_atomically(const std::filesystem::path& file, const ByteSource& source) {
  std::error_code error;
  const auto status = std::filesystem::status(file, error);
  if (std::filesystem::exists(status) && !std::filesystem::is_regular_file(status))
    throw RecordError(fmt::format(
        "{}: is no regular file, which would be replaced. Name a file, or one that is not there.",
        file.string()));
  // A link stays a link.
  const auto target = std::filesystem::is_symlink(file, error)
                          ? std::filesystem::weakly_canonical(file, error)
                          : file;
  StagedFile(target, source).commit();
  sync_folder(target.parent_path());
}

std::filesystem::path temporary_files() {
  std::error_code error;
  const auto folder = std::filesystem::temp_directory_path(error);
  if (!error) return folder;
  const char* named = std::getenv("TMPDIR");
  throw RecordError(
      fmt::format("TMPDIR: found \"{}\", allowed: a folder that is there. Name another.",
                  named != nullptr ? named : "/tmp"));
}

}  // namespace turntable
