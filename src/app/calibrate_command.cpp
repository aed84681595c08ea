// "turntable calibrate": a camera from whatever there is: a run, a sweep still to be taken, images
// or points of a lab, an OpenCV camera, a finished calibration.
#include <fmt/format.h>

#include <algorithm>

#include "src/app/commands.h"
#include "src/app/progress.h"
#include "src/campaign/scenario.h"
#include "src/core/errors.h"
#include "src/core/json_document.h"
#include "src/evaluation/calibrate.h"
#include "src/imaging/opencv_yaml.h"
#include "src/report/calibration_report.h"

namespace turntable {
namespace {

namespace fs = std::filesystem;

bool is_opencv_file(const fs::path& file) {
  const std::string ending = file.extension().string();
  return ending == ".yml" || ending == ".yaml" || ending == ".xml";
}

/// Words for --order; 0 = not given.
int order_of(const std::string& text) {
  if (text.empty()) return -1;
  if (text == "auto") return kOrderByResiduals;
  if (text.size() == 1 && text[0] >= '1' && text[0] <= '9') return text[0] - '0';
  throw ConfigError("--order", "", fmt::format("found \"{}\", allowed: 1 to 9, or auto.", text));
}

RayPlanes planes_of(const std::vector<double>& heights, const fs::path& file) {
  if (heights.empty())
    throw ConfigError("--planes", "",
                      fmt::format("is missing: {} says nothing of depths. Give two heights in the "
                                  "camera's frame, mm, negative in front of it: --planes -800,-600.",
                                  file.string()));
  if (heights.size() != 2 || !(heights[0] < heights[1]) || !(heights[1] < 0.0))
    throw ConfigError("--planes", "",
                      fmt::format("found {} height(s), allowed: two, the farther one first, both "
                                  "negative (in front of the camera), mm.",
                                  heights.size()));
  return {heights[0], heights[1]};
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
  if (fs::is_directory(a.source)) {
    const RunFolder folder = RunFolder::open(a.source);
    const RunRecord record = read_run(folder);
    const RigFile rig = parse_rig_file(record.plan.rig.text, record.plan.rig.file, folder.root());
    set = sweep_set(record, folder, rig, progress);
    if (out.empty()) out = folder.root();
  } else if (is_opencv_file(a.source)) {
    refuse(asked >= 0, "--order", "is chosen by the misfit when an OpenCV camera is taken over.");
    const CentralModel model = load_opencv_yaml(a.source);
    calibration =
        calibration_from_central(model, planes_of(a.planes_mm, a.source), a.source.string());
    if (out.empty()) out = fs::path("results") / "calibrations" / a.source.stem();
  } else {
    const std::string format = format_of(a.source);
    if (format == "calibration") {
      refuse(asked >= 0, "--order", "goes with images or points; this camera is finished.");
      calibration = load_calibration(a.source);
    } else if (format == "calibration-set") {
      set = load_calibration_set(a.source, progress);
      if (out.empty()) out = fs::path("results") / "calibrations" / a.source.stem();
    } else if (format == "scenario" &&
               load_scenario(a.source).kind == ScenarioKind::kCalibration) {
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
  refuse(!a.planes_mm.empty() && !is_opencv_file(a.source), "--planes",
         "goes with an OpenCV camera; other sources state their planes.");
  if (set) {
    if (asked >= 0) set->order = asked;
    calibration = calibrate(*set);
  }
  fmt::print("{}", calibration_text(calibration));
  if (set)
    for (const std::string& remark : set->remarks) fmt::print("{}\n", remark);
  if (!out.empty()) {
    const fs::path report = write_calibration_report(out, calibration, set);
    fmt::print("calibration: {}\nreport: {}\n", (out / "calibration.json").string(),
               report.string());
  }
  return kDone;
}

}  // namespace turntable
