#include "src/app/outputs.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <sstream>

#include "src/app/commands.h"
#include "src/app/progress.h"
#include "src/app/provenance.h"
#include "src/core/errors.h"
#include "src/evaluation/calibrate.h"
#include "src/evaluation/scenario_statistics.h"
#include "src/record/atomic_file.h"
#include "src/record/sha256.h"
#include "src/report/html_report.h"
#include "src/report/pdf.h"
#include "src/report/report.h"

namespace turntable {
namespace {

namespace fs = std::filesystem;

/// The solvers that a poses.csv has rows of, in its order.
std::vector<const Solver*> solvers_in(const fs::path& poses) {
  std::vector<const Solver*> solvers;
  std::istringstream csv(read_text(poses));
  std::string line;
  std::getline(csv, line);  // header
  while (std::getline(csv, line)) {
    std::istringstream cells(line);
    std::string cell;
    for (int i = 0; i < 7; ++i)
      std::getline(cells, cell, ',');  // index, id, scenario, repeat, point, role, solver
    const Solver* solver = find_solver(cell);
    if (solver == nullptr || std::ranges::find(solvers, solver) != solvers.end()) break;
    solvers.push_back(solver);
  }
  return solvers;
}

/// What a stored calibration was made from, if it is this run's and its images are still there: only
/// then do the residuals belong into the run's report.
std::optional<CalibrationSet> sweep_behind(const Calibration& calibration, const RunRecord& record,
                                           const RunFolder& folder, const RigFile& rig) {
  if (!is_of_own_sweep(calibration, record)) return {};
  for (const TakenPose& pose : record.poses)
    if (record.plan.scenario_of(pose.planned).kind == ScenarioKind::kCalibration)
      for (const TakenImage& image : pose.images)
        if (image.file.empty() || !fs::exists(folder.root() / image.file)) {
          spdlog::warn(
              "{}: the pattern's images are not all there; figures of the calibration are left "
              "out.",
              folder.root().string());
          return {};
        }
  return sweep_set(record, folder, rig);
}

/// Before another calibration takes its place: it cannot be made again.
void keep_given_calibration(const RunFolder& folder, const std::string& given_sha256,
                            const std::string& next) {
  const auto kept = [&](const fs::path& file) {
    return fs::exists(file) && sha256_hex(read_text(file)) == given_sha256;
  };
  if (given_sha256.empty() || kept(folder.given_calibration()) || !kept(folder.calibration()))
    return;
  const std::string given = read_text(folder.calibration());
  if (given != next) write_atomically(folder.given_calibration(), given);
}

/// Of a run that is there already, from its stored points.
CameraComparison stored_comparison(const RunFolder& folder) {
  const StoredRun run = stored_run(folder, {&default_solver()});  // for the points
  CameraComparison out = compare_cameras(run.evaluation, run.rig, run.calibration);
  out.run = folder.root().string();
  return out;
}

Json noise_json(const NoiseOptions& noise) {
  return {{"sigmas_grey", noise.sigmas_grey}, {"seed", noise.seed}, {"scenario", noise.scenario}};
}

/// Spots of the images with noise: found anew or, with the journal's, as they were stored.
NoisySpots noisy_spots(const RunFolder& folder, const Results& made, const NoiseOptions& noise,
                       SpotSource source) {
  if (source == SpotSource::kJournal)
    return read_noise_spots(folder.noise_spots(), noise, made.record.plan);
  ProgressLine line("adding noise");
  return find_noisy_spots(
      made.record, folder, made.rig, made.calibration, noise,
      [&](std::size_t done, std::size_t total) { line.update(done, total, "images"); });
}

/// Of an earlier evaluation: it followed from images and a calibration that may have changed since.
void remove_noise(const RunFolder& folder) {
  if (fs::exists(folder.noise_spots()))
    spdlog::info(
        "{}: the images with noise are not evaluated again; --noise does it. What was stored of "
        "them "
        "is removed.",
        folder.root().string());
  std::error_code ignored;
  fs::remove(folder.noise_spots(), ignored);
  fs::remove(folder.noise_poses(), ignored);
}

void write_evaluation_record(const EvaluationRecord& record, const fs::path& file) {
  Json json{{"format", "turntable-evaluation/1"}, {"journal_lines", record.journal_lines},
            {"solvers", Json::array()},           {"beside", record.beside},
            {"poses_by", record.poses_by},        {"tables_by", record.tables_by}};
  for (const Solver* solver : record.solvers) json["solvers"].push_back(solver->name);
  if (record.noise) json["noise"] = noise_json(*record.noise);
  if (!record.poses_sha256.empty()) json["poses_sha256"] = record.poses_sha256;
  if (!record.calibration_sha256.empty()) json["calibration_sha256"] = record.calibration_sha256;
  write_atomically(file, json.dump(1) + "\n");
}

/// "-" where no pose was measured.
std::string rmse_text(double rmse_deg) {
  return std::isfinite(rmse_deg) ? fmt::format("{:.4f}", rmse_deg) : "-";
}

void warn_if_torn(const RunFolder& folder, const RunRecord& record) {
  if (record.torn) spdlog::warn("{}: {}", folder.journal().string(), *record.torn);
}

/// Tables and report follow from the journal, so that nobody would notice.
void warn_of_other_poses(const RunFolder& folder, const EvaluationRecord& how) {
  const fs::path& poses = folder.poses();
  const bool there = fs::exists(poses);
  if (there && (how.poses_sha256.empty() || sha256_hex(read_text(poses)) == how.poses_sha256))
    return;
  spdlog::warn(
      "{}: {}. The report follows from the journal, not from it. turntable evaluate {} makes it "
      "again{}.",
      poses.string(), there ? "was changed after it was written" : "is missing",
      folder.root().string(),
      there ? fmt::format("; turntable verify {} says where it differs", folder.root().string())
            : "");
}

}  // namespace

void require_evaluated(const RunFolder& folder) {
  if (!fs::exists(folder.calibration()))
    throw ConfigError(folder.root().string(), "",
                      fmt::format("has no calibration.json, so that nothing was evaluated yet. "
                                  "\"turntable evaluate {}\" does it.",
                                  folder.root().string()));
}

StoredRun stored_run(const RunFolder& folder, std::vector<const Solver*> solvers) {
  require_evaluated(folder);
  StoredRun out;
  out.record = read_run(folder);
  warn_if_torn(folder, out.record);
  out.rig = rig_of(out.record);
  out.calibration = load_calibration(folder.calibration());
  EvaluateOptions options;
  options.solvers = std::move(solvers);
  options.spots = SpotSource::kJournal;
  out.evaluation = evaluate(out.record, folder, out.rig, out.calibration, options);
  return out;
}

Results make_results(const RunFolder& folder, OutputOptions options) {
  Results out;
  out.record = read_run(folder);
  out.rig = rig_of(out.record);
  // A scenario that is not there is known before the work.
  if (options.noise && options.evaluate.spots == SpotSource::kImages)
    options.noise->scenario = noise_scenario(out.record, folder, options.noise->scenario);
  warn_if_torn(folder, out.record);

  const std::string given = given_calibration_sha256(out.record);
  if (!options.calibration.empty() || !calibrates_itself(out.record)) {
    const fs::path file =
        !options.calibration.empty() ? options.calibration : first_calibration(folder, out.record);
    out.calibration = load_calibration(file);
    out.calibration_json = read_text(file);
    if (options.calibration.empty() && !given.empty() && sha256_hex(out.calibration_json) != given)
      throw ConfigError(file.string(), "",
                        "is not the calibration that the run began with. Restore it from a copy, "
                        "or name one with --calibration.");
    out.set = sweep_behind(out.calibration, out.record, folder, out.rig);
  } else {
    ProgressLine line("calibrating");
    out.set = sweep_set(out.record, folder, out.rig, [&](std::size_t done, std::size_t total) {
      line.update(done, total, "images");
    });
    out.calibration = calibrate(*out.set);
    out.calibration_json = calibration_to_json(out.calibration);
  }
  {
    ProgressLine line("evaluating");
    options.evaluate.progress = [&](std::size_t done, std::size_t total) {
      line.update(done, total, "poses");
    };
    out.evaluation = evaluate(out.record, folder, out.rig, out.calibration, options.evaluate);
  }
  out.cameras.push_back(compare_cameras(out.evaluation, out.rig, out.calibration));
  out.levels = truth_levels(out.record, out.rig, out.calibration, out.evaluation);
  out.statistics = level_statistics(out.evaluation, out.levels);
  {
    ProgressLine line("budgeting");
    out.budgets = error_budgets(
        out.record, out.rig, out.calibration, out.evaluation, out.levels,
        [&](std::size_t done, std::size_t total) { line.update(done, total, "steps"); });
  }
  if (options.noise) {
    out.noisy_spots = noisy_spots(folder, out, *options.noise, options.evaluate.spots);
    options.evaluate.solvers = out.evaluation.solvers;
    out.noise = evaluate_noise(out.record, folder, out.rig, out.calibration, options.evaluate,
                               *out.noisy_spots);
  }
  for (const RunFolder& other : options.beside) out.cameras.push_back(stored_comparison(other));
  return out;
}

void renew_pdf(const fs::path& markdown, PdfPrinter* printer) {
  fs::path pdf = markdown;
  pdf.replace_extension(".pdf");
  std::error_code ignored;
  if (fs::remove(pdf, ignored) && printer == nullptr)
    fmt::print("removed: {}, which was of the report before\n", pdf.string());
  if (printer == nullptr) return;
  std::optional<std::string> trouble;
  {
    ProgressLine line("printing " + pdf.filename().string());
    trouble = printer->print(pdf, [&] { line.wait(static_cast<double>(kPrintTimeout.count())); });
  }
  if (trouble)
    spdlog::warn("{}", *trouble);
  else
    fmt::print("printed: {}\n", pdf.string());
}

int write_outputs(const RunFolder& folder, OutputOptions options, Rewrite rewrite) {
  const std::unique_ptr<PdfPrinter> printer =
      options.pdf ? std::make_unique<PdfPrinter>() : nullptr;
  folder.remove_temporary_files();
  const Results made = make_results(folder, options);
  const Plan& plan = made.record.plan;
  EvaluationRecord how;
  if (rewrite == Rewrite::kAll) {
    const std::string& calibration = made.calibration_json;
    keep_given_calibration(folder, given_calibration_sha256(made.record), calibration);
    write_atomically(folder.calibration(), calibration);
    write_poses_csv(made.evaluation, plan, folder.poses());
    how.journal_lines = made.record.journal.next_seq - 1;
    how.solvers = made.evaluation.solvers;
    how.poses_sha256 = sha256_hex(read_text(folder.poses()));
    if (!options.calibration.empty() || !calibrates_itself(made.record))
      how.calibration_sha256 = sha256_hex(calibration);
    how.poses_by = program_provenance();
    if (made.noise) {
      how.noise = made.noise->options;
      write_noise_spots(*made.noisy_spots, folder.noise_spots());
      write_noise_poses(*made.noise, plan, folder.noise_poses());
    } else {
      remove_noise(folder);
    }
  } else {
    how = read_evaluation_record(folder, plan);
    warn_of_other_poses(folder, how);
  }
  how.tables_by = program_provenance();
  how.beside.clear();
  for (const RunFolder& other : options.beside)
    how.beside.push_back(fs::absolute(other.root()).lexically_normal().string());
  const fs::path report = write_report(folder, made, printer.get());
  write_evaluation_record(how, folder.evaluation());

  for (const PlaneResidual& p : made.calibration.planes)
    fmt::print("camera: plane {:8.3f} mm ({}): residual {:.4f} mm rms, {:.4f} mm max, {} circles\n",
               p.z_mm, p.fitted ? "fitted" : "kept out", p.rms_mm, p.max_mm, p.points);
  for (const RepeatStatistics& r : repeat_statistics(made.evaluation))
    fmt::print("{:<14} repeat {}  {:<18} total RMSE {} deg  {} poses, {} failed\n",
               plan.scenarios[r.scenario].name, r.repeat, r.solver->name,
               rmse_text(r.statistics.rmse_total_deg), r.statistics.poses, r.statistics.failed);
  if (made.noise)
    for (const NoiseLevel& level : made.noise->levels)
      for (const ScenarioStatistics& s : scenario_statistics(level.evaluation))
        fmt::print("noise {:5g} grey  {}  {:<18} total RMSE {} deg  {} poses, {} failed\n",
                   level.sigma_grey, made.noise->options.scenario, s.solver->name,
                   rmse_text(s.rmse_total_deg.value), s.pooled.poses, s.pooled.failed);
  const std::size_t failed = failed_results(made.evaluation);
  if (failed > 0)
    spdlog::warn("{} results failed; poses.csv and report.md say which and why.", failed);
  if (made.rig.simulated())
    fmt::print("These results are simulated (seed {}).\n", made.rig.simulation->seed);
  renew_pdf(folder.report(), printer.get());
  fmt::print("report: {}\n", report.string());
  return failed > 0 ? kFailedPoses : kDone;
}

EvaluationRecord read_evaluation_record(const RunFolder& folder, const Plan& plan) {
  EvaluationRecord how;
  if (fs::exists(folder.evaluation())) {
    const Json json = load_json(folder.evaluation(), "evaluation");
    how.journal_lines = json.at("journal_lines");
    for (const Json& name : json.at("solvers")) {
      const Solver* solver = find_solver(name.get<std::string>());
      if (solver == nullptr)
        throw ConfigError(folder.evaluation().string(), "/solvers",
                          fmt::format("found \"{}\", which is no solver of this program. Evaluate "
                                      "the run again.",
                                      name.get<std::string>()));
      how.solvers.push_back(solver);
    }
    how.poses_sha256 = json.value("poses_sha256", "");
    how.calibration_sha256 = json.value("calibration_sha256", "");
    how.beside = json.at("beside").get<std::vector<std::string>>();
    if (const auto noise = json.find("noise"); noise != json.end())
      how.noise = {noise->at("sigmas_grey").get<std::vector<double>>(), noise->at("seed"),
                   noise->at("scenario")};
    how.poses_by = json.at("poses_by");
    how.tables_by = json.at("tables_by");
    return how;
  }
  how.journal_lines = read_journal(folder.journal(), [](const JournalEntry&) {}).next_seq - 1;
  if (fs::exists(folder.poses())) how.solvers = solvers_in(folder.poses());
  if (fs::exists(folder.calibration()) &&
      (!has_calibration_sweep(plan) ||
       load_calibration(folder.calibration()).source != calibration_source(plan)))
    how.calibration_sha256 = sha256_hex(read_text(folder.calibration()));
  how.poses_by = how.tables_by = Json::object();
  return how;
}

}  // namespace turntable
