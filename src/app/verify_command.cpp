// "turntable verify": is a run still what was recorded, and does everything follow from it again?
#include <fmt/format.h>
#include <fmt/ranges.h>
#include <spdlog/spdlog.h>
#include <stdlib.h>

#include <nlohmann/json.hpp>

#include "src/app/commands.h"
#include "src/app/outputs.h"
#include "src/app/progress.h"
#include "src/app/provenance.h"
#include "src/core/errors.h"
#include "src/record/atomic_file.h"
#include "src/record/folder.h"
#include "src/record/sha256.h"
#include "src/record/verify.h"
#include "src/report/tables.h"

namespace turntable {
namespace {

namespace fs = std::filesystem;

/// What to do about a difference, and what may explain it.
std::string advice(const RunFolder& folder, const Json& made_by) {
  const std::vector<std::string> changes = program_changes(made_by);
  return fmt::format("{}\"turntable evaluate {}\" makes it anew.",
                     changes.empty()
                         ? ""
                         : fmt::format("It was made by another program than this one ({}). ",
                                       fmt::join(changes, "; ")),
                     folder.root().string());
}

/// Evaluates the run again, in another folder, and compares.
void verify_outputs(const RunFolder& folder, RunFindings& findings) {
  std::error_code error;
  const auto empty = [&](const fs::path& at) {
    return !fs::exists(at, error) || fs::is_empty(at, error);
  };
  if (empty(folder.poses()) && empty(folder.evaluation()) && empty(folder.tables())) {
    findings.remarks.push_back(
        fmt::format("the run has not been evaluated yet; \"turntable evaluate {}\" does it",
                    folder.root().string()));
    return;
  }
  const RunRecord record = read_run(folder);
  const EvaluationRecord how = read_evaluation_record(folder, record.plan);
  const std::uint64_t lines = record.journal.next_seq - 1;
  if (how.journal_lines > lines) {
    findings.damage.push_back(fmt::format(
        "{}: has {} good lines, and had {} when the run was evaluated: its end is lost. Restore it "
        "from a copy, or \"turntable resume\" takes the poses again.",
        folder.journal().string(), lines, how.journal_lines));
    return;
  }
  if (how.journal_lines < lines) {
    findings.damage.push_back(fmt::format(
        "the run was evaluated when its journal had {} lines, and has {} now: its tables are of an "
        "earlier state and were not compared; \"turntable evaluate {}\" makes them again",
        how.journal_lines, record.journal.next_seq - 1, folder.root().string()));
    return;
  }
  if (fs::exists(folder.given_calibration(), error) &&
      sha256_hex(read_text(folder.given_calibration())) != given_calibration_sha256(record))
    findings.damage.push_back(
        fmt::format("{}: is not the calibration that the run began with. Restore it from a copy.",
                    folder.given_calibration().string()));
  OutputOptions options;
  options.evaluate.solvers = how.solvers;
  if (!how.calibration_sha256.empty()) {
    const std::string found = sha256_hex(read_text(folder.calibration()));
    if (found != how.calibration_sha256)
      throw ConfigError(
          folder.calibration().string(), "",
          "is not the one that the run was evaluated with: its SHA-256 is not that of "
          "evaluation.json. " +
              advice(folder, how.poses_by));
    options.calibration = folder.calibration();
    const std::string at_start = given_calibration_sha256(record);
    if (!at_start.empty() && at_start != found)
      findings.remarks.push_back(
          fmt::format("{}: is not the one that the run began with", folder.calibration().string()));
  }
  options.noise = how.noise;
  bool beside_are_there = true;
  for (const std::string& other : how.beside) {
    try {
      options.beside.push_back(RunFolder::open(other));
      (void)read_run(options.beside.back());
      (void)load_calibration(options.beside.back().calibration());
    } catch (const ConfigError& e) {
      beside_are_there = false;
      findings.remarks.push_back(fmt::format(
          "tables/camera_solver sets a run beside this one that cannot be read, and was "
          "not made again: {}",
          e.what()));
    }
  }
  if (!beside_are_there) options.beside.clear();

  const Scratch scratch("turntable-verify", ", or give --record-only");
  const RunFolder again = folder.with_outputs_in(scratch.path());
  const Results made = make_results(folder, std::move(options));
  write_atomically(again.calibration(), made.calibration_json);
  write_poses_csv(made.evaluation, made.record.plan, again.poses());
  write_tables(again, made);
  if (made.noise) {
    write_noise_spots(*made.noisy_spots, again.noise_spots());
    write_noise_poses(*made.noise, made.record.plan, again.noise_poses());
  }
  if (!beside_are_there)
    for (const char* name : {"camera_solver.csv", "camera_solver.md", "camera_solver.tex"})
      if (fs::exists(folder.tables() / name, error))
        fs::copy_file(folder.tables() / name, again.tables() / name,
                      fs::copy_options::overwrite_existing);
  const std::string about_poses = advice(folder, how.poses_by);
  compare_outputs(folder.calibration(), again.calibration(), about_poses, findings);
  compare_outputs(folder.poses(), again.poses(), about_poses, findings);
  if (made.noise) {
    compare_outputs(folder.noise_spots(), again.noise_spots(), about_poses, findings);
    compare_outputs(folder.noise_poses(), again.noise_poses(), about_poses, findings);
  }
  compare_outputs(folder.tables(), again.tables(), advice(folder, how.tables_by), findings);
}

}  // namespace

int verify_command(const VerifyArguments& a) {
  const RunFolder folder = RunFolder::open(a.run);
  RunFindings findings;
  {
    ProgressLine line("verifying");
    findings = verify_run(
        folder, [&](std::size_t done, std::size_t total) { line.update(done, total, "poses"); });
  }
  if (!a.record_only) {
    if (findings.sound()) {
      try {
        verify_outputs(folder, findings);
      } catch (const ConfigError& e) {
        findings.damage.push_back(e.what());
      }
    } else {
      findings.remarks.push_back("what follows from the record was not made again: it is damaged");
    }
  }
  fmt::print("journal: {} lines, images: {}, files made again: {}\n", findings.lines,
             findings.images, findings.outputs);
  for (const std::string& remark : findings.remarks) fmt::print("remark: {}\n", remark);
  for (const std::string& what : findings.damage) spdlog::error("{}", what);
  if (!findings.sound()) return kFailedPoses;
  fmt::print("The record is as it was written{}.\n",
             findings.outputs > 0 ? ", and what follows from it is the same again" : "");
  return kDone;
}

}  // namespace turntable
