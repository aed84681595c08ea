// Files that are either the old one or the new one, whatever happens in between.
#pragma once

#include <filesystem>
#include <functional>
#include <string>
#include <string_view>

namespace turntable {

/// Takes the next bytes of a file.
using ByteSink = std::function<void(std::string_view)>;
/// Gives all bytes of a file, piece by piece: of one that need not be in memory as a whole.
using ByteSource = std::function<void(const ByteSink&)>;

/// A file that is on the medium already, but not under its name. Several may be staged at once from
/// several threads: their syncs then share the disk's time, which is most of what an image costs.
/// Vanishes unless committed.
class StagedFile {
 public:
  /// Writes `bytes` to a temporary file beside `file` and syncs it. @throws RecordError naming the
  /// file and the cause (full disk, read-only, ...).
  StagedFile(const std::filesystem::path& file, std::string_view bytes);
  StagedFile(const std::filesystem::path& file, const ByteSource& source);
  ~StagedFile();
  StagedFile(StagedFile&& other) noexcept;
  StagedFile& operator=(StagedFile&&) = delete;

  /// Gives the file its name, replacing an older one; lasting once its folder is synced. @throws
  /// RecordError.
  void commit();

 private:
  std::filesystem::path target_;
  std::string temporary_;  ///< empty once committed
};

/// Stages, commits and syncs the folder. When this returns, the file survives a power cut; when it
/// throws, nothing of it is left behind and an older file of that name is untouched. @throws
/// RecordError.
void write_atomically(const std::filesystem::path& file, std::string_view bytes);
void write_atomically(const std::filesystem::path& file, const ByteSource& source);

/// True of the names that a process leaves behind if it is killed while it stages a file.
bool is_temporary(const std::filesystem::path& file);

/// Removes them from `folder`, but those of other processes that still run; what cannot be removed stays.
void remove_temporaries(const std::filesystem::path& folder);

/// Makes new names in `folder` survive a power cut, where its file system can promise that: one that does not know of
/// syncing folders (EINVAL) is taken as it is. @throws RecordError.
void sync_folder(const std::filesystem::path& folder);

/// Where temporary files go: TMPDIR, else /tmp. @throws RecordError if that is no folder.
std::filesystem::path temporary_files();

}  // namespace turntable
