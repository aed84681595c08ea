#include "src/campaign/runner.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <nlohmann/json.hpp>
#include <numeric>
#include <optional>
#include <thread>

#include "src/campaign/archive_worker.h"
#include "src/campaign/inspection.h"
#include "src/campaign/planning.h"
#include "src/campaign/telemetry.h"
#include "src/core/errors.h"
#include "src/core/interrupt.h"
#include "src/record/run_journal.h"
#include "src/record/sha256.h"

namespace turntable {
namespace {

using Targets = std::array<double, kAllAxes.size()>;  ///< mm or deg, by order of kAllAxes

/// While poses wait for a channel it is read so often, if its own interval is longer. s
constexpr double kHoldPoll_s = 10.0;
/// If no axis waited by itself, so that polling does not eat a core.
constexpr Time kPollPause = std::chrono::milliseconds(5);

double wall_s() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

template <class Q>
Q quantity(const Axis<Q>&, double value) {
  return Q{value};
}

class Acquisition {
 public:
  Acquisition(Rig& rig, const RigFile& rig_file, const Plan& plan, const AcquireOptions& options,
              const std::function<void(const Progress&)>& progress)
      : rig_(rig),
        rig_file_(rig_file),
        plan_(plan),
        options_(options),
        progress_(progress),
        schedule_(schedule_of(plan, options)),
        pace_(plan, rig_file, schedule_.all(), options.overheads),
        telemetry_(rig, rig_file.telemetry),
        done_(options.before == nullptr ? 0 : options.before->poses_taken()) {}

  AcquireSummary run(const RunFolder& folder, const Json& provenance) {
    check_devices();
    const PauseAtFirstInterrupt first_press_pauses;
    began_wall_ = wall_s();
    const Time began = rig_.clock->now();
    RunJournal journal = options_.before == nullptr
                             ? RunJournal(folder, start_document(provenance))
                             : RunJournal(folder, start_document(provenance), *options_.before);
    ArchiveWorker worker(journal, folder, plan_, rig_file_, options_);
    std::exception_ptr cause;
    try {
      baseline(journal);  // before the first job: the journal is not shared yet
      home();
      for (const std::size_t index : schedule_.overlap) take(plan_.poses[index], worker, true);
      for (const std::size_t index : schedule_.missing) take(plan_.poses[index], worker, false);
      report("finishing");
      worker.finish();
      baseline(journal);
      tally(worker, began);
      journal.time(summary_.phases());
      journal.stop("success", "");
    } catch (...) {
      cause = std::current_exception();
    }
    if (cause) end_early(cause, journal, worker, began);
    return summary_;
  }

  /// One exposure and one reading, to see that camera and channels answer. Nothing moves.
  DeviceCheck try_out() {
    DeviceCheck found;
    if (!rig_.channels.empty()) {
      found.telemetry = telemetry_.read();
      found.outside = telemetry_.outside();
    }
    if (!rig_.camera->exposes()) return found;
    const Time began = rig_.clock->now();
    const Frame frame = answered("the test trigger", [this] { return rig_.camera->try_out(); });
    check_size(frame.image.size());
    found.frame_s = seconds(rig_.clock->now() - began);
    const auto [darkest, brightest] = std::ranges::minmax(frame.image.pixels);
    found.darkest = darkest;
    found.brightest = brightest;
    return found;
  }

  /// The devices have the last word on limits and images, and have it before anything moves.
  void check_devices() const {
    check_size(rig_.camera->image_size());
    if (!rig_.camera->exposes()) check_exposures();
    const auto check = [this](AxisId id, double target) {
      with_axis(rig_, id, [target](auto& axis) { axis.check(quantity(axis, target)); });
    };
    for (const AxisId id : kAllAxes) check(id, 0.0);
    for (const auto* list : {&schedule_.overlap, &schedule_.missing})
      for (const std::size_t index : *list)
        for (const AxisId id : kAllAxes) check(id, plan_.poses[index].target(id));
  }

