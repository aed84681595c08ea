// Folders that outputs go to.
#pragma once

#include <filesystem>
#include <string_view>

namespace turntable {

/// Makes it with the folders above it; nothing if it is there. @throws RecordError naming it and the
/// cause.
void make_folder(const std::filesystem::path& folder);

/// Before long work whose outputs go there.
/// @param what, option "the study", "--out": are named with the advice.
/// @throws ConfigError if a file lies in the way, or nothing can be written there.
void require_writable(const std::filesystem::path& folder, std::string_view what,
                      std::string_view option);

}  // namespace turntable
