// What the operating system says of files, and what a person does about it.
#pragma once

#include <cerrno>
#include <filesystem>
#include <string>

namespace turntable {

/// One or two sentences on what to do about an error of a file call (errno), to stand behind its cause.
std::string file_advice(int error);

/// What an operation of the standard library on a path ran into: path, cause, advice.
std::string file_trouble(const std::filesystem::filesystem_error& error);

/// A file call that a signal came into is made again. @param call returns -1 with errno EINTR then.
template <class Call>
auto uninterrupted(Call&& call) {
  for (;;) {
    const auto result = call();
    if (result != -1 || errno != EINTR) return result;
  }
}

}  // namespace turntable
