// Everything that follows from the images of a run: calibration, poses.csv, tables/, figures/,
// report.md and report.html. Made by run, resume, evaluate and report, and made again by verify, all in one way.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "src/report/pdf.h"
#include "src/report/results.h"

namespace turntable {

struct OutputOptions {
  /// A file, instead of what the run was given or its own sweep gives. Empty, and none of both: the stored one.
  std::filesystem::path calibration;
  EvaluateOptions evaluate;
  std::vector<RunFolder> beside;  ///< runs whose cameras are set beside this one's
  bool pdf = false;               ///< also print report.pdf
  /// Noise to be added to images of the run, or, where spots are the journal's, noise that was: from
  /// the stored noise_spots.csv then. An empty scenario is chosen.
  std::optional<NoiseOptions> noise = {};
};

/// What is written, before it is.
Results make_results(const RunFolder& folder, OutputOptions options);

/// @throws ConfigError if the run has no calibration.json: reports and comparisons start from it.
void require_evaluated(const RunFolder& folder);

/// A run that is there already, as its stored calibration and the spots of its journal tell.
struct StoredRun {
  RunRecord record;
  RigFile rig;
  Calibration calibration;
  Evaluation evaluation;
};
/// @throws ConfigError, also if it has no calibration yet.
StoredRun stored_run(const RunFolder& folder, std::vector<const Solver*> solvers);

enum class Rewrite {
  kAll,     ///< also calibration.json and poses.csv
  kTables,  ///< these stay: tables, figures and report only
};
/// Makes and writes them, and evaluation.json, which says how; prints what came out. A report.pdf of
/// earlier outputs is removed. That no PDF could be printed changes no exit code. @return exit code.
int write_outputs(const RunFolder& folder, OutputOptions options, Rewrite rewrite);

/// The PDF of a page, beside its Markdown: one of earlier outputs is removed; with a printer, which has
/// loaded the page, prints it and says so, or warns why not.
void renew_pdf(const std::filesystem::path& markdown, PdfPrinter* printer);

/// How the stored outputs were made: evaluation.json.
struct EvaluationRecord {
  std::uint64_t journal_lines = 0;     ///< that poses.csv follows from
  std::vector<const Solver*> solvers;  ///< known ones
  std::string poses_sha256;            ///< of poses.csv as it was written; empty: not known
  std::string calibration_sha256;      ///< of calibration.json, if given; empty: from the own sweep
  std::vector<std::string> beside;     ///< folders
  std::optional<NoiseOptions> noise;
  Json poses_by, tables_by;  ///< `program_provenance`; null if not known
};
/// Of a run that was evaluated before there was such a file: what poses.csv and calibration.json
/// tell. @throws ConfigError.
EvaluationRecord read_evaluation_record(const RunFolder& folder, const Plan& plan);

}  // namespace turntable