 private:
  /// Of a camera that looks images up. One that exposes answers whatever comes.
  void check_exposures() const {
    std::vector<Exposure> exposures;
    for (const auto* list : {&schedule_.overlap, &schedule_.missing})
      for (const std::size_t index : *list)
        for (int i = 0; i < plan_.poses[index].images; ++i)
          exposures.push_back(exposure(plan_.poses[index], i));
    rig_.camera->check(exposures);
  }

  void check_size(ImageSize found) const {
    const ImageSize allowed = rig_file_.camera.image_size;
    if (found != allowed)
      throw DeviceError(
          fmt::format("camera: found an image of {} x {} px, allowed: {} x {} px as the rig file "
                      "says. Correct the one or the other.",
                      found.width, found.height, allowed.width, allowed.height));
  }

  /// @param i counts the images of the pose from 0.
  Exposure exposure(const PlannedPose& pose, int i) const {
    return {plan_.scenario_of(pose).name,
            pose.repeat,
            static_cast<std::size_t>(pose.point),
            pose.index,
            i + 1,
            pose.stage_mm,
            pose.yaw_deg,
            pose.roll_deg,
            pose.pitch_deg};
  }

  Json start_document(const Json& provenance) const {
    return {{"plan_name", plan_.name},
            {"num_poses", plan_.poses.size()},
            {"plan_sha256", plan_sha256(plan_)},
            {"rig_sha256", plan_.rig.sha256},
            {"archive", archive_mode_name(options_.archive)},
            {"simulated", rig_.simulated},
            {"devices", rig_.identities},
            {"camera", rig_.camera->identity()},
            {"provenance", provenance}};
  }

  Targets positions() const {
    Targets out{};
    for (std::size_t i = 0; i < kAllAxes.size(); ++i)
      out[i] = with_axis(rig_, kAllAxes[i], [](auto& axis) { return axis.position().value; });
    return out;
  }

  /// Every device at the start and at the end of a session.
  void baseline(RunJournal& journal) {
    journal.baseline(positions());
    if (!rig_.channels.empty()) journal.telemetry(telemetry_.read(), rig_file_.telemetry);
  }

  void report(std::string_view phase, std::string_view reason = {}) {
    if (!progress_) return;
    const double now = wall_s();
    const double left = pace_.left_s();
    // Virtual time passes faster than the wall's; before the first pose nobody knows how much.
    const double per_rig_second = posing_rig_s_ > 0.0 ? posing_wall_s_ / posing_rig_s_ : 1.0;
    progress_(
        {done_, plan_.poses.size(), phase, reason, now - began_wall_, per_rig_second * left, left});
  }

  void tally(const ArchiveWorker& worker, Time began) {
    const auto tally = worker.tally();
    summary_.poses = tally.poses;
    summary_.failed = tally.failed;
    summary_.doubtful = tally.doubtful;
    summary_.archive_s = tally.busy_s;
    summary_.rig_s = seconds(rig_.clock->now() - began);
    summary_.wall_s = wall_s() - began_wall_;
    summary_.overheads = pace_.learned();
  }

  void home() {
    const Time began = rig_.clock->now();
    for (const AxisId id : kAllAxes) {
      throw_if_interrupted(kEndedAfterPose);
      with_axis(rig_, id, [this](auto& axis) {
        if (axis.homed()) return;
        report("homing");
        axis.home();
      });
    }
    summary_.homing_s = seconds(rig_.clock->now() - began);
  }

