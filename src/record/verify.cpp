#include "src/record/verify.h"

#include <fmt/format.h>

#include <algorithm>
#include <functional>
#include <map>
#include <nlohmann/json.hpp>
#include <set>

#include "src/core/errors.h"
#include "src/core/json_document.h"
#include "src/core/parallel.h"
#include "src/record/atomic_file.h"
#include "src/record/journal.h"
#include "src/record/sha256.h"

namespace turntable {
namespace {

/// Event model: every document after its start, every event after its descriptor, numbers without a
/// gap.
class Documents {
 public:
  explicit Documents(std::string journal) : journal_(std::move(journal)) {
    for (const char* name : {"start", "descriptor", "event", "stop"})
      checks_.emplace(name, std::string("event-") + name);
  }

  /// @return what is wrong; empty if nothing is.
  std::string check(const JournalEntry& entry) {
    const auto schema = checks_.find(entry.name);
    if (schema == checks_.end()) return "is none of start, descriptor, event and stop";
    try {
      schema->second(entry.doc, fmt::format("{} line {}", journal_, entry.seq));
    } catch (const ConfigError& e) {
      return e.what();
    }
    if (entry.name == "start") {
      run_ = entry.doc.at("uid");
      streams_.clear();
      return {};
    }
    if (entry.name == "event") {
      const auto stream = streams_.find(entry.doc.at("descriptor").get<std::string>());
      if (stream == streams_.end()) return "names a descriptor that is not there";
      if (entry.doc.at("seq_num") != ++stream->second.events)
        return "leaves out an event of its stream";
      return {};
    }
    if (entry.doc.at("run_start") != run_) return "belongs to another start document";
    if (entry.name == "descriptor") streams_[entry.doc.at("uid")] = {entry.doc.at("name"), 0};
    if (entry.name == "stop" && entry.doc.contains("num_events"))
      for (const auto& [descriptor, stream] : streams_)
        if (entry.doc.at("num_events").value(stream.name, 0) != stream.events)
          return fmt::format("counts {} events of stream {}, and {} are there",
                             entry.doc.at("num_events").value(stream.name, 0), stream.name,
                             stream.events);
    return {};
  }

 private:
  std::string journal_;
  std::map<std::string, SchemaCheck> checks_;
  std::string run_;
  struct Stream {
    std::string name;
    int events = 0;
  };
  std::map<std::string, Stream> streams_;  ///< by descriptor
};

/// A piece of a line around its first difference from another, short enough for a message.
std::string piece(std::string_view line, std::size_t at) {
  constexpr std::size_t kBefore = 20, kLength = 60;
  const std::size_t from = at > kBefore ? at - kBefore : 0;
  return fmt::format("\"{}{}{}\"", from > 0 ? "..." : "", line.substr(from, kLength),
                     line.size() > from + kLength ? "..." : "");
}

/// @return "line N is ..., made again it is ..."; empty if they are the same.
std::string difference(std::string_view stored, std::string_view again) {
  const auto [a, b] = std::ranges::mismatch(stored, again);
  if (a == stored.end() && b == again.end()) return {};
  const auto at = static_cast<std::size_t>(a - stored.begin());
  const std::size_t before = at == 0 ? std::string_view::npos : stored.rfind('\n', at - 1);
  const std::size_t begin = before == std::string_view::npos ? 0 : before + 1;
  const auto line = [&](std::string_view text) {
    if (begin >= text.size()) return std::string("not there");
    return piece(text.substr(begin, text.find('\n', begin) - begin), at - begin);
  };
  return fmt::format("line {} is {}; made again, it is {}", 1 + std::count(stored.begin(), a, '\n'),
                     line(stored), line(again));
}

/// The images of the poses that count, some lines of the journal at a time on all cores.
class ImageChecks {
 public:
  ImageChecks(const RunFolder& folder, const RunState& state, RunFindings& findings,
              const VerifyProgress& progress)
      : folder_(folder),
        state_(state),
        findings_(findings),
        progress_(progress),
        total_(state.poses_taken()) {}

  void look_at(const JournalEntry& entry) {
    if (entry.name != "event" || !entry.doc.at("data").contains("pose_index")) return;
    const Json& data = entry.doc.at("data");
    const std::size_t pose = data.at("pose_index");
    if (pose >= state_.line_of_pose.size() || state_.line_of_pose[pose] != entry.seq) return;
    for (std::size_t i = 0; i < data.at("image_files").size(); ++i)
      if (const std::string file = data.at("image_files").at(i); !file.empty())
        waiting_.push_back({pose, file, data.at("image_sha256").at(i), {}});
    ++done_;
    constexpr std::size_t kTogether = 256;
    if (waiting_.size() >= kTogether || done_ % kTogether == 0) check();
  }

  void finish() {
    check();
    std::ranges::sort(findings_.lost_poses);
    const auto repeated = std::ranges::unique(findings_.lost_poses);
    findings_.lost_poses.erase(repeated.begin(), repeated.end());
  }

 private:
  struct Check {
    std::size_t pose;
    std::string file, sha256, damage;
  };

