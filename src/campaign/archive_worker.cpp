#include "src/campaign/archive_worker.h"

#include <fmt/format.h>

#include <chrono>
#include <future>
#include <iterator>

#include "src/core/interrupt.h"
#include "src/record/atomic_file.h"
#include "src/record/sha256.h"

namespace turntable {
namespace {

struct Prepared {
  std::vector<StagedFile> files;
  bool failed = false;  ///< an axis missed its target, or the target was not seen
  bool doubtful = false;
};

/// Fills in the job's images and puts their files on the medium, not yet under their names.
Prepared prepare(ArchiveWorker::Job& job, const RunFolder& folder, const AcquireOptions& options) {
  const PlannedPose& planned = job.taken.planned;
  Prepared out;
  out.failed = job.taken.missed();
  for (std::size_t i = 0; i < job.frames.size(); ++i) {
    const Frame& frame = job.frames[i];
    Inspection& seen = job.inspections[i];
    TakenImage& image = job.taken.images[i];
    image.frame_id = frame.id;
    image.exposed_s = seconds(frame.timestamp);
    image.spots = std::move(seen.spots);
    image.complaint = std::move(seen.complaint);
    out.failed = out.failed || !seen.target_seen;
    out.doubtful = out.doubtful || !image.complaint.empty();
    if (options.archive != ArchiveMode::kNone) {
      const bool mask = options.archive == ArchiveMode::kRegions && seen.worth_regions;
      const std::string png =
          mask ? encode_png(keep_regions(frame.image, seen.regions, options.region_margin_px))
               : encode_frame(frame.image);
      // A later session never writes over what an earlier one took.
      const std::string session =
          options.session() == 1 ? "" : fmt::format("-s{}", options.session());
      image.file =
          fmt::format("images/{:06}-{}-{}{}.png", planned.index, planned.id, i + 1, session);
      image.sha256 = sha256_hex(png);
      out.files.emplace_back(folder.root() / image.file, png);
    }
  }
  return out;
}

}  // namespace

ArchiveWorker::ArchiveWorker(RunJournal& journal, const RunFolder& folder, const Plan& plan,
                             const RigFile& rig_file, const AcquireOptions& options)
    : journal_(journal),
      folder_(folder),
      plan_(plan),
      rig_file_(rig_file),
      options_(options),
      thread_([this] { run(); }) {}

ArchiveWorker::~ArchiveWorker() { end(); }

void ArchiveWorker::push(Job job) {
  std::unique_lock lock(mutex_);
  const std::size_t room = std::max<std::size_t>(options_.queued_poses, 1);
  while (queue_.size() >= room && !failure_ && interrupt_level() < 2)
    changed_.wait_for(lock, std::chrono::milliseconds(20));
  if (failure_) std::rethrow_exception(failure_);
  queue_.push_back(std::move(job));
  changed_.notify_all();
}

void ArchiveWorker::note(const std::function<void(RunJournal&)>& write) {
  std::unique_lock lock(mutex_);
  // The journal is the worker's while it works; idle, it is this thread's.
  changed_.wait(lock, [this] { return failure_ || (queue_.empty() && !working_); });
  if (failure_) std::rethrow_exception(failure_);
  write(journal_);
}

void ArchiveWorker::finish() {
  end();
  if (failure_) std::rethrow_exception(failure_);
}

ArchiveWorker::Tally ArchiveWorker::tally() const {
  const std::lock_guard lock(mutex_);
  return tally_;
}

void ArchiveWorker::end() {
  {
    const std::lock_guard lock(mutex_);
    ending_ = true;
    changed_.notify_all();
  }
  if (thread_.joinable()) thread_.join();
}

void ArchiveWorker::run() {
  std::unique_lock lock(mutex_);
  for (;;) {
    changed_.wait(lock, [this] { return ending_ || !queue_.empty(); });
    if (queue_.empty()) return;
    std::vector<Job> jobs(std::move_iterator(queue_.begin()), std::move_iterator(queue_.end()));
    queue_.clear();
    working_ = true;
    changed_.notify_all();
    lock.unlock();
    std::exception_ptr failure;
    const auto begin = std::chrono::steady_clock::now();
    try {
      process(jobs);
    } catch (...) {
      failure = std::current_exception();
    }
    lock.lock();
    tally_.busy_s +=
        std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
    working_ = false;
    changed_.notify_all();
    if (failure) {
      failure_ = failure;
      queue_.clear();
      changed_.notify_all();
      return;
    }
  }
}

void ArchiveWorker::process(std::vector<Job>& jobs) {
  std::vector<std::future<Prepared>> pending;
  for (Job& job : jobs)
    pending.push_back(std::async(jobs.size() == 1 ? std::launch::deferred : std::launch::async,
                                 [this, &job] { return prepare(job, folder_, options_); }));
  // Poses enter the journal in their order; behind one that failed, none does.
  std::exception_ptr failure;
  std::vector<Prepared> ready;
  for (auto& result : pending) {
    try {
      Prepared prepared = result.get();
      if (!failure) ready.push_back(std::move(prepared));
    } catch (...) {
      if (!failure) failure = std::current_exception();
    }
  }
  bool any_file = false;
  for (Prepared& prepared : ready)
    for (StagedFile& file : prepared.files) {
      file.commit();
      any_file = true;
    }
  if (any_file) sync_folder(folder_.images());
  for (std::size_t i = 0; i < ready.size(); ++i) {
    for (const TelemetryReading& reading : jobs[i].telemetry)
      journal_.telemetry(reading, rig_file_.telemetry);
    journal_.pose(jobs[i].taken, plan_.scenario_of(jobs[i].taken.planned).name, jobs[i].overlap);
  }
  if (!ready.empty()) journal_.sync();
  {
    const std::lock_guard lock(mutex_);
    for (std::size_t i = 0; i < ready.size(); ++i) {
      if (jobs[i].overlap) continue;
      ++tally_.poses;
      if (ready[i].failed)
        ++tally_.failed;
      else if (ready[i].doubtful)
        ++tally_.doubtful;
    }
  }
  if (failure) std::rethrow_exception(failure);
}

}  // namespace turntable