  void take(const PlannedPose& pose, ArchiveWorker& worker, bool overlap) {
    ArchiveWorker::Job job;
    // Whatever made the run wait, the channels have the last word before the rig moves.
    do {
      hold_while_paused(worker);
      throw_if_interrupted(kEndedAfterPose);
      throw_if_stopping_now();
      mount(pose.payload);
    } while (hold_while_outside(worker, job) || pause_requested());
    const Time began = rig_.clock->now();
    const double began_wall = wall_s();
    const AcquireSummary before = summary_;
    report("moving");
    Targets targets{};
    for (std::size_t i = 0; i < kAllAxes.size(); ++i) targets[i] = pose.target(kAllAxes[i]);
    job.taken.planned = pose;
    job.overlap = overlap;
    const Time asleep = rig_.clock->asleep();
    move(targets);
    if (const Time slept = rig_.clock->asleep() - asleep; slept > std::chrono::milliseconds{100})
      worker.note([slept](RunJournal& journal) {
        journal.interruption(
            "sleep", fmt::format("the computer slept for {:.1f} s during a move, which ended as it "
                                 "should. Keep it awake: systemd-inhibit turntable run ...",
                                 seconds(slept)));
      });
    for (std::size_t i = 0; i < kAllAxes.size(); ++i)
      job.taken.axis(kAllAxes[i]) = held_[i]->readback;
    if (pose.dwell_s > 0.0) {
      report("settling");
      dwell(pose.dwell_s);
      summary_.settle_s += pose.dwell_s;
      throw_if_stopping_now();
    }
    job.taken.rig_time_s = seconds(rig_.clock->now());
    report("exposing");
    const Time settled = rig_.clock->now();
    for (int i = 0; i < pose.images; ++i) expose(pose, i, job);
    const double images_s = seconds(rig_.clock->now() - settled);
    job.taken.phases = {summary_.motion_s - before.motion_s, summary_.settle_s - before.settle_s,
                        summary_.trigger_s - before.trigger_s,
                        summary_.transfer_s - before.transfer_s};

    const double waiting = wall_s();
    worker.push(std::move(job));
    summary_.waited_s += wall_s() - waiting;
    if (!overlap) ++done_;
    const double elapsed = seconds(rig_.clock->now() - began) + mounting_motion_s_;
    mounting_motion_s_ = 0.0;
    pace_.taken(elapsed, images_s);
    posing_rig_s_ += elapsed;
    posing_wall_s_ += wall_s() - began_wall;
  }

  void keep_alive() const {
    if (rig_.keep_alive) rig_.keep_alive();
  }

  void dwell(double dwell_s) const {
    const Time end = rig_.clock->now() + from_seconds(dwell_s);
    while (rig_.clock->now() < end) {
      rig_.clock->sleep_until(std::min(end, rig_.clock->now() + std::chrono::seconds{1}));
      keep_alive();
    }
  }

  /// Takes an image, and takes it again as often as is allowed while it is bad.
  void expose(const PlannedPose& pose, int i, ArchiveWorker::Job& job) {
    int retakes = 0;
    for (;; ++retakes) {
      Frame frame = trigger(pose, i);
      const double began = wall_s();
      Inspection seen = inspect(frame.image, pose, rig_file_);
      summary_.inspect_s += wall_s() - began;
      const bool good = seen.complaint.empty();
      // The last one counts, unless it shows no target and one before it did.
      if (retakes == 0) {
        job.frames.push_back(std::move(frame));
        job.inspections.push_back(std::move(seen));
      } else if (seen.target_seen || !job.inspections.back().target_seen) {
        job.frames.back() = std::move(frame);
        job.inspections.back() = std::move(seen);
      }
      if (good || retakes >= rig_file_.inspection.retakes || !rig_.camera->exposes()) break;
      ++summary_.retakes;
      throw_if_stopping_now();
    }
    job.taken.images.emplace_back().retakes = retakes;
  }

