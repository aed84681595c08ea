// report.md and report.html: what was measured, how good the camera was, the tables, the figures,
// and what they do not say.
#pragma once

#include <filesystem>

#include "src/report/pdf.h"
#include "src/report/results.h"

namespace turntable {

/// Writes tables/, figures/, report.md and report.html of a run. @param printer begins to load the page, if there is
/// one, as soon as its text and figures are there. @return report.html's path. @throws RecordError.
std::filesystem::path write_report(const RunFolder& folder, const Results& results,
                                   PdfPrinter* printer = nullptr);

}  // namespace turntable
