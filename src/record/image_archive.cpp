#include "src/record/image_archive.h"

#include <fmt/format.h>
#include <zlib.h>

#include <algorithm>
#include <array>
#include <cstring>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <vector>

#include "src/core/errors.h"
#include "src/core/json_document.h"
#include "src/record/atomic_file.h"
#include "src/record/image_decoding.h"
#include "src/record/sha256.h"

namespace turntable {
namespace {

constexpr std::array<std::string_view, 3> kModeNames{"full", "regions", "none"};

std::uint32_t big_endian(std::string_view bytes, std::size_t at) {
  std::uint32_t value = 0;
  for (std::size_t i = 0; i < 4; ++i)
    value = (value << 8u) | static_cast<unsigned char>(bytes[at + i]);
  return value;
}

std::uint32_t checksum(std::string_view bytes) {
  return static_cast<std::uint32_t>(
      crc32_z(0, reinterpret_cast<const unsigned char*>(bytes.data()), bytes.size()));
}

void append_big_endian(std::string& to, std::size_t value) {
  for (const unsigned shift : {24u, 16u, 8u, 0u}) to += static_cast<char>(value >> shift & 0xffu);
}

void append_chunk(std::string& to, std::string_view type, std::string_view data) {
  append_big_endian(to, data.size());
  const std::size_t begin = to.size();
  to += type;
  to += data;
  append_big_endian(to, checksum(std::string_view(to).substr(begin)));
}

constexpr std::string_view kSignature("\x89PNG\r\n\x1a\n", 8);

/// A PNG whose pixels are copied, not deflated: filter 0, stored blocks (PNG 1.2, 4 and 6; RFC 1951,
/// 3.2.4). OpenCV writes no such file: with level 0 it still tries all filters, for as long as
/// deflating takes.
std::string stored_png(ImageView image) {
  std::string rows;
  rows.reserve((static_cast<std::size_t>(image.width) + 1) *
               static_cast<std::size_t>(image.height));
  for (int v = 0; v < image.height; ++v) {
    rows += '\0';
    rows.append(reinterpret_cast<const char*>(image.row(v)), static_cast<std::size_t>(image.width));
  }
  uLongf size = compressBound(rows.size());
  std::string stored(size, '\0');
  if (compress2(reinterpret_cast<Bytef*>(stored.data()), &size,
                reinterpret_cast<const Bytef*>(rows.data()), rows.size(), Z_NO_COMPRESSION) != Z_OK)
    throw RecordError("an image cannot be encoded as PNG");
  stored.resize(size);

  std::string header;
  append_big_endian(header, static_cast<std::size_t>(image.width));
  append_big_endian(header, static_cast<std::size_t>(image.height));
  header.append("\x08\0\0\0\0", 5);  // 8 bits, grey, not interlaced
  std::string png(kSignature);
  png.reserve(size + 64);
  append_chunk(png, "IHDR", header);
  append_chunk(png, "IDAT", stored);
  append_chunk(png, "IEND", "");
  return png;
}

}  // namespace

std::string_view archive_mode_name(ArchiveMode mode) {
  return kModeNames.at(static_cast<std::size_t>(mode));
}

ArchiveMode archive_mode_from_name(std::string_view name) {
  for (std::size_t i = 0; i < kModeNames.size(); ++i)
    if (kModeNames[i] == name) return static_cast<ArchiveMode>(i);
  throw ConfigError("images", "",
                    fmt::format("found \"{}\", allowed: {}.", name, fmt::join(kModeNames, ", ")));
}

Image keep_regions(ImageView image, std::span<const Region> regions, int margin_px) {
  if (image.empty()) return {};
  std::uint8_t lowest = 255;
  std::uint8_t highest = 0;
  int max_u = 0;
  int max_v = 0;
  for (int v = 0; v < image.height; ++v) {
    const auto [low, high] = std::minmax_element(image.row(v), image.row(v) + image.width);
    lowest = std::min(lowest, *low);
    if (*high > highest || v == 0) {
      highest = *high;
      max_u = static_cast<int>(high - image.row(v));
      max_v = v;
    }
  }
  Image out(image.size(), lowest);
  const auto keep = [&](int left, int top, int right, int bottom) {
    left = std::max(left, 0);
    right = std::min(right, image.width - 1);
    if (left > right) return;
    for (int v = std::max(top, 0); v <= std::min(bottom, image.height - 1); ++v)
      std::copy(image.row(v) + left, image.row(v) + right + 1, out.row(v) + left);
  };
  for (const Region& r : regions)
    keep(r.left - margin_px, r.top - margin_px, r.right + margin_px, r.bottom + margin_px);
  keep(max_u, max_v, max_u, max_v);
  return out;
}

std::string encode_png(ImageView image) {
  // OpenCV's own settings (SUB filter, level 1, run lengths): the smallest of bench "archive" but
  // for one hundredth, and the fastest on images with regions.
  if (image.empty()) throw RecordError("an empty image cannot be archived");
  try {
    const cv::Mat pixels(image.height, image.width, CV_8UC1, const_cast<std::uint8_t*>(image.data),
                         static_cast<std::size_t>(image.stride));
    std::vector<unsigned char> bytes;
    if (!cv::imencode(".png", pixels, bytes))
      throw RecordError("an image cannot be encoded as PNG");
    return {bytes.begin(), bytes.end()};
  } catch (const cv::Exception& e) {
    throw RecordError(std::string("an image cannot be encoded as PNG: ") + e.what());
  }
}

std::string encode_frame(ImageView image) {
  const auto pixels = static_cast<std::int64_t>(image.width) * image.height;
  return pixels > kDeflatedFramePx ? stored_png(image) : encode_png(image);
}

std::string png_complaint(std::string_view png, PngPixels allowed) {
  if (png.empty()) return "the file is empty. Take the image again or restore it from a copy.";
  if (!png.starts_with(kSignature.substr(0, std::min(png.size(), kSignature.size()))))
    return "this is not a PNG image. Convert it to an 8-bit grey PNG.";
  const std::string cut = "the file is cut off. Take the image again or restore it from a copy.";
  std::size_t at = kSignature.size();
  bool first = true;
  for (;;) {
    if (png.size() < at + 12) return cut;
    const std::size_t length = big_endian(png, at);
    if (length > png.size() - at - 12) return cut;
    const std::string_view type_and_data = png.substr(at + 4, 4 + length);
    if (checksum(type_and_data) != big_endian(png, at + 8 + length))
      return "the file is damaged (a checksum inside it is wrong). Take the image again or restore "
             "it from a copy.";
    const std::string_view type = type_and_data.substr(0, 4);
    if (first) {
      if (type != "IHDR" || length != 13)
        return "this is not a PNG image. Convert it to an 8-bit grey PNG.";
      const int depth = static_cast<unsigned char>(type_and_data[12]);
      const int colour = static_cast<unsigned char>(type_and_data[13]);
      if (allowed == PngPixels::kGrey8 && colour != 0)
        return "found a colour, palette or transparent image, allowed: 8-bit grey. Convert it to "
               "grey.";
      if (allowed == PngPixels::kGrey8 && depth != 8)
        return fmt::format(
            "found {} bits per pixel, allowed: 8-bit grey. Convert it, or set the camera to 8 bit.",
            depth);
      first = false;
    }
    if (type == "IEND") return {};
    at += 12 + length;
  }
}

Image load_image(const std::filesystem::path& file, std::string_view sha256) {
  std::string bytes = read_text(file);
  if (const std::string wrong = png_complaint(bytes); !wrong.empty())
    throw ConfigError(file.string(), "", wrong);
  if (!sha256.empty() && sha256_hex(bytes) != sha256)
    throw ConfigError(
        file.string(), "",
        "the image is not the one that was taken: its SHA-256 differs from the journal's. "
        "Restore it from a copy.");
  const auto [pixels, said] = decode_image(bytes);
  if (pixels.empty() || pixels.type() != CV_8UC1)
    throw ConfigError(
        file.string(), "",
        fmt::format("the image cannot be decoded{}. Take it again or restore it from a copy.",
                    said.empty() ? "" : " (" + said + ")"));
  Image out;
  out.width = pixels.cols;
  out.height = pixels.rows;
  out.pixels.reserve(
      pixels.total());  // not zeroed first: decoding is what evaluation takes its time for
  for (int v = 0; v < out.height; ++v)
    out.pixels.insert(out.pixels.end(), pixels.ptr(v), pixels.ptr(v) + pixels.cols);
  return out;
}

}  // namespace turntable