  /// Reads the channels if they are due, and waits as long as one is outside its band.
  /// @return whether it had to wait.
  bool hold_while_outside(ArchiveWorker& worker, ArchiveWorker::Job& job) {
    if (const auto reading = telemetry_.read_if_due()) job.telemetry.push_back(*reading);
    std::string why = telemetry_.outside();
    if (why.empty()) return false;
    worker.note([&](RunJournal& journal) {
      for (const TelemetryReading& reading : job.telemetry)
        journal.telemetry(reading, rig_file_.telemetry);
      journal.interruption("suspend", why);
    });
    job.telemetry.clear();
    const Held held(*this);
    const Time began = rig_.clock->now();
    double for_s = 0.0;
    std::optional<Time> back;  // since when
    while (!back || seconds(rig_.clock->now() - *back) < for_s) {
      for_s = std::max(for_s, telemetry_.for_s());
      if (const double waited = seconds(rig_.clock->now() - began);
          waited >= telemetry_.give_up_s())
        throw DeviceError(fmt::format(
            "{}: not back after {:.0f} s. See to it, then \"turntable resume\".", why, waited));
      report("suspended", why);
      throw_if_interrupted(kEndedAfterPose);
      // Virtual time has no end, and every reading is journaled.
      std::this_thread::sleep_for(std::chrono::milliseconds(20));
      rig_.clock->sleep_for(from_seconds(std::min(rig_file_.telemetry.every_s, kHoldPoll_s)));
      throw_if_stopping_now();
      keep_alive();
      const TelemetryReading reading = telemetry_.read();
      worker.note([&](RunJournal& journal) { journal.telemetry(reading, rig_file_.telemetry); });
      const std::string still = telemetry_.not_yet_back();
      if (!still.empty()) {
        why = still;
        back.reset();
      } else if (!back) {
        back = rig_.clock->now();
      }
    }
    const double waited = seconds(rig_.clock->now() - began);
    worker.note([&](RunJournal& journal) {
      journal.interruption("resume", fmt::format("all channels back after {:.0f} s", waited));
    });
    return true;
  }

  /// The axes stand; devices and references stay as they are.
  void hold_while_paused(ArchiveWorker& worker) {
    if (!pause_requested() || interrupt_level() > 0) return;
    worker.note([](RunJournal& journal) { journal.interruption("pause", "asked for"); });
    const Held held(*this);
    while (pause_requested() && interrupt_level() == 0) {
      report("paused");
      std::this_thread::sleep_for(std::chrono::milliseconds(20));
      keep_alive();
    }
    const bool ends = pause_requested();
    worker.note([&](RunJournal& journal) {
      journal.interruption(ends ? "end" : "resume", ends ? "interrupted" : "asked for");
    });
  }

  void mount(Payload payload) {
    if (mounted_ == payload) return;
    report("mounting");
    const Time left = rig_.clock->now();
    move({});  // all axes at zero: there a person can reach the table, and the payload lies level
    mounted_.reset();
    const Time began = rig_.clock->now();
    mounting_motion_s_ += seconds(began - left);
    if (rig_.mount) rig_.mount(payload);
    summary_.mount_s += seconds(rig_.clock->now() - began);
    mounted_ = payload;
  }

