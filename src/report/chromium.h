// Chromium without a window, told what to do over a socket that it inherits (its DevTools protocol).
#pragma once

#include <sys/types.h>

#include <chrono>
#include <filesystem>
#include <functional>
#include <set>
#include <stdexcept>
#include <string>
#include <string_view>

#include "src/core/json_document.h"

namespace turntable {

/// What became of Chromium instead, to be read behind its name: "ended too early".
class ChromiumTrouble : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};
/// It may still come.
class ChromiumLate : public ChromiumTrouble {
 public:
  ChromiumLate() : ChromiumTrouble("took too long and was ended") {}
};

/// How long somebody waits for it, and what he does meanwhile.
struct Patience {
  std::chrono::steady_clock::time_point until;
  std::function<void()> meanwhile;  ///< called now and then, if anything
};

/// One Chromium with one page. The program is started, and not waited for before the page is needed. It and its
/// children end with this object, and by themselves when this process does.
/// Protocol: https://chromedevtools.github.io/devtools-protocol (Target, Page, Inspector, IO, Browser).
class Chromium {
 public:
  /// @param program looked for in PATH. @param folder its own, for profile and temporary files.
  /// @throws ChromiumTrouble: it is there and cannot be started.
  Chromium(const std::string& program, const std::filesystem::path& folder);
  ~Chromium();
  Chromium(const Chromium&) = delete;
  Chromium& operator=(const Chromium&) = delete;

  /// False if there is no such program.
  bool started() const { return child_ != 0; }
  /// Has the page of a file loaded; returns when it has been told. Called again after ChromiumLate, it goes on.
  /// @throws ChromiumTrouble: it ended, or refuses; ChromiumLate; Interrupted.
  void load(const std::filesystem::path& file, const Patience& patience);
  /// Whether `load` has come to its end.
  bool loading() const { return navigation_ != 0; }
  /// What is being loaded as PDF: pages as its style says, with bookmarks for its headings.
  /// @throws like `load`, also if there is no such page.
  std::string pdf(const Patience& patience);

 private:
  /// Asks it to end and waits a second, so that its children are waited for by it and not left to whoever adopts
  /// them; kills what is left.
  void end();
  /// Sends a question and returns its number.
  int send(std::string_view method, Json parameters);
  /// The next message that has come whole.
  Json receive(const Patience& patience);
  /// Events that come first are noted.
  Json answer(int question, const Patience& patience);
  Json ask(std::string_view method, Json parameters, const Patience& patience);
  void note_event(const Json& message);

  pid_t child_ = 0;
  int socket_ = -1, questions_ = 0;
  int target_ = 0, session_question_ = 0, navigation_ = 0;  ///< questions; 0 = not asked yet
  std::string session_;                                     ///< of the page, once it is there
  std::string received_;                                    ///< of the next message
  std::set<std::string> loaded_;                            ///< loaders that are done
};

}  // namespace turntable
