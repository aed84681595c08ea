// Is a run still what was recorded? Reads everything, changes nothing.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "src/record/run_folder.h"

namespace turntable {

struct RunFindings {
  std::vector<std::string> damage;      ///< each names file and place, what was found, what to do
  std::vector<std::string> remarks;     ///< what is unusual and harms nothing
  std::size_t lines = 0;                ///< of the journal
  std::size_t images = 0;               ///< that were checked
  std::size_t outputs = 0;              ///< files that were made again and compared
  std::vector<std::size_t> lost_poses;  ///< places in the plan whose images are missing or altered

  bool sound() const { return damage.empty(); }
};

using VerifyProgress = std::function<void(std::size_t done, std::size_t total)>;

/// Images of the poses that count, by SHA-256, on all cores.
void verify_images(const RunFolder& folder, const RunState& state, RunFindings& findings,
                   const VerifyProgress& progress = {});

/// All of it: plan and frozen copies, journal (sequence, CRC, documents after the event model, order
/// of the documents), plan and journal against each other, images. Files in images/ that no line of
/// the journal names are remarked: a run that was killed leaves the last ones. Damage that keeps the journal from
/// being read is the last finding.
RunFindings verify_run(const RunFolder& folder, const VerifyProgress& progress = {});

/// Files that follow from a run, made again elsewhere, against those that are stored: byte for byte,
/// by the names below `stored` and `again` (files, or folders of files). What differs, is missing or
/// is there beside is damage that names the file and, of a text, the first line that differs.
/// @param advice what to do about it; ends the message.
void compare_outputs(const std::filesystem::path& stored, const std::filesystem::path& again,
                     const std::string& advice, RunFindings& findings);

}  // namespace turntable
