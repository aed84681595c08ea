#include "src/report/pdf.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <signal.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <chrono>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <thread>
#include <vector>

#include "src/core/errors.h"
#include "src/core/interrupt.h"
#include "src/record/atomic_file.h"

extern char** environ;

namespace turntable {
namespace {

namespace fs = std::filesystem;
using std::chrono::steady_clock;

/// Chromium's names, the one that begins fastest first.
constexpr const char* kChromium[] = {"chromium-headless-shell", "chromium", "chromium-browser",
                                     "google-chrome"};

constexpr const char* kByHand = "Or print the page beside it from any browser.";

/// A child and whatever it starts: a process group, killed with this object.
class Group {
 public:
  explicit Group(std::vector<std::string> command) {
    posix_spawn_file_actions_t actions;
    posix_spawn_file_actions_init(&actions);
    for (const int fd : {STDIN_FILENO, STDOUT_FILENO, STDERR_FILENO})
      posix_spawn_file_actions_addopen(&actions, fd, "/dev/null", O_RDWR, 0);
    posix_spawnattr_t attributes;
    posix_spawnattr_init(&attributes);
    posix_spawnattr_setflags(&attributes, POSIX_SPAWN_SETPGROUP);
    posix_spawnattr_setpgroup(&attributes, 0);
    std::vector<char*> argv;
    for (std::string& argument : command) argv.push_back(argument.data());
    argv.push_back(nullptr);
    if (::posix_spawnp(&child_, argv[0], &actions, &attributes, argv.data(), environ) != 0)
      child_ = 0;
    posix_spawnattr_destroy(&attributes);
    posix_spawn_file_actions_destroy(&actions);
  }
  ~Group() {
    if (child_ == 0) return;
    ::kill(-child_, SIGKILL);
    if (!ended_) wait(0);
  }
  Group(const Group&) = delete;
  Group& operator=(const Group&) = delete;

  bool started() const { return child_ != 0; }
  /// True once it has ended. @throws Interrupted.
  bool ended_within(steady_clock::duration time, const std::function<void()>& waiting) {
    const auto end = steady_clock::now() + time;
    while (!ended_ && steady_clock::now() < end) {
      throw_if_interrupted();
      if (waiting) waiting();
      wait(WNOHANG);
      if (!ended_) std::this_thread::sleep_for(std::chrono::milliseconds(10));
    }
    return ended_;
  }

 private:
  void wait(int options) {
    pid_t result;
    while ((result = ::waitpid(child_, nullptr, options)) < 0 && errno == EINTR) {
    }
    ended_ = result != 0;
  }
  pid_t child_ = 0;
  bool ended_ = false;
};

/// "file:///..." with everything that is special in an address as %xx.
std::string file_url(const fs::path& file) {
  std::string url = "file://";
  for (const char c : fs::absolute(file).lexically_normal().string())
    if (std::isalnum(static_cast<unsigned char>(c)) || std::strchr("/-_.~", c) != nullptr)
      url += c;
    else
      url += fmt::format("%{:02X}", static_cast<unsigned char>(c));
  return url;
}

bool is_whole_pdf(const fs::path& file) {
  std::ifstream in(file, std::ios::binary);
  std::string begin(5, '\0'), end(32, '\0');
  in.read(begin.data(), 5);
  in.seekg(-32, std::ios::end);
  in.read(end.data(), 32);
  return in && begin == "%PDF-" && end.find("%%EOF") != std::string::npos;
}

}  // namespace

std::optional<std::string> print_pdf(std::string_view page, const fs::path& pdf,
                                     const std::function<void()>& waiting) try {
  std::string pattern = (temporary_files() / "turntable-print-XXXXXX").string();
  if (::mkdtemp(pattern.data()) == nullptr)
    throw RecordError(
        fmt::format("{}: no temporary folder can be made there: {}. Make room, or name another "
                    "place in TMPDIR.",
                    temporary_files().string(), std::strerror(errno)));
  struct Remove {
    fs::path folder;
    ~Remove() {
      std::error_code ignored;
      fs::remove_all(folder, ignored);
    }
  } const profile{pattern};
  const fs::path printed = profile.folder / "report.pdf", html = profile.folder / "report.html";
  write_atomically(html, page);

  std::vector<std::string> options{"--headless",
                                   "--disable-gpu",
                                   "--disable-extensions",
                                   "--disable-crash-reporter",
                                   "--disable-breakpad",
                                   "--disable-background-networking",
                                   "--no-first-run",
                                   "--no-pdf-header-footer",
                                   "--user-data-dir=" + profile.folder.string(),
                                   "--print-to-pdf=" + printed.string()};
  if (::geteuid() == 0) options.push_back("--no-sandbox");  // it refuses root otherwise
  options.push_back(file_url(html));
  std::string tried;
  for (const char* const program : kChromium) {
    std::vector<std::string> command{program};
    command.insert(command.end(), options.begin(), options.end());
    Group chromium(std::move(command));
    if (!chromium.started()) continue;
    if (!chromium.ended_within(kPrintTimeout, waiting))
      return fmt::format("{} was not printed: {} took longer than {} s and was ended. {}",
                         pdf.string(), program, kPrintTimeout.count(), kByHand);
    if (is_whole_pdf(printed)) {
      std::ifstream in(printed, std::ios::binary);
      write_atomically(pdf, std::string(std::istreambuf_iterator<char>(in), {}));
      return {};
    }
    tried += fmt::format("{}{}", tried.empty() ? "" : " and ", program);
  }
  if (!tried.empty())
    return fmt::format("{} was not printed: {} ended without a PDF. {}", pdf.string(), tried,
                       kByHand);
  return fmt::format(
      "{} was not printed: Chromium is not there, which would. Install it (Debian: "
      "chromium-headless-shell). {}",
      pdf.string(), kByHand);
} catch (const RecordError& e) {
  return fmt::format("{} was not printed: {}", pdf.string(), e.what());
}

}  // namespace turntable
