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
#include "src/campaign/planning.h"
#include "src/core/errors.h"
#include "src/core/interrupt.h"
#include "src/record/run_journal.h"
#include "src/record/sha256.h"

namespace turntable {
namespace {

using Targets = std::array<double, kAllAxes.size()>;  ///< mm or deg, by order of kAllAxes

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
        done_(options.before == nullptr ? 0 : options.before->poses_taken()) {
    for (const PhaseTimes& time : pose_times(plan, rig_file)) weights_.push_back(time.total_s());
    for (const auto* list : {&schedule_.overlap, &schedule_.missing})
      for (const std::size_t index : *list) weight_left_ += weights_[index];
  }

  AcquireSummary run(const RunFolder& folder, const Json& provenance) {
    check_devices();
    began_wall_ = wall_s();
    const Time began = rig_.clock->now();
    RunJournal journal = options_.before == nullptr
                             ? RunJournal(folder, start_document(provenance))
                             : RunJournal(folder, start_document(provenance), *options_.before);
    ArchiveWorker worker(journal, folder, plan_, rig_file_, options_);
    std::exception_ptr cause;
    try {
      journal.baseline(positions());  // before the first job: the journal is not shared yet
      home();
      for (const std::size_t index : schedule_.overlap) take(plan_.poses[index], worker, true);
      for (const std::size_t index : schedule_.missing) take(plan_.poses[index], worker, false);
      report("finishing");
      worker.finish();
      journal.baseline(positions());
      journal.stop("success", "");
    } catch (...) {
      cause = std::current_exception();
    }
    if (cause) end_early(cause, journal, worker);
    const auto tally = worker.tally();
    summary_.poses = tally.poses;
    summary_.failed = tally.failed;
    summary_.archive_s = tally.busy_s;
    summary_.rig_s = seconds(rig_.clock->now() - began);
    summary_.wall_s = wall_s() - began_wall_;
    return summary_;
  }

  /// The devices have the last word on limits and images, and have it before anything moves.
  void check_devices() const {
    check_size(rig_.camera->image_size());
    std::vector<Exposure> exposures;
    for (const auto* list : {&schedule_.overlap, &schedule_.missing})
      for (const std::size_t index : *list)
        for (int i = 0; i < plan_.poses[index].images; ++i)
          exposures.push_back(exposure(plan_.poses[index], i));
    rig_.camera->check(exposures);
    const auto check = [this](AxisId id, double target) {
      with_axis(rig_, id, [target](auto& axis) { axis.check(quantity(axis, target)); });
    };
    for (const AxisId id : kAllAxes) check(id, 0.0);
    for (const auto* list : {&schedule_.overlap, &schedule_.missing})
      for (const std::size_t index : *list)
        for (const AxisId id : kAllAxes) check(id, plan_.poses[index].target(id));
  }

 private:
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

  void report(std::string_view phase) {
    if (!progress_) return;
    const double elapsed = wall_s() - began_wall_;
    // Before the first pose the plan's own estimate is all there is.
    const double scale = weight_done_ > 0.0 ? (wall_s() - first_pose_wall_) / weight_done_ : 1.0;
    progress_({done_, plan_.poses.size(), phase, elapsed, scale * weight_left_});
  }

  void home() {
    const Time began = rig_.clock->now();
    for (const AxisId id : kAllAxes) {
      throw_if_interrupted();
      with_axis(rig_, id, [this](auto& axis) {
        if (axis.homed()) return;
        report("homing");
        axis.home();
      });
    }
    summary_.homing_s = seconds(rig_.clock->now() - began);
    first_pose_wall_ = wall_s();
  }

