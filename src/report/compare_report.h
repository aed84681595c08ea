// Two runs side by side: tables, figure, comparison.md and comparison.html in a folder of their own.
#pragma once

#include <array>
#include <filesystem>
#include <string>
#include <vector>

#include "src/evaluation/run_comparison.h"
#include "src/report/pdf.h"

namespace turntable {

/// What a page is called that compares the two.
struct ComparedRun {
  std::string name;       ///< of its folder
  std::string folder;     ///< where it is, as it was named
  std::string began_utc;  ///< empty if its journal does not say
  bool simulated = false;
};

/// Writes comparison.{md,html}, tables/ {comparison,bias,differences,scenarios} and figures/.
/// @param facts what differs between the runs. @param printer as of `write_report`.
/// @return comparison.html's path. @throws RecordError.
std::filesystem::path write_comparison(const std::filesystem::path& folder,
                                       const std::array<ComparedRun, 2>& runs,
                                       const std::vector<RunFact>& facts,
                                       const RunComparison& comparison,
                                       PdfPrinter* printer = nullptr);

}  // namespace turntable
