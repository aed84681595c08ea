#include "src/core/file_errors.h"

#include <fmt/format.h>

namespace turntable {

std::string file_advice(int error) {
  switch (error) {
    case ENOSPC:
    case EDQUOT:
    case EFBIG:
      return "Make room.";
    case EROFS:
    case EACCES:
    case EPERM:
      return "Make the folder writable, or choose one that can be written.";
    case EMFILE:
    case ENFILE:
    case ENOMEM:
      return "Close other programs, or let this one have more open files (ulimit -n), and try "
             "again.";
    case ENAMETOOLONG:
    case EINVAL:
    case ELOOP:
      return "Choose another, shorter name.";
    case ENOENT:
    case ENOTDIR:
      return "Check that its folder is still there.";
    default:
      return "Check the disk or the share that it is on, and try again.";
  }
}

std::string file_trouble(const std::filesystem::filesystem_error& error) {
  constexpr std::size_t kShown =
      300;  // bytes; of a name that is too long its beginning says enough
  std::string path = error.path1().string();
  if (path.size() > kShown) path = path.substr(0, kShown) + "...";
  return fmt::format("{}: cannot be looked at: {}. {}", path, error.code().message(),
                     file_advice(error.code().value()));
}

}  // namespace turntable