  void take(const PlannedPose& pose, ArchiveWorker& worker, bool overlap) {
    hold_while_paused(worker);
    throw_if_interrupted();
    throw_if_stopping_now();
    mount(pose.payload);
    report("moving");
    Targets targets{};
    for (std::size_t i = 0; i < kAllAxes.size(); ++i) targets[i] = pose.target(kAllAxes[i]);
    ArchiveWorker::Job job;
    job.taken.planned = pose;
    job.overlap = overlap;
    move(targets);
    for (std::size_t i = 0; i < kAllAxes.size(); ++i)
      job.taken.axis(kAllAxes[i]) = held_[i]->readback;
    if (pose.dwell_s > 0.0) {
      report("settling");
      rig_.clock->sleep_for(from_seconds(pose.dwell_s));
      summary_.settle_s += pose.dwell_s;
    }
    job.taken.rig_time_s = seconds(rig_.clock->now());
    report("exposing");
    for (int i = 0; i < pose.images; ++i) job.frames.push_back(trigger(pose, i));

    const double waiting = wall_s();
    worker.push(std::move(job));
    summary_.waited_s += wall_s() - waiting;
    if (!overlap) ++done_;
    weight_left_ = std::max(0.0, weight_left_ - weights_[pose.index]);
    weight_done_ += weights_[pose.index];
  }

  /// The axes stand; devices and references stay as they are.
  void hold_while_paused(ArchiveWorker& worker) {
    if (!pause_requested() || interrupt_level() > 0) return;
    worker.note("pause", "asked for by another program");
    const double began = wall_s();
    while (pause_requested() && interrupt_level() == 0) {
      report("paused");
      std::this_thread::sleep_for(std::chrono::milliseconds(20));
    }
    first_pose_wall_ += wall_s() - began;  // no pose took that long
    worker.note("resume", pause_requested() ? "interrupted" : "asked for by another program");
  }

  void mount(Payload payload) {
    if (mounted_ == payload) return;
    report("mounting");
    move({});  // all axes at zero: there a person can reach the table, and the payload lies level
    mounted_.reset();
    if (rig_.mount) rig_.mount(payload);
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
            std::abs(stayed.position - targets[i]) > rig_file_.axis(kAllAxes[i]).tolerance;
      });
    }
    const double elapsed = seconds(rig_.clock->now() - began);
    settle = std::min(settle, elapsed);
    summary_.settle_s += settle;
    summary_.motion_s += elapsed - settle;
  }

  Frame trigger(const PlannedPose& pose, int i) {
    const Time began = rig_.clock->now();
    for (int attempt = 0;; ++attempt) {
      try {
        rig_.camera->announce(exposure(pose, i));
        Frame frame = rig_.camera->trigger();
        check_size(frame.image.size());
        summary_.trigger_s += seconds(rig_.clock->now() - began);
        return frame;
      } catch (const TimeoutError& e) {
        if (attempt >= rig_file_.camera.retries) {
          std::string why = e.what();
          if (why.ends_with('.')) why.pop_back();
          throw TimeoutError(
              fmt::format("camera: no frame at pose {} after {} triggers: {}. Check its cable, its "
                          "light and the trigger line.",
                          pose.index, attempt + 1, why));
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
                              ArchiveWorker& worker) {
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
      journal.baseline(positions());
    } catch (const std::exception&) {  // a dead line, perhaps the very cause: positions are a
                                       // courtesy here
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

  struct Held {
    double target;
    AxisReadback readback;
  };

  Rig& rig_;
  const RigFile& rig_file_;
  const Plan& plan_;
  const AcquireOptions& options_;
  const std::function<void(const Progress&)>& progress_;

  Schedule schedule_;
  AcquireSummary summary_;
  std::optional<Payload> mounted_;
  std::array<std::optional<Held>, kAllAxes.size()> held_;
  std::size_t done_ = 0;
  std::vector<double> weights_;
  double weight_left_ = 0.0, weight_done_ = 0.0;
  double began_wall_ = 0.0, first_pose_wall_ = 0.0;
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

void check_devices(Rig& rig, const RigFile& rig_file, const Plan& plan,
                   const AcquireOptions& options) {
  const std::function<void(const Progress&)> progress;
  Acquisition(rig, rig_file, plan, options, progress).check_devices();
}

}  // namespace turntable
