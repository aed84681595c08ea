#include "src/record/atomic_file.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <unistd.h>

#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <utility>

#include "src/core/errors.h"

namespace turntable {
namespace {

[[noreturn]] void fail(const std::filesystem::path& file, const char* what, int error) {
  const char* advice = "";
  if (error == ENOSPC || error == EDQUOT || error == EFBIG) advice = " Make room.";
  if (error == EROFS || error == EACCES || error == EPERM)
    advice = " Make the folder writable, or choose one that can be written.";
  throw RecordError(
      fmt::format("{}: {} failed: {}.{}", file.string(), what, std::strerror(error), advice));
}

/// A call that a signal interrupted is made again.
template <class Call>
auto uninterrupted(Call&& call) {
  for (;;) {
    const auto result = call();
    if (result != -1 || errno != EINTR) return result;
  }
}

}  // namespace

/// Some file systems sync files but know nothing of folders (shared folders of virtual machines, CIFS
/// before Linux 4.17): they say EINVAL or ENOTSUP. What they keep they keep; EIO is another matter.
void sync_folder(const std::filesystem::path& folder) {
  const std::filesystem::path where = folder.empty() ? "." : folder;
  const int fd =
      uninterrupted([&] { return ::open(where.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC); });
  if (fd < 0) fail(where, "opening the folder", errno);
  const int result = uninterrupted([&] { return ::fsync(fd); });
  const int error = errno;
  ::close(fd);
  if (result != 0 && error != EINVAL && error != ENOTSUP && error != ENOSYS)
    fail(where, "syncing the folder", error);
}

StagedFile::StagedFile(const std::filesystem::path& file, std::string_view bytes)
    : StagedFile(file, [bytes](const ByteSink& sink) { sink(bytes); }) {}

StagedFile::StagedFile(const std::filesystem::path& file, const ByteSource& source)
    : target_(file), temporary_(file.string() + fmt::format(".tmp{}", ::getpid())) {
  int fd = uninterrupted(
      [&] { return ::open(temporary_.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0644); });
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
    if (uninterrupted([&] { return ::fsync(fd); }) != 0) fail(target_, "syncing", errno);
    // Linux has closed it all the same when a signal interrupts that.
    if (::close(std::exchange(fd, -1)) != 0 && errno != EINTR) fail(target_, "closing", errno);
  } catch (...) {
    if (fd >= 0) ::close(fd);
    ::unlink(temporary_.c_str());
    throw;
  }
}

StagedFile::StagedFile(StagedFile&& other) noexcept
    : target_(std::move(other.target_)), temporary_(std::exchange(other.temporary_, {})) {}

StagedFile::~StagedFile() {
  if (!temporary_.empty()) ::unlink(temporary_.c_str());
}

void StagedFile::commit() {
  if (uninterrupted([&] { return ::rename(temporary_.c_str(), target_.c_str()); }) != 0)
    fail(target_, "renaming", errno);
  temporary_.clear();
}

bool is_temporary(const std::filesystem::path& file) {
  return file.extension().string().starts_with(".tmp");
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
