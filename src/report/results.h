// What follows from the images of a run: everything that its tables, figures and report are made of.
#pragma once

#include <optional>
#include <vector>

#include "src/evaluation/calibration_set.h"
#include "src/evaluation/camera_comparison.h"
#include "src/evaluation/cross_validation.h"
#include "src/evaluation/error_budget.h"
#include "src/evaluation/evaluate.h"
#include "src/evaluation/noise_campaign.h"
#include "src/record/run_folder.h"

namespace turntable {

struct Results {
  RunRecord record;
  RigFile rig;
  Calibration calibration;
  std::string calibration_json;       ///< the file that it is or was read from, byte for byte
  std::optional<CalibrationSet> set;  ///< what the calibration was made from, if by this run
  Evaluation evaluation;
  std::vector<CameraComparison> cameras;  ///< this run's first, then those of runs beside it
  TruthLevels levels;
  std::vector<LevelStatistics> statistics;  ///< as published first
  std::vector<ErrorBudget> budgets;
  std::optional<NoisySpots> noisy_spots;  ///< of its images with noise, if that was done
  std::optional<NoiseCampaign> noise;

  const Plan& plan() const { return record.plan; }
};

}  // namespace turntable