  void check() {
    parallel_for(waiting_.size(), [&](std::size_t i) {
      const auto file = folder_.root() / waiting_[i].file;
      try {
        if (sha256_hex(read_text(file)) != waiting_[i].sha256)
          waiting_[i].damage =
              fmt::format("{}: was altered: its SHA-256 is not the journal's", file.string());
      } catch (const ConfigError& e) {
        waiting_[i].damage = e.what();
      }
    });
    findings_.images += waiting_.size();
    for (const Check& done : waiting_) {
      if (done.damage.empty()) continue;
      findings_.lost_poses.push_back(done.pose);
      findings_.damage.push_back(fmt::format(
          "{} (pose {}). Restore it from a copy, or \"turntable resume\" takes the pose "
          "again.",
          done.damage, done.pose));
    }
    waiting_.clear();
    if (progress_) progress_(done_, total_);
  }

  const RunFolder& folder_;
  const RunState& state_;
  RunFindings& findings_;
  const VerifyProgress& progress_;
  std::size_t done_ = 0, total_;
  std::vector<Check> waiting_;
};

}  // namespace

void compare_outputs(const std::filesystem::path& stored, const std::filesystem::path& again,
                     const std::string& advice, RunFindings& findings) {
  namespace fs = std::filesystem;
  const auto damage = [&](const std::string& what) {
    findings.damage.push_back(fmt::format("{}: {}. {}", stored.string(), what, advice));
  };
  std::error_code error;
  if (fs::is_directory(stored, error) || fs::is_directory(again, error)) {
    std::set<fs::path> names;
    for (const fs::path& folder : {stored, again})
      for (const auto& file : fs::directory_iterator(folder, error))
        names.insert(file.path().filename());
    for (const fs::path& name : names) {
      if (fs::exists(again / name, error))
        compare_outputs(stored / name, again / name, advice, findings);
      else if (is_temporary(name))
        findings.remarks.push_back(fmt::format(
            "{}: was being written when somebody killed the program", (stored / name).string()));
      else
        findings.damage.push_back(
            fmt::format("{}: is nothing that this run makes. Put it somewhere else.",
                        (stored / name).string()));
    }
    return;
  }
  ++findings.outputs;
  if (!fs::exists(stored, error)) return damage("is missing");
  try {
    const std::string what = difference(read_text(stored), read_text(again));
    if (!what.empty()) damage(what);
  } catch (const ConfigError& e) {
    findings.damage.push_back(e.what());
  }
}

void verify_images(const RunFolder& folder, const RunState& state, RunFindings& findings,
                   const VerifyProgress& progress) {
  ImageChecks images(folder, state, findings, progress);
  if (!state.sessions.empty())
    read_journal(folder.journal(), [&](const JournalEntry& entry) { images.look_at(entry); });
  images.finish();
}

RunFindings verify_run(const RunFolder& folder, const VerifyProgress& progress) {
  RunFindings findings;
  try {
    const RunState state = read_run_state(folder);
    Documents documents(folder.journal().string());
    ImageChecks images(folder, state, findings, progress);
    std::vector<std::size_t> named;  // hashes of the image files' names
    const auto hash = [](const std::string& file) { return std::hash<std::string>{}(file); };
    std::string plan_in_journal;
    read_journal(folder.journal(), [&](const JournalEntry& entry) {
      ++findings.lines;
      if (const std::string wrong = documents.check(entry); !wrong.empty())
        findings.damage.push_back(fmt::format("{}: line {} ({}) {}", folder.journal().string(),
                                              entry.seq, entry.name, wrong));
      if (entry.name == "start" && plan_in_journal.empty())
        plan_in_journal = entry.doc.value("plan_sha256", "");
      if (entry.name == "event" && entry.doc.at("data").contains("image_files"))
        for (const auto& file : entry.doc.at("data").at("image_files"))
          if (!file.empty()) named.push_back(hash(file.get<std::string>()));
      images.look_at(entry);
    });
    if (!plan_in_journal.empty() && plan_in_journal != sha256_hex(read_text(folder.plan())))
      findings.damage.push_back(fmt::format(
          "{}: is not the plan that the run was started with: its SHA-256 is not the journal's. "
          "Restore it from a copy.",
          folder.plan().string()));
    if (state.torn)
      findings.remarks.push_back(fmt::format("{}: {}; it was cut off and never counted",
                                             folder.journal().string(), *state.torn));
    for (std::size_t s = 0; s < state.sessions.size(); ++s)
      if (state.sessions[s].exit_status.empty())
        findings.remarks.push_back(fmt::format(
            "session {} has no stop document: it was killed, or is still running", s + 1));
    for (const ClockStep& step : state.clock_steps)
      findings.remarks.push_back(
          fmt::format("{} {}", folder.journal().string(), clock_step_text(step)));
    images.finish();
    std::ranges::sort(named);
    std::error_code error;
    std::size_t orphans = 0;
    for (const auto& file : std::filesystem::directory_iterator(folder.images(), error))
      orphans +=
          !std::ranges::binary_search(named, hash("images/" + file.path().filename().string()));
    if (orphans > 0)
      findings.remarks.push_back(fmt::format(
          "{}: {} file{} that no line of the journal names; a run that is killed leaves the last",
          folder.images().string(), orphans, orphans == 1 ? "" : "s"));
  } catch (const ConfigError& e) {
    findings.damage.push_back(e.what());
  }
  return findings;
}

}  // namespace turntable
