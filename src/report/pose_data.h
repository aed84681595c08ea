// What the page of a run shows of single poses: angles and errors, the image with its spots.
#pragma once

#include "src/core/json_document.h"
#include "src/evaluation/evaluate.h"
#include "src/record/run_folder.h"

namespace turntable {

/// For `write_html`:
///   solvers    [{name, colour, default}], in the table's order
///   scenarios  names
///   image      [width, height] in px, of those that were archived
///   poses      one object per taken pose:
///     i, s, r, p   index in the plan, scenario, repeat, point
///     a            yaw, roll, pitch as read back, deg
///     f            image, relative to the run folder; left out if there is none
///     m            [u, v] of the matched spots in the target's order, px; or, if they were not matched,
///     q            those of all spots that were found
///     o            1 if a spot lies outside the calibrated area
///     e            per solver [yaw, roll, pitch, geodesic] error in deg, or why there is none
///   pictures   {index: {src, side, corners}}: the matched spots cut out of the image, `side` px wide
///              and high each, left to right in one PNG (a data URI); of the worst poses of every
///              default solver and of one per scenario, if the images are there and as they were
Json pose_data(const RunFolder& folder, const RunRecord& record, const Evaluation& evaluation);

}  // namespace turntable