  /// Moves all axes at once. An axis that was asked for the same place before, and reached it,
  /// stays.
  void move(const Targets& targets) {
    const Time began = rig_.clock->now();
    std::array<bool, kAllAxes.size()> moving{};
    double settle = 0.0;
    for (std::size_t i = 0; i < kAllAxes.size(); ++i) {
      if (held_[i] && held_[i]->target == targets[i] && !held_[i]->readback.missed) continue;
      held_[i].reset();
      moving[i] = true;
      with_axis(rig_, kAllAxes[i], [&](auto& axis) { axis.start(quantity(axis, targets[i])); });
      settle = std::max(settle, rig_file_.axis(kAllAxes[i]).settle_s);
    }
    std::array<bool, kAllAxes.size()> travelling = moving;
    while (std::ranges::find(travelling, true) != travelling.end()) {
      const Time before = rig_.clock->now();
      for (std::size_t i = 0; i < kAllAxes.size(); ++i) {
        if (!travelling[i]) continue;
        travelling[i] = !with_axis(rig_, kAllAxes[i], [](auto& axis) { return axis.advance(); });
      }
      throw_if_stopping_now();
      if (rig_.clock->now() - before < kPollPause) rig_.clock->sleep_for(kPollPause);
    }
    for (std::size_t i = 0; i < kAllAxes.size(); ++i) {
      with_axis(rig_, kAllAxes[i], [&](auto& axis) {
        if (moving[i]) {
          const auto arrival = axis.arrival();
          held_[i] = {targets[i],
                      {arrival.position.value, arrival.missed, arrival.retries, arrival.overshot}};
          return;
        }
        // It should stand where it stood; only the controller knows.
        AxisReadback& stayed = held_[i]->readback;
        stayed.position = axis.position().value;
        stayed.retries = 0;
        stayed.missed =
            std::abs(stayed.position - rig_file_.axis(kAllAxes[i]).on_grid(targets[i])) >
            rig_file_.axis(kAllAxes[i]).tolerance;
      });
    }
    const double elapsed = seconds(rig_.clock->now() - began);
    settle = std::min(settle, elapsed);
    summary_.settle_s += settle;
    summary_.motion_s += elapsed - settle;
  }

  Frame trigger(const PlannedPose& pose, int i) {
    const Time began = rig_.clock->now();
    Frame frame = answered(fmt::format("pose {}", pose.index), [&] {
      rig_.camera->announce(exposure(pose, i));
      return rig_.camera->trigger();
    });
    check_size(frame.image.size());
    const Time now = rig_.clock->now();
    const Time exposed = std::clamp(frame.timestamp, began, now);
    summary_.trigger_s += seconds(exposed - began);
    summary_.transfer_s += seconds(now - exposed);
    return frame;
  }

  /// Repeats a trigger whose frame does not come, as often as the rig file allows.
  template <class F>
  Frame answered(const std::string& what, F&& fire) {
    for (int attempt = 0;; ++attempt) {
      try {
        return fire();
      } catch (const TimeoutError& e) {
        if (attempt >= rig_file_.camera.retries) {
          std::string why = e.what();
          if (why.ends_with('.')) why.pop_back();
          throw TimeoutError(
              fmt::format("camera: no frame at {} after {} triggers: {}. Check its cable, its "
                          "light and the trigger line.",
                          what, attempt + 1, why));
        }
        ++summary_.trigger_retries;
      }
    }
  }

  /// All of them, whatever happens to one. @return what went wrong, for the journal.
  std::string stop_axes() {
    std::string trouble;
    const auto tried = [&](std::string_view what, const auto& stop) {
      try {
        stop();
      } catch (const std::exception& e) {
        trouble += fmt::format("; stopping {} failed: {}", what, e.what());
      }
    };
    if (rig_.stop_all) {
      tried("the axes", rig_.stop_all);
      return trouble;
    }
    for (const AxisId id : kAllAxes)
      tried(axis_name(id), [&] { with_axis(rig_, id, [](auto& axis) { axis.stop(); }); });
    return trouble;
  }

  /// Stops the axes first, then saves what was taken, then says why. @throws the cause, always.
  [[noreturn]] void end_early(const std::exception_ptr& cause, RunJournal& journal,
                              ArchiveWorker& worker, Time began) {
    const InterruptShield shield;
    const std::string not_stopped = stop_axes();
    std::string trouble = not_stopped;
    try {
      worker.finish();
    } catch (const std::exception& e) {
      trouble += fmt::format("; archiving failed: {}", e.what());
    }
    std::string status = "fail";
    std::string reason;
    try {
      std::rethrow_exception(cause);
    } catch (const Interrupted& e) {
      status = "abort";
      reason = e.what();
    } catch (const std::exception& e) {
      reason = e.what();
    }
    try {
      baseline(journal);
    } catch (const std::exception&) {  // a dead line, perhaps the very cause: positions are a
                                       // courtesy here
    }
    try {
      tally(worker, began);
      journal.time(summary_.phases());
    } catch (const std::exception&) {
    }
    try {
      journal.stop(status, reason + trouble);
    } catch (const std::exception&) {  // a full disk, perhaps: the cause says so
    }
    if (!not_stopped.empty())
      throw NotStopped(fmt::format("{}{}. The axes may still be moving: USE THE EMERGENCY STOP.",
                                   reason, not_stopped));
    std::rethrow_exception(cause);
  }

