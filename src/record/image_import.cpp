#include "src/record/image_import.h"

#include <fmt/format.h>

#include <algorithm>
#include <cstdint>
#include <opencv2/core.hpp>
#include <string>
#include <string_view>

#include "src/core/errors.h"
#include "src/core/json_document.h"
#include "src/record/image_archive.h"
#include "src/record/image_decoding.h"

namespace turntable {
namespace {

using namespace std::string_view_literals;

/// libjpeg fills up what a cut file lacks with grey and warns on stderr only, so the end marker is
/// looked for first. Segments are skipped by their length: a preview in one has an end of its own.
bool jpeg_is_whole(std::string_view jpeg) {
  const auto byte = [&](std::size_t at) -> std::size_t {
    return static_cast<unsigned char>(jpeg[at]);
  };
  for (std::size_t at = 2; at + 1 < jpeg.size();) {
    const std::size_t marker = byte(at + 1);
    if (byte(at) != 0xff || marker == 0xff) {  // data, fill
      ++at;
      continue;
    }
    if (marker == 0xd9) return true;
    at += 2;
    const bool bare = marker <= 0x01 || (marker >= 0xd0 && marker <= 0xd8);
    if (!bare && at + 1 < jpeg.size()) at += byte(at) << 8u | byte(at + 1);
  }
  return false;
}

/// What is wrong with the file before a decoder sees it; empty if nothing is. The decoders of BMP,
/// TIFF, PGM and PPM refuse a file that lacks pixels by themselves (the tests cut them all).
std::string complaint(std::string_view bytes) {
  const std::string cut = "the file is cut off. Take the image again or restore it from a copy.";
  if (bytes.empty()) return "the file is empty. Take the image again or restore it from a copy.";
  if (bytes.starts_with("\x89PNG"sv)) return png_complaint(bytes, PngPixels::kAny);
  if (bytes.starts_with("\xff\xd8\xff"sv)) return jpeg_is_whole(bytes) ? "" : cut;
  for (const std::string_view start : {"BM"sv, "II*\0"sv, "MM\0*"sv})
    if (bytes.starts_with(start)) return {};
  if (bytes.size() > 1 && bytes[0] == 'P' && bytes[1] >= '1' && bytes[1] <= '6') return {};
  return "this is no image that is known here. Allowed: PNG, BMP, TIFF, PGM, PPM, JPEG. Convert "
         "it, to 8-bit grey PNG if possible.";
}

/// A camera of 10 or 12 bits whose values were stored as they are, in the lower bits.
std::uint16_t largest(const cv::Mat& pixels) {
  std::uint16_t most = 0;
  for (int v = 0; v < pixels.rows; ++v) {
    const auto* row = pixels.ptr<std::uint16_t>(v);
    most = std::max(most, *std::max_element(row, row + pixels.cols * pixels.channels()));
  }
  return most;
}

}  // namespace

Image import_image(const std::filesystem::path& file) {
  const auto refuse = [&](const std::string& why) -> void {
    throw ConfigError(file.string(), "", why);
  };
  std::string bytes = read_text(file);
  if (const std::string wrong = complaint(bytes); !wrong.empty()) refuse(wrong);
  const auto [pixels, said] = decode_image(bytes);
  if (pixels.empty())
    refuse(fmt::format(
        "the image cannot be decoded: the file is damaged or cut off{}. Take the image again or "
        "restore it from a copy.",
        said.empty() ? "" : " (" + said + ")"));
  const bool deep = pixels.depth() == CV_16U;
  const int channels = pixels.channels();
  if ((!deep && pixels.depth() != CV_8U) || channels == 2 || channels > 4)
    refuse("found pixels that are neither 8-bit nor 16-bit, grey or colour. Convert the image.");
  if (deep && largest(pixels) < 0x1000)
    refuse(fmt::format(
        "found 16-bit pixels of at most {}: the upper bits, which are the ones kept, are empty, as "
        "if the values of a 10-bit or 12-bit camera were stored unshifted. Scale the image so that "
        "white is 65535, or save it with 8 bits.",
        largest(pixels)));
  return to_grey({pixels.data,
                  {pixels.cols, pixels.rows},
                  static_cast<std::ptrdiff_t>(pixels.step[0]),
                  channels,
                  deep ? 16 : 8});
}

}  // namespace turntable
