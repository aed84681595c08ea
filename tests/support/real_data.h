// Real images and points, which are not part of the project: tests on them skip where they are not.
#pragma once

#include <cstdlib>
#include <filesystem>
#include <optional>

namespace turntable {

/// The folder of the real data: the environment variable TURNTABLE_REAL, or shared/real beside the
/// source tree. A test without it calls GTEST_SKIP() and says so.
inline std::optional<std::filesystem::path> real_data() {
  const char* stated = std::getenv("TURNTABLE_REAL");
  const std::filesystem::path folder = stated ? stated : TURNTABLE_SOURCE_DIR "/../shared/real";
  if (!std::filesystem::is_directory(folder)) return std::nullopt;
  return folder;
}

}  // namespace turntable
