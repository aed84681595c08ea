// Folders that outputs go to.
#pragma once

#include <filesystem>
#include <initializer_list>
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

/// Removes <folder>/<stem><ending> of every ending, as far as that goes: what is not there, or cannot be
/// removed, stays.
void remove_files(const std::filesystem::path& folder, std::string_view stem,
                  std::initializer_list<std::string_view> endings);

/// A temporary folder, gone with this object and all that is in it.
class Scratch {
 public:
  /// @param name what its name begins with: "turntable-print". @param otherwise more advice: ", or give --no-pdf"
  /// @throws RecordError: it cannot be made.
  explicit Scratch(std::string_view name, std::string_view otherwise = "");
  ~Scratch();
  Scratch(const Scratch&) = delete;
  Scratch& operator=(const Scratch&) = delete;

  const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
};

}  // namespace turntable