  struct Standing {
    double target;
    AxisReadback readback;
  };
  /// Counts how long the run was held, however the wait ends.
  class Held {
   public:
    explicit Held(Acquisition& run) : run_(run), began_(run.rig_.clock->now()) {}
    ~Held() { run_.summary_.held_s += seconds(run_.rig_.clock->now() - began_); }
    Held(const Held&) = delete;
    Held& operator=(const Held&) = delete;

   private:
    Acquisition& run_;
    Time began_;
  };

  Rig& rig_;
  const RigFile& rig_file_;
  const Plan& plan_;
  const AcquireOptions& options_;
  const std::function<void(const Progress&)>& progress_;

  AcquireSummary summary_;
  std::optional<Payload> mounted_;
  std::array<std::optional<Standing>, kAllAxes.size()> held_;
  Schedule schedule_;
  Pace pace_;
  TelemetryWatch telemetry_;
  std::size_t done_ = 0;
  double posing_rig_s_ = 0.0, posing_wall_s_ = 0.0;  ///< that poses have taken so far, waits apart
  double mounting_motion_s_ = 0.0;  ///< rig time of the way to zero before the pose that comes
  double began_wall_ = 0.0;
};

}  // namespace

AcquireSummary acquire(Rig& rig, const RigFile& rig_file, const Plan& plan, const RunFolder& folder,
                       const Json& provenance, const AcquireOptions& options,
                       const std::function<void(const Progress&)>& progress) {
  return Acquisition(rig, rig_file, plan, options, progress).run(folder, provenance);
}

Schedule schedule_of(const Plan& plan, const AcquireOptions& options) {
  Schedule schedule;
  for (const PlannedPose& pose : plan.poses)
    if (options.before == nullptr || options.before->line_of_pose.at(pose.index) == 0)
      schedule.missing.push_back(pose.index);
  if (options.before == nullptr || schedule.missing.empty()) return schedule;
  const PlannedPose& first = plan.poses[schedule.missing.front()];
  for (std::size_t i = first.index; i-- > 0 && schedule.overlap.size() < options.overlap;) {
    if (plan.poses[i].payload != first.payload) break;
    schedule.overlap.insert(schedule.overlap.begin(), i);  // all before the first missing are taken
  }
  return schedule;
}

std::vector<std::size_t> Schedule::all() const {
  std::vector<std::size_t> places = overlap;
  places.insert(places.end(), missing.begin(), missing.end());
  return places;
}

std::map<std::string, double> AcquireSummary::phases() const {
  return {{"homing_s", homing_s},   {"mount_s", mount_s},     {"motion_s", motion_s},
          {"settle_s", settle_s},   {"trigger_s", trigger_s}, {"transfer_s", transfer_s},
          {"held_s", held_s},       {"rig_s", rig_s},         {"inspect_s", inspect_s},
          {"archive_s", archive_s}, {"waited_s", waited_s},   {"wall_s", wall_s}};
}

DeviceCheck check_devices(Rig& rig, const RigFile& rig_file, const Plan& plan,
                          const AcquireOptions& options) {
  const std::function<void(const Progress&)> progress;
  Acquisition acquisition(rig, rig_file, plan, options, progress);
  acquisition.check_devices();
  return acquisition.try_out();
}

}  // namespace turntable
