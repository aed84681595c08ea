#include "src/record/image_import.h"

#include <gmock/gmock.h>

#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>

#include "src/core/errors.h"
#include "src/record/image_archive.h"
#include "tests/support/draws.h"
#include "tests/support/temporary_folder.h"
#include "tests/support/test_images.h"

namespace turntable {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

constexpr ImageSize kSize{37, 29};

Image noisy_frame() { return blobs(kSize, {{20, 12, 2, 200}}, 30, 9, draws_of_this_test()); }

/// As another program would save it: grey, the same grey as colour, or as 16 bits.
cv::Mat grey_pixels(Image& image) {
  return {image.height, image.width, CV_8UC1, image.pixels.data()};
}
cv::Mat colour_pixels(Image& image) {
  const cv::Mat grey = grey_pixels(image);
  cv::Mat colour;
  cv::merge(std::vector<cv::Mat>{grey, grey, grey}, colour);
  return colour;
}
cv::Mat deep_pixels(Image& image) {
  cv::Mat deep;
  grey_pixels(image).convertTo(deep, CV_16U, 257);
  return deep;
}

std::string import_complaint(const std::filesystem::path& file) {
  try {
    import_image(file);
    return "none";
  } catch (const ConfigError& e) {
    EXPECT_THAT(e.what(), HasSubstr(file.string()));
    return e.what();
  }
}

std::string little_endian(std::size_t value, std::size_t bytes) {
  std::string out;
  for (std::size_t i = 0; i < bytes; ++i) out += static_cast<char>(value >> (8 * i) & 0xff);
  return out;
}

/// A TIFF whose directory comes before its pixels, as most programs write them (ours does not): a
/// cut takes pixels away and leaves everything that a reader looks for.
std::string tiff_with_pixels_last(Image& image, std::size_t rows_per_strip) {
  const auto width = static_cast<std::size_t>(image.width),
             height = static_cast<std::size_t>(image.height);
  const std::size_t strips = (height + rows_per_strip - 1) / rows_per_strip;
  const std::size_t entries = 9, arrays = 8 + 2 + 12 * entries + 4, data = arrays + 8 * strips;
  std::string out = std::string("II*\0", 4) + little_endian(8, 4) + little_endian(entries, 2);
  const auto entry = [&](std::size_t tag, std::size_t type, std::size_t count, std::size_t value) {
    out += little_endian(tag, 2) + little_endian(type, 2) + little_endian(count, 4) +
           little_endian(value, 4);
  };
  std::string offsets, lengths;
  for (std::size_t i = 0; i < strips; ++i) {
    const std::size_t rows = std::min(rows_per_strip, height - i * rows_per_strip);
    offsets += little_endian(data + i * rows_per_strip * width, 4);
    lengths += little_endian(rows * width, 4);
  }
  entry(256, 3, 1, width);
  entry(257, 3, 1, height);
  entry(258, 3, 1, 8);
  entry(259, 3, 1, 1);
  entry(262, 3, 1, 1);
  entry(273, 4, strips, strips == 1 ? data : arrays);
  entry(277, 3, 1, 1);
  entry(278, 3, 1, rows_per_strip);
  entry(279, 4, strips, strips == 1 ? width * height : arrays + 4 * strips);
  out += little_endian(0, 4) + offsets + lengths;
  return out.append(image.pixels.begin(), image.pixels.end());
}

class ImportImage : public ::testing::Test {
 protected:
  /// Wherever the file is cut, it is refused, or no pixel was lost (a TIFF may end in padding).
  void expect_no_cut_is_accepted(const std::filesystem::path& file) {
    const std::string bytes = slurp(file);
    ASSERT_GT(bytes.size(), 100u) << file;
    const Image whole = import_image(file);
    testing::internal::CaptureStderr();  // the decoders' own complaints
    std::vector<std::size_t> accepted;
    const std::size_t size = bytes.size(), tail = size - 9;
    for (std::size_t length = 0; length < size;
         length = length < tail ? std::min(length + size / 23, tail) : length + 1) {
      spill(folder / "cut", std::string_view(bytes).substr(0, length));
      if (import_complaint(folder / "cut") == "none" &&
          import_image(folder / "cut").pixels != whole.pixels)
        accepted.push_back(length);
    }
    testing::internal::GetCapturedStderr();
    EXPECT_THAT(accepted, IsEmpty()) << file << " of " << size << " bytes";
  }

