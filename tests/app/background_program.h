// The program in the background: its output goes to a file, and it is ended with the test.
#pragma once

#include <fcntl.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <filesystem>
#include <sstream>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include "tests/support/temporary_folder.h"

namespace turntable {

class BackgroundProgram {
 public:
  /// @param arguments separated by blanks.
  BackgroundProgram(const std::string& arguments, std::filesystem::path log)
      : log_(std::move(log)) {
    std::vector<std::string> words{TURNTABLE_PROGRAM};
    std::istringstream in(arguments);
    for (std::string word; in >> word;) words.push_back(word);
    // Emptied before there are two processes: nobody may read what an earlier program printed.
    const int out = ::open(log_.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0600);
    int ends[2];
    if (out < 0 || ::pipe2(ends, O_CLOEXEC) != 0) throw std::runtime_error("log or pipe");
    pid_ = ::fork();
    if (pid_ == 0) {
      ::dup2(ends[0], STDIN_FILENO);
      ::dup2(out, STDOUT_FILENO);
      ::dup2(out, STDERR_FILENO);
      std::vector<char*> argv;
      for (std::string& word : words) argv.push_back(word.data());
      argv.push_back(nullptr);
      ::execv(argv[0], argv.data());
      ::_exit(127);
    }
    ::close(out);
    ::close(ends[0]);
    input_ = ends[1];
  }
  ~BackgroundProgram() {
    ::close(input_);
    if (pid_ <= 0) return;
    ::kill(pid_, SIGKILL);
    ::waitpid(pid_, nullptr, 0);
  }
  BackgroundProgram(const BackgroundProgram&) = delete;
  BackgroundProgram& operator=(const BackgroundProgram&) = delete;

  std::string output() const { return slurp(log_); }
  /// Waits until it has printed `text`; false after 20 s.
  bool prints(const std::string& text) const {
    for (int i = 0; i < 2000; ++i) {
      if (output().find(text) != std::string::npos) return true;
      std::this_thread::sleep_for(std::chrono::milliseconds{10});
    }
    return false;
  }
  void say(const std::string& line) {
    if (::write(input_, line.data(), line.size()) < 0) throw std::runtime_error("write");
  }
  void signal(int number) { ::kill(pid_, number); }
  /// Waits for its end. @return exit code, or 128 + signal.
  int ended() {
    int status = 0;
    ::waitpid(pid_, &status, 0);
    pid_ = -1;
    return WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
  }

 private:
  std::filesystem::path log_;
  pid_t pid_ = -1;
  int input_ = -1;
};

}  // namespace turntable
