#include "src/core/stage_spec.h"

#include <algorithm>

namespace turntable {
namespace {

using enum StageKind;

// Worm 180:1, 1600 pulses per revolution = 0.00125 deg per pulse and 25 deg/s are what public
// drivers of such tables use; 0.005 deg and 3 um repeatability are the paper's. Data sheets of the
// RAK and TSA series were not at hand: backlash and ramps are assumptions, to be overridden by the
// rig file once measured.
constexpr StageSpec kStageSpecs[] = {
    // model            kind     steps ratio lead  travel     v0   v     a    vhome repeat backlash endless
    // source
    {"zolix-tsa200", kLinear, 1600, 1, 4.0, -2, 202, 1.0, 20, 50, 5, 0.003, 0.05, false,
     "3 um: paper; lead: assumed"},
    {"zolix-rak200", kRotary, 1600, 180, 0, -180, 180, 1.0, 25, 50, 5, 0.005, 0.5, true,
     "180:1: public drivers; 0.005 deg: paper"},
    {"zolix-rak100", kRotary, 1600, 180, 0, -180, 180, 1.0, 25, 50, 5, 0.005, 0.5, true,
     "180:1: public drivers; 0.005 deg: paper"},
};

}  // namespace

std::span<const StageSpec> stage_specs() { return kStageSpecs; }

const StageSpec* find_stage_spec(std::string_view model) {
  const auto* row = std::ranges::find(kStageSpecs, model, &StageSpec::model);
  return row == std::end(kStageSpecs) ? nullptr : row;
}

}  // namespace turntable