  TemporaryFolder folder;
};

TEST_F(ImportImage, GivesBackEveryPixelOfEveryLosslessFormatGreyColourOr16Bit) {
  Image image = noisy_frame();
  for (const char* extension : {"png", "bmp", "tif", "pgm", "ppm"})
    for (const cv::Mat& pixels : {grey_pixels(image), colour_pixels(image), deep_pixels(image)}) {
      const std::string kind(extension);
      if (kind == "bmp" && pixels.depth() != CV_8U) continue;
      if (kind == "pgm" && pixels.channels() != 1) continue;
      if (kind == "ppm" && pixels.channels() != 3) continue;
      const auto file = folder / ("image." + kind);
      ASSERT_TRUE(cv::imwrite(file.string(), pixels));
      const Image back = import_image(file);
      EXPECT_EQ(back.size(), kSize) << kind;
      EXPECT_EQ(back.pixels, image.pixels) << kind << " of type " << pixels.type();
    }
  spill(folder / "by_hand.tif", tiff_with_pixels_last(image, 8));
  EXPECT_EQ(import_image(folder / "by_hand.tif").pixels, image.pixels);
}

TEST_F(ImportImage, ReadsJpegToWithinItsLoss) {
  Image image(kSize, 80);
  cv::imwrite((folder / "a.jpg").string(), colour_pixels(image));
  for (const std::uint8_t grey : import_image(folder / "a.jpg").pixels) EXPECT_NEAR(grey, 80, 1);
}

TEST_F(ImportImage, AgreesWithTheArchivesOwnReaderOnItsOwnFiles) {
  spill(folder / "a.png", encode_png(noisy_frame()));
  EXPECT_EQ(import_image(folder / "a.png").pixels, load_image(folder / "a.png").pixels);
}

TEST_F(ImportImage, GoesByContentAndNotByName) {
  Image image = noisy_frame();
  cv::imwrite((folder / "a.bmp").string(), grey_pixels(image));
  std::filesystem::rename(folder / "a.bmp", folder / "a.png");
  EXPECT_EQ(import_image(folder / "a.png").pixels, image.pixels);
}

TEST_F(ImportImage, RefusesAFileCutOffAnywhereInEveryFormat) {
  Image image = noisy_frame();
  for (const char* name : {"a.png", "a.bmp", "a.tif", "a.pgm", "a.jpg"}) {
    cv::imwrite((folder / name).string(), grey_pixels(image));
    expect_no_cut_is_accepted(folder / name);
  }
  for (const char* name : {"c.png", "c.bmp", "c.tif", "c.ppm", "c.jpg"}) {
    cv::imwrite((folder / name).string(), colour_pixels(image));
    expect_no_cut_is_accepted(folder / name);
  }
  for (const char* name : {"d.png", "d.tif", "d.pgm"}) {
    cv::imwrite((folder / name).string(), deep_pixels(image));
    expect_no_cut_is_accepted(folder / name);
  }
  cv::imwrite((folder / "progressive.jpg").string(), grey_pixels(image),
              {cv::IMWRITE_JPEG_PROGRESSIVE, 1});
  expect_no_cut_is_accepted(folder / "progressive.jpg");
  for (const std::size_t rows : {8u, 29u}) {
    spill(folder / "pixels_last.tif", tiff_with_pixels_last(image, rows));
    expect_no_cut_is_accepted(folder / "pixels_last.tif");
  }
}

TEST_F(ImportImage, IsNotDeceivedByThePreviewInsideAJpeg) {
  Image image = noisy_frame();
  cv::imwrite((folder / "a.jpg").string(), grey_pixels(image));
  const std::string jpeg = slurp(folder / "a.jpg");
  const std::string preview = std::string("preview\0", 8) + jpeg;
  const std::size_t length = preview.size() + 2;
  std::string with = jpeg.substr(0, 2) + "\xff\xe5";
  with += static_cast<char>(length >> 8);
  with += static_cast<char>(length & 0xff);
  with += preview + jpeg.substr(2);
  spill(folder / "with.jpg", with);
  expect_no_cut_is_accepted(folder / "with.jpg");
}

TEST_F(ImportImage, RefusesAFlippedBitInAColourPng) {
  Image image = noisy_frame();
  cv::imwrite((folder / "a.png").string(), colour_pixels(image));
  std::string bytes = slurp(folder / "a.png");
  bytes[bytes.size() / 2] = static_cast<char>(bytes[bytes.size() / 2] ^ 0x10);
  spill(folder / "a.png", bytes);
  EXPECT_THAT(import_complaint(folder / "a.png"), HasSubstr("damaged"));
}

TEST_F(ImportImage, RefusesTwelveBitsStoredUnshifted) {
  cv::imwrite((folder / "a.tif").string(), cv::Mat(8, 8, CV_16UC1, cv::Scalar(4095)));
  EXPECT_THAT(import_complaint(folder / "a.tif"),
              AllOf(HasSubstr("at most 4095"), HasSubstr("Scale")));
}

TEST_F(ImportImage, RefusesWhatIsNoImageOrHasOtherPixels) {
  spill(folder / "text.png", "not an image");
  EXPECT_THAT(import_complaint(folder / "text.png"), HasSubstr("Allowed: PNG, BMP"));
  spill(folder / "empty.png", "");
  EXPECT_THAT(import_complaint(folder / "empty.png"), HasSubstr("empty"));
  EXPECT_THAT(import_complaint(folder / "missing.png"), HasSubstr("cannot be read"));
  cv::imwrite((folder / "float.tif").string(), cv::Mat(8, 8, CV_32FC1, cv::Scalar(0.5)));
  EXPECT_THAT(import_complaint(folder / "float.tif"), HasSubstr("neither 8-bit nor 16-bit"));
}

}  // namespace
}  // namespace turntable
