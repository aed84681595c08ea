#include "src/record/folder.h"

#include <fmt/format.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>

#include "src/core/errors.h"

namespace turntable {

namespace fs = std::filesystem;

void make_folder(const fs::path& folder) {
  std::error_code error;
  fs::create_directories(folder, error);
  if (error)
    throw RecordError(fmt::format("{}: cannot be created: {}. Choose a folder that can be written.",
                                  folder.string(), error.message()));
}

void require_writable(const fs::path& folder, std::string_view what, std::string_view option) {
  std::error_code error;
  for (fs::path at = fs::absolute(folder, error).lexically_normal(); !at.empty();
       at = at.parent_path()) {
    const fs::file_status status = fs::status(at, error);
    if (fs::exists(status) && !fs::is_directory(status))
      throw ConfigError(at.string(), "",
                        fmt::format("is a file. Choose a folder for {} ({}).", what, option));
    if (fs::is_directory(status)) {
      if (::access(at.c_str(), W_OK | X_OK) != 0)
        throw ConfigError(
            at.string(), "",
            fmt::format("cannot be written to: {}. Choose another folder for {} ({}).",
                        std::strerror(errno), what, option));
      return;
    }
    if (at == at.parent_path()) return;
  }
}

}  // namespace turntable
