// "turntable calibrate": a camera from whatever there is: a run, a sweep still to be taken, images
// or points of a lab, an OpenCV camera, a finished calibration.
#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <nlohmann/json.hpp>

#include "src/app/commands.h"
#include "src/app/progress.h"
#include "src/campaign/scenario.h"
#include "src/core/errors.h"
#include "src/core/json_document.h"
#include "src/evaluation/calibrate.h"
#include "src/imaging/opencv_yaml.h"
#include "src/record/folder.h"
#include "src/report/calibration_report.h"

namespace turntable {
namespace {

namespace fs = std::filesystem;

bool is_opencv_file(const fs::path& file) {
  const std::string ending = file.extension().string();
  return ending == ".yml" || ending == ".yaml" || ending == ".xml";
}

/// Words for --order; -1 = not given.
int order_of(const std::string& text) {
  if (text.empty()) return -1;
  if (text == "auto") return kOrderByResiduals;
  if (text.size() == 1 && text[0] >= '1' && text[0] <= '9') return text[0] - '0';
  throw ConfigError("--order", "", fmt::format("found \"{}\", allowed: 1 to 9, or auto.", text));
}

RayPlanes planes_of(const std::vector<double>& heights, const fs::path& file) {
  if (heights.empty())
    throw ConfigError(
        "--planes", "",
        fmt::format("is missing: {} says nothing of depths. Give two heights in the "
                    "camera's frame, mm, negative in front of it: --planes -800,-600.",
                    file.string()));
  constexpr double kFarthestMm = 1e6, kApart = 1e-3;
  if (heights.size() != 2 || !(heights[0] >= -kFarthestMm) || !(heights[1] < 0.0) ||
      !(heights[1] - heights[0] >= -kApart * heights[0]))
    throw ConfigError(
        "--planes", "",
        fmt::format("found {}, allowed: two heights, mm, the farther one first, from {} to below 0 "
                    "(in front of the camera), apart by at least {} of the farther one.",
                    fmt::join(heights, ","), -kFarthestMm, kApart));
  return {heights[0], heights[1]};
}

/// Where the calibration will go, checked before the work: a folder that is new, empty, or holds
/// nothing but an earlier calibration.
void check_output(const fs::path& out) {
  require_writable(out, "the calibration", "--out");
  std::error_code error;
  if (!fs::is_directory(out, error) || fs::is_empty(out, error)) return;
  if (fs::exists(out / "plan.json", error))
    throw ConfigError(out.string(), "",
                      "is the folder of a run, whose poses were judged with the calibration in it. "
                      "Choose a new folder (--out).");
  if (!fs::is_regular_file(out / "calibration.json", error))
    throw ConfigError(out.string(), "",
                      "holds other things than a calibration. Choose a new folder (--out).");
}

/// Calibrations name their source, in JSON.
void check_name(const fs::path& source) {
  try {
    (void)Json(source.string()).dump();
  } catch (const Json::exception&) {
    throw ConfigError(source.string(), "", "has a name that is not UTF-8. Rename it.");
  }
}

void refuse(bool given, const char* option, const char* why) {
  if (given) throw ConfigError(option, "", why);
}

}  // namespace

int calibrate_command(const CalibrateArguments& a) {
  const int asked = order_of(a.order);
  ProgressLine line("calibrating");
  const ImageProgress progress = [&](std::size_t done, std::size_t total) {
    line.update(done, total, "images");
  };
  std::optional<CalibrationSet> set;
  Calibration calibration;
  fs::path out = a.out;
  check_name(a.source);
  refuse(!a.planes_mm.empty() && !is_opencv_file(a.source), "--planes",
         "goes with an OpenCV camera; other sources state their planes.");
  const auto refuse_rig = [&] {
    refuse(!a.rig.empty(), "--rig", "goes with a calibration scenario; this source needs no rig.");
  };
  const auto write_to = [&](const fs::path& by_default) {
    if (out.empty()) out = by_default;
    if (!out.empty()) check_output(out);
  };
  std::error_code error;
  if (fs::is_directory(a.source, error)) {
    refuse_rig();
    const RunFolder folder = RunFolder::open(a.source);
    write_to(fs::path("results") / "calibrations" /
             fs::weakly_canonical(folder.root(), error).filename());
    const RunRecord record = read_run(folder);
    const RigFile rig = rig_of(record);
    set = sweep_set(record, folder, rig, progress);
  } else if (is_opencv_file(a.source)) {
    refuse_rig();
    refuse(asked >= 0, "--order", "is chosen by the misfit when an OpenCV camera is taken over.");
    write_to(fs::path("results") / "calibrations" / a.source.stem());
    const CentralModel model = load_opencv_yaml(a.source);
    calibration =
        calibration_from_central(model, planes_of(a.planes_mm, a.source), a.source.string());
  } else {
    const std::string format = format_of(a.source);
    if (format == "calibration") {
      refuse(asked >= 0, "--order", "goes with images or points; this camera is finished.");
      refuse_rig();
      write_to({});
      calibration = load_calibration(a.source);
    } else if (format == "calibration-set") {
      refuse_rig();
      write_to(fs::path("results") / "calibrations" / a.source.stem());
      set = load_calibration_set(a.source, progress);
    } else if (format == "scenario" && load_scenario(a.source).kind == ScenarioKind::kCalibration) {
      refuse(asked >= 0, "--order",
             "goes with a run folder; a scenario states its own polynomial_order.");
      if (a.rig.empty())
        throw ConfigError("--rig", "", "is missing: a calibration scenario needs a rig to run on.");
      RunArguments run;
      run.scenario = a.source;
      run.rig = a.rig;
      run.out = a.out;
      return run_command(run);
    } else {
      throw ConfigError(a.source.string(), "",
                        "is not a calibration: name a run folder, a calibration scenario, a "
                        "calibration set, a calibration file, or an OpenCV camera (.yml).");
    }
  }
  if (set) {
    if (asked >= 0) set->order = asked;
    calibration = calibrate(*set);
  }
  fmt::print("{}", calibration_text(calibration));
  if (set)
    for (const std::string& remark : set->remarks) fmt::print("{}\n", remark);
  if (!out.empty()) {
    const fs::path report = write_calibration_report(out, calibration, set);
    const std::string file = (out / "calibration.json").string();
    if (fs::is_directory(a.source, error))
      fmt::print("To judge the run's poses with it: turntable evaluate {} --calibration {}\n",
                 a.source.string(), file);
    fmt::print("calibration: {}\nreport: {}\n", file, report.string());
  }
  return kDone;
}

}  // namespace turntable
