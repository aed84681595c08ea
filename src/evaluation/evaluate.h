// From the images of attitude scenarios to errors against the turntable, level "as published": the
// gimbal's axes are taken as parallel to the plane frame, and attitudes as relative to the initial
// pose of their repeat.
#pragma once

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "src/attitude/solver.h"
#include "src/evaluation/measure_spots.h"
#include "src/evaluation/statistics.h"
#include "src/imaging/calibration.h"
#include "src/record/run_folder.h"

namespace turntable {

/// Where the spots come from.
enum class SpotSource {
  kImages,   ///< found again in the archived images; the journal's where no image was archived
  kJournal,  ///< as journaled when the images were taken
};

struct EvaluateOptions {
  std::vector<const Solver*> solvers;  ///< empty = those `by_default` that the camera can serve
  bool all_solvers = false;  ///< with no solvers named: every row that the camera can serve
  SpotSource spots = SpotSource::kImages;
  /// Instead of `spots`: those of image `k` of a pose; called from several threads.
  std::function<SpotList(const TakenPose& pose, std::size_t k)> spots_of;
  std::optional<std::size_t> scenario;  ///< poses of this one only; nothing: of all
  std::function<void(std::size_t done, std::size_t total)>
      progress;  ///< poses; called from several threads
};

/// One pose as one solver sees it. Angles are relative to the initial pose, in the gimbal's order,
/// deg.
struct PoseResult {
  const Solver* solver = nullptr;
  bool measured = false;  ///< has an attitude, and so has the initial pose
  std::string status;     ///< `status_name`, or why no solver could be asked
  int iterations = 0;
  double residual = 0.0;    ///< mm for ray solvers, px for pinhole solvers
  GimbalAngles angles_deg;  ///< measured
  PoseError error;
};

struct EvaluatedPose {
  PlannedPose planned;
  bool taken = false;
  bool missed = false;    ///< an axis did not reach its target; the truth is its read-back
  double stage_mm = 0.0;  ///< read back
  GimbalAngles read_back_deg;
  int spots = 0;                    ///< found in the first image
  bool in_domain = false;           ///< every matched spot lies inside the calibrated area
  std::vector<PoseResult> results;  ///< one per solver, in the table's order
  std::vector<Vector2d> points_px;  ///< matched spots in the target's order; empty if not matched
  std::vector<Eigen::Matrix2d> covariances_px2;  ///< of each; empty if not stated
};

struct Evaluation {
  std::vector<const Solver*> solvers;
  std::vector<EvaluatedPose>
      poses;  ///< every planned attitude pose, in the plan's order, taken or not
};

/// An archived image. @throws ConfigError: missing, altered, of another size than the calibration's.
Image load_calibrated_image(const RunFolder& folder, const TakenImage& taken,
                            const Calibration& calibration);

/// @throws ConfigError: images of another size than the calibration's, damaged images, a solver
/// that needs a pinhole calibration where there is none.
Evaluation evaluate(const RunRecord& record, const RunFolder& folder, const RigFile& rig,
                    const Calibration& calibration, const EvaluateOptions& options = {});

/// Where in `poses` the initial pose is that each pose's attitudes are relative to: the reference pose
/// of its scenario and repeat. Nothing if the plan has none.
std::vector<std::optional<std::size_t>> initial_poses(const Evaluation& evaluation);

/// Statistics of one scenario, repeat and solver. The initial pose is not counted: its error is
/// zero by definition.
struct RepeatStatistics {
  std::size_t scenario = 0;
  int repeat = 1;
  const Solver* solver = nullptr;
  ErrorStatistics statistics;
  std::size_t outside_domain = 0;
};
std::vector<RepeatStatistics> repeat_statistics(const Evaluation& evaluation);

/// Results without an attitude, over all solvers and poses, and poses with an axis off its target;
/// they decide the exit code.
std::size_t failed_results(const Evaluation& evaluation);

/// One row per pose and solver, units in the header. @throws RecordError.
void write_poses_csv(const Evaluation& evaluation, const Plan& plan,
                     const std::filesystem::path& file);

/// One of several evaluations of the same poses.
struct EvaluationVariant {
  std::string value;  ///< what it differs by
  const Evaluation* evaluation;
};
/// The same for several, told apart by a column in front. @throws RecordError.
void write_poses_csv(const std::string& column, const std::vector<EvaluationVariant>& variants,
                     const Plan& plan, const std::filesystem::path& file);

}  // namespace turntable
