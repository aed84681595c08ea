// Images that other programs saved, read as the project's own: 8-bit grey.
#pragma once

#include <filesystem>

#include "src/core/image.h"

namespace turntable {

/// Reads PNG, BMP, TIFF (its first page), PGM, PPM or JPEG, known by content and not by name. Grey
/// is kept, colour becomes luma, and of 16 bits the upper eight are kept (`to_grey`). A file that
/// ends too early is never taken for a dark image. Only PNG carries checksums: altered pixels in
/// the other formats stay unseen.
/// @throws ConfigError naming the file and what to do: missing, damaged, of another kind, or 16-bit
/// pixels that leave the upper bits empty.
Image import_image(const std::filesystem::path& file);

}  // namespace turntable
