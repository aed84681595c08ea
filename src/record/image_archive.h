// Images on disk: 8-bit grey PNG, lossless, written atomically.
#pragma once

#include <filesystem>
#include <span>
#include <string>
#include <string_view>

#include "src/core/image.h"

namespace turntable {

enum class ArchiveMode {
  kFull,     ///< every pixel
  kRegions,  ///< the same size, but only boxes of interest; LED images shrink a hundredfold
  kNone,     ///< no image is written; spots stay in the journal
};
std::string_view archive_mode_name(ArchiveMode mode);  ///< "full", "regions", "none"
/// @throws ConfigError listing the modes.
ArchiveMode archive_mode_from_name(std::string_view name);

/// Around each spot: enough for the background and noise that the spot's own uncertainty is taken
/// from.
constexpr int kRegionMarginPx = 16;

/// Pixel rectangle, both ends included.
struct Region {
  int left = 0, top = 0, right = -1, bottom = -1;
};

/// The image with everything farther than `margin_px` from all regions set to its smallest grey
/// value. One pixel at its largest is kept wherever it is, so that minimum, maximum and therefore
/// the threshold stay the same.
Image keep_regions(ImageView image, std::span<const Region> regions, int margin_px);

/// The bytes of a PNG file, deflated. @throws RecordError if encoding fails.
std::string encode_png(ImageView image);

/// Frames of more pixels are stored: deflating noise takes 12 ms per megapixel, and a 30 Hz camera
/// leaves one core 33 ms for that, for finding spots and for the disk (bench "archive").
constexpr int kDeflatedFramePx = 1'600'000;

/// The bytes of a PNG file for a whole frame with its noise, at the pace of a 30 Hz camera: deflated
/// to half of the pixels' size, or beyond `kDeflatedFramePx` stored as they are. @throws RecordError
/// if encoding fails.
std::string encode_frame(ImageView image);

enum class PngPixels { kGrey8, kAny };

/// What is wrong with the bytes of a PNG file; empty if nothing is. libpng hands out what it has got
/// of a cut file and complains on stderr only, so the chunks are walked before it sees them.
std::string png_complaint(std::string_view png, PngPixels allowed = PngPixels::kGrey8);

/// Reads an 8-bit grey PNG. The file is checked chunk by chunk before it is decoded, so a truncated
/// or altered one is never taken for a dark image. @param sha256 if not empty, the file's bytes
/// must have this hash.
/// @throws ConfigError naming the file and what to do.
Image load_image(const std::filesystem::path& file, std::string_view sha256 = {});

}  // namespace turntable
