// What noise in the images does: table, figures 17 and 18 of the paper, and their section of the report.
#pragma once

#include <string>
#include <vector>

#include "src/evaluation/noise_campaign.h"
#include "src/report/drawing.h"
#include "src/report/table.h"

namespace turntable {

/// Writes tables/noise.{csv,md,tex}: one row per sigma and solver. @throws RecordError.
WrittenTable write_noise_table(const RunFolder& folder, const NoiseCampaign& campaign);

/// Writes <folder>/*.csv for:
///   figure17_noise   one LED at every sigma, with the centre found (figure 17); its pixels stay as they
///                    are in the file if the campaign does not have them
///   figure18_noise   errors of the single poses, a panel per sigma (figure 18)
/// @throws RecordError.
std::vector<Draft> noise_drafts(const std::filesystem::path& folder, const NoiseCampaign& campaign);

/// The section "Noise in the images" of report.md. @param written tables of the run, "noise" among them
std::string noise_text(const std::vector<WrittenTable>& written, const RunRecord& record,
                       const NoiseCampaign& campaign);

}  // namespace turntable
