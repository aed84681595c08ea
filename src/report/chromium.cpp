#include "src/report/chromium.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <openssl/evp.h>
#include <poll.h>
#include <signal.h>
#include <spawn.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cctype>
#include <cerrno>
#include <cstring>
#include <nlohmann/json.hpp>
#include <thread>
#include <utility>
#include <vector>

#include "src/core/interrupt.h"

extern char** environ;

namespace turntable {
namespace {

namespace fs = std::filesystem;
using std::chrono::milliseconds;
using std::chrono::steady_clock;

/// Chromium reads questions here and writes answers there, each ended by a zero byte.
constexpr int kQuestions = 3, kAnswers = 4;

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

std::string decoded(const std::string& base64) {
  std::string bytes(base64.size() / 4 * 3, '\0');
  if (EVP_DecodeBlock(reinterpret_cast<unsigned char*>(bytes.data()),
                      reinterpret_cast<const unsigned char*>(base64.data()),
                      static_cast<int>(base64.size())) < 0)
    throw ChromiumTrouble("sent a PDF that cannot be read");
  // It counts what the padding stands for.
  const std::size_t padding = base64.ends_with("==") ? 2 : base64.ends_with('=') ? 1 : 0;
  bytes.resize(bytes.size() - std::min(padding, bytes.size()));
  return bytes;
}

}  // namespace

Chromium::Chromium(const std::string& program, const fs::path& folder) {
  std::vector<std::string> command{program,
                                   "--headless",
                                   "--disable-gpu",
                                   "--disable-extensions",
                                   "--disable-crash-reporter",
                                   "--disable-breakpad",
                                   "--disable-background-networking",
                                   "--no-first-run",
                                   "--no-startup-window",
                                   "--remote-debugging-pipe",
                                   "--user-data-dir=" + (folder / "profile").string()};
  if (::geteuid() == 0) command.push_back("--no-sandbox");  // it refuses root otherwise
  std::vector<std::string> environment{"TMPDIR=" + folder.string()};
  for (char** variable = environ; *variable != nullptr; ++variable)
    if (!std::string_view(*variable).starts_with("TMPDIR=")) environment.push_back(*variable);
  const auto pointers = [](std::vector<std::string>& texts) {
    std::vector<char*> out;
    for (std::string& text : texts) out.push_back(text.data());
    out.push_back(nullptr);
    return out;
  };

  int ends[2];
  if (::socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, ends) != 0)
    throw ChromiumTrouble(fmt::format("cannot be spoken to: {}", std::strerror(errno)));
  socket_ = ends[0];
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  for (const int fd : {kQuestions, kAnswers})
    posix_spawn_file_actions_adddup2(&actions, ends[1], fd);
  for (const int fd : {STDIN_FILENO, STDOUT_FILENO, STDERR_FILENO})
    posix_spawn_file_actions_addopen(&actions, fd, "/dev/null", O_RDWR, 0);
  posix_spawnattr_t attributes;
  posix_spawnattr_init(&attributes);
  posix_spawnattr_setflags(&attributes, POSIX_SPAWN_SETPGROUP);
  posix_spawnattr_setpgroup(&attributes, 0);
  const int failed = ::posix_spawnp(&child_, command.front().c_str(), &actions, &attributes,
                                    pointers(command).data(), pointers(environment).data());
  posix_spawnattr_destroy(&attributes);
  posix_spawn_file_actions_destroy(&actions);
  ::close(ends[1]);
  if (failed != 0) {
    child_ = 0;
    ::close(std::exchange(socket_, -1));
    if (failed != ENOENT)
      throw ChromiumTrouble(fmt::format("cannot be started: {}", std::strerror(failed)));
    return;
  }
  try {
    target_ = send("Target.createTarget", {{"url", "about:blank"}});
  } catch (const ChromiumTrouble&) {  // is met again by whoever waits for the page
  }
}

Chromium::~Chromium() {
  if (child_ != 0) end();
  if (socket_ >= 0) ::close(socket_);
}

void Chromium::end() {
  bool ended = false;
  const auto reap = [&](int options) {
    pid_t result;
    while ((result = ::waitpid(child_, nullptr, options)) < 0 && errno == EINTR) {
    }
    return result != 0;
  };
  try {
    session_.clear();  // the browser's, not the page's
    send("Browser.close", Json::object());
    ::shutdown(socket_, SHUT_WR);
    for (int i = 0; !ended && i < 100; ++i) {
      ended = reap(WNOHANG);
      if (!ended) std::this_thread::sleep_for(milliseconds(10));
    }
  } catch (const ChromiumTrouble&) {  // gone, or on its way
  }
  ::kill(-child_, SIGKILL);
  if (!ended) reap(0);
}

