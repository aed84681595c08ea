// Runs the program as a user does: arguments in; exit code and what it printed out.
#pragma once

#include <sys/wait.h>

#include <array>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <stdexcept>
#include <string>

namespace turntable {

inline const std::filesystem::path kScenarios =
    std::filesystem::path(TURNTABLE_SOURCE_DIR) / "scenarios";

struct Outcome {
  int code = -1;
  std::string output;  ///< stdout and stderr
};

inline Outcome turntable_program(const std::string& arguments, const std::string& before = "",
                                 const std::string& input = "/dev/null") {
  const std::string command =
      before + " " + TURNTABLE_PROGRAM + " " + arguments + " 2>&1 <" + input;
  FILE* pipe = ::popen(command.c_str(), "r");
  if (pipe == nullptr) throw std::runtime_error("popen");
  Outcome out;
  std::array<char, 4096> buffer;
  while (const std::size_t n = std::fread(buffer.data(), 1, buffer.size(), pipe))
    out.output.append(buffer.data(), n);
  const int status = ::pclose(pipe);
  out.code = WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
  return out;
}

}  // namespace turntable
