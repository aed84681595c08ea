#include "src/record/folder.h"

#include <fmt/format.h>
#include <unistd.h>

#include <cerrno>
#include <chrono>
#include <cstdlib>
#include <cstring>
#include <string>
#include <thread>

#include "src/core/errors.h"
#include "src/core/file_errors.h"
#include "src/record/atomic_file.h"

namespace turntable {

namespace fs = std::filesystem;

void make_folder(const fs::path& folder) {
  std::error_code error;
  do fs::create_directories(folder, error);
  while (error == std::errc::interrupted);
  if (error)
    throw RecordError(
        fmt::format("{}: cannot be created: {}. {} Or choose another folder that can be written.",
                    folder.string(), error.message(), file_advice(error.value())));
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

void remove_files(const fs::path& folder, std::string_view stem,
                  std::initializer_list<std::string_view> endings) {
  std::error_code ignored;
  for (const std::string_view ending : endings)
    fs::remove(folder / (std::string(stem) += ending), ignored);
}

Scratch::Scratch(std::string_view name, std::string_view otherwise) {
  const fs::path place = temporary_files();
  std::string pattern = (place / fmt::format("{}-XXXXXX", name)).string();
  if (::mkdtemp(pattern.data()) == nullptr)
    throw RecordError(
        fmt::format("{}: no temporary folder can be made there: {}. Make room, or name another "
                    "place in TMPDIR{}.",
                    place.string(), std::strerror(errno), otherwise));
  path_ = pattern;
}

Scratch::~Scratch() {
  // A program that was killed a moment ago may still write into it.
  for (int i = 0; i < 20; ++i) {
    std::error_code error;
    fs::remove_all(path_, error);
    if (!error) return;
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
}

}  // namespace turntable
