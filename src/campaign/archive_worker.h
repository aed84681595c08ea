// The other thread of a run: archives and journals pose k-1 while the rig moves to pose
// k. If the rig is faster than the disk, the poses that wait are done together: syncing costs the
// same for eight as for one.
#pragma once

#include <condition_variable>
#include <cstddef>
#include <deque>
#include <exception>
#include <functional>
#include <mutex>
#include <thread>
#include <vector>

#include "src/campaign/inspection.h"
#include "src/campaign/runner.h"
#include "src/core/camera.h"
#include "src/record/run_journal.h"

namespace turntable {

class ArchiveWorker {
 public:
  struct Job {
    TakenPose taken;
    std::vector<Frame> frames;
    std::vector<Inspection> inspections;      ///< one per frame
    std::vector<TelemetryReading> telemetry;  ///< read before the pose
    bool overlap = false;                     ///< taken beside the one that counts
  };
  /// What was done so far; complete after `finish`.
  struct Tally {
    std::size_t poses = 0;
    std::size_t failed = 0;
    std::size_t doubtful = 0;  ///< of those that did not fail: with a complaint about an image
    double busy_s = 0.0;
  };

  /// All references must outlive the worker, which has `journal` while it lives: others write by `note`.
  ArchiveWorker(RunJournal& journal, const RunFolder& folder, const Plan& plan,
                const RigFile& rig_file, const AcquireOptions& options);
  ~ArchiveWorker();
  ArchiveWorker(const ArchiveWorker&) = delete;
  ArchiveWorker& operator=(const ArchiveWorker&) = delete;

  /// Waits while `queued_poses` are waiting, though not at interrupt level 2: what is taken is
  /// kept.
  /// @throws what a job threw.
  void push(Job job);
  /// Writes into the journal behind everything pushed so far. @throws what a job threw.
  void note(const std::function<void(RunJournal&)>& write);
  /// Does what is still queued and ends the thread. @throws what a job threw; jobs behind a failed
  /// one are dropped.
  void finish();
  /// Before `finish` a snapshot.
  Tally tally() const;

 private:
  void run();
  void process(std::vector<Job>& jobs);
  void end();

  RunJournal& journal_;
  const RunFolder& folder_;
  const Plan& plan_;
  const RigFile& rig_file_;
  const AcquireOptions& options_;

  mutable std::mutex mutex_;
  std::condition_variable changed_;
  std::deque<Job> queue_;
  bool ending_ = false;
  bool working_ = false;
  std::exception_ptr failure_;
  Tally tally_;
  std::thread thread_;
};

}  // namespace turntable