int Chromium::send(std::string_view method, Json parameters) {
  Json question{{"id", ++questions_}, {"method", method}, {"params", std::move(parameters)}};
  if (!session_.empty()) question["sessionId"] = session_;
  const std::string text = question.dump(-1, ' ', false, Json::error_handler_t::replace) + '\0';
  for (std::size_t sent = 0; sent < text.size();) {
    const ssize_t n = ::send(socket_, text.data() + sent, text.size() - sent, MSG_NOSIGNAL);
    if (n < 0 && errno == EINTR) continue;
    if (n < 0) throw ChromiumTrouble("ended too early");
    sent += static_cast<std::size_t>(n);
  }
  return questions_;
}

Json Chromium::receive(const Patience& patience) {
  throw_if_interrupted();
  std::size_t looked = 0, end;
  while ((end = received_.find('\0', looked)) == std::string::npos) {
    looked = received_.size();
    if (patience.meanwhile) patience.meanwhile();
    if (steady_clock::now() > patience.until) throw ChromiumLate();
    pollfd ready{socket_, POLLIN, 0};
    const bool has_come = ::poll(&ready, 1, 20) > 0;
    throw_if_interrupted();
    if (!has_come) continue;
    received_.resize(looked + (1 << 18));
    const ssize_t n = ::recv(socket_, received_.data() + looked, received_.size() - looked, 0);
    received_.resize(looked + static_cast<std::size_t>(std::max<ssize_t>(n, 0)));
    if (n == 0 || (n < 0 && errno != EINTR)) throw ChromiumTrouble("ended too early");
  }
  Json message = Json::parse(received_.begin(),
                             received_.begin() + static_cast<std::ptrdiff_t>(end), nullptr, false);
  received_.erase(0, end + 1);
  if (!message.is_object()) throw ChromiumTrouble("answered what is no message");
  return message;
}

void Chromium::note_event(const Json& message) {
  const std::string event = message.value("method", "");
  if (event == "Inspector.targetCrashed" || event == "Target.detachedFromTarget")
    throw ChromiumTrouble("crashed with the page");
  if (event != "Page.lifecycleEvent") return;
  const Json& told = message.at("params");
  if (told.value("name", "") == "load") loaded_.insert(told.value("loaderId", ""));
}

Json Chromium::answer(int question, const Patience& patience) {
  for (;;) {
    const Json message = receive(patience);
    note_event(message);
    if (message.value("id", -1) != question) continue;
    if (const auto error = message.find("error"); error != message.end())
      throw ChromiumTrouble(fmt::format("refused: {}", error->value("message", error->dump())));
    return message.at("result");
  }
}

Json Chromium::ask(std::string_view method, Json parameters, const Patience& patience) {
  return answer(send(method, std::move(parameters)), patience);
}

void Chromium::load(const fs::path& file, const Patience& patience) try {
  if (session_question_ == 0)
    session_question_ =
        send("Target.attachToTarget",
             {{"targetId", answer(target_, patience).at("targetId")}, {"flatten", true}});
  session_ = answer(session_question_, patience).at("sessionId");
  for (const char* const domain : {"Page.enable", "Inspector.enable"}) send(domain, Json::object());
  send("Page.setLifecycleEventsEnabled", {{"enabled", true}});
  navigation_ = send("Page.navigate", {{"url", file_url(file)}});
} catch (const Json::exception& e) {
  throw ChromiumTrouble(fmt::format("answered something else: {}", e.what()));
}

std::string Chromium::pdf(const Patience& patience) try {
  const Json page = answer(navigation_, patience);
  if (const auto error = page.find("errorText"); error != page.end())
    throw ChromiumTrouble(fmt::format("could not load the page: {}", error->get<std::string>()));
  const std::string loader = page.at("loaderId");
  while (!loaded_.contains(loader)) note_event(receive(patience));
  const Json printed = ask("Page.printToPDF",
                           {{"printBackground", true},
                            {"preferCSSPageSize", true},
                            {"generateTaggedPDF", true},
                            {"generateDocumentOutline", true},
                            {"transferMode", "ReturnAsStream"}},
                           patience);
  std::string bytes;
  for (bool whole = false; !whole;) {
    const Json part =
        ask("IO.read", {{"handle", printed.at("stream")}, {"size", 1 << 18}}, patience);
    const std::string data = part.at("data");
    bytes += part.value("base64Encoded", false) ? decoded(data) : data;
    whole = part.at("eof");
  }
  return bytes;
} catch (const Json::exception& e) {
  throw ChromiumTrouble(fmt::format("answered something else: {}", e.what()));
}

}  // namespace turntable
