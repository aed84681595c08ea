// What the verbs that measure attitudes print: tables, JSON, and where they go
// (results/README.md, "Output of solve, measure and track").
#pragma once

#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "src/app/commands.h"
#include "src/evaluation/measure_spots.h"
#include "src/geometry/gimbal.h"
#include "src/record/csv.h"

namespace turntable {

/// Yaw, roll, pitch as the published turntable turns them: R = Rz(yaw) Ry(roll) Rx(pitch).
const Gimbal& default_gimbal();

/// One frame or image.
struct AttitudeLine {
  std::string name;
  TargetMeasurement measurement;
};

/// @param first what names a line: "frame" or "file"
std::vector<std::string> attitude_columns(const std::string& first, std::string_view residual_unit);
/// The cells of a line, without its end.
void add_attitude_cells(Csv& csv, const AttitudeLine& line);

/// Writes to standard output at once. @return false if nobody reads it any more, as behind "| head".
/// @throws RecordError: it cannot be written (disk full, closed).
bool print_out(std::string_view text);

/// --out, checked before the work. @throws ConfigError: a folder, in no folder, or one of the inputs.
void check_out(const AttitudeArguments& a, std::span<const std::filesystem::path> inputs);

/// What frames that end as kDoesNotFit have in common, said once.
void hint_at_misfit();

/// Prints or writes all lines. @return exit code.
int put_attitudes(const AttitudeArguments& a, const AttitudeSensor& sensor,
                  double target_uncertainty_mm, const std::string& first,
                  std::span<const AttitudeLine> lines);

}  // namespace turntable
