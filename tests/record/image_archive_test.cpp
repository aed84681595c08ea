#include "src/record/image_archive.h"

#include <gmock/gmock.h>

#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>

#include "src/core/errors.h"
#include "src/record/atomic_file.h"
#include "src/record/image_import.h"
#include "src/record/sha256.h"
#include "tests/support/draws.h"
#include "tests/support/file_size_limit.h"
#include "tests/support/temporary_folder.h"
#include "tests/support/test_images.h"

namespace turntable {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

Image noisy() { return blobs({97, 61}, {{40, 30, 2, 200}}, 20, 3, draws_of_this_test()); }

std::string complaint_about(const std::filesystem::path& file, std::string_view sha256 = {}) {
  try {
    load_image(file, sha256);
    return "none";
  } catch (const ConfigError& e) {
    EXPECT_THAT(e.what(), HasSubstr(file.string()));
    return e.what();
  }
}

/// As the archive does it: encode, write atomically, keep the hash.
std::string write_image(const std::filesystem::path& file, ImageView image) {
  const std::string png = encode_png(image);
  write_atomically(file, png);
  return sha256_hex(png);
}

TEST(ImageArchive, GivesBackEveryPixel) {
  const TemporaryFolder folder;
  const Image image = noisy();
  const std::string hash = write_image(folder / "a.png", image);
  EXPECT_EQ(hash, sha256_hex(slurp(folder / "a.png")));
  const Image back = load_image(folder / "a.png", hash);
  EXPECT_EQ(back.size(), image.size());
  EXPECT_EQ(back.pixels, image.pixels);
}

TEST(ImageArchive, StoresAFrameTooLargeToDeflateInTime) {
  const TemporaryFolder folder;
  // Rows longer than a stored block of deflate, so that blocks end within rows.
  const ImageSize size{0x10000, kDeflatedFramePx / 0x10000 + 1};
  Image image(size, 0);
  Random random = draws_of_this_test();
  for (std::uint8_t& grey : image.pixels) grey = static_cast<std::uint8_t>(random.uniform(0, 256));
  const std::string png = encode_frame(image);
  EXPECT_GT(png.size(), image.pixels.size());
  EXPECT_LT(static_cast<double>(png.size()), 1.001 * static_cast<double>(image.pixels.size()));
  spill(folder / "a.png", png);
  EXPECT_EQ(load_image(folder / "a.png").pixels, image.pixels);
  EXPECT_EQ(import_image(folder / "a.png").pixels, image.pixels);
  for (const std::size_t length : {std::size_t{7}, png.size() / 2, png.size() - 1})
    EXPECT_THAT(png_complaint(std::string_view(png).substr(0, length)), HasSubstr("cut off"));
  std::string altered = png;
  altered[png.size() / 3] = static_cast<char>(altered[png.size() / 3] ^ 1);
  EXPECT_THAT(png_complaint(altered), HasSubstr("damaged"));

  EXPECT_EQ(encode_frame(noisy()), encode_png(noisy()));
}

TEST(ImageArchive, RefusesAFileCutOffAnywhere) {
  const TemporaryFolder folder;
  write_image(folder / "a.png", noisy());
  const std::string bytes = slurp(folder / "a.png");
  EXPECT_THAT((spill(folder / "cut.png", ""), complaint_about(folder / "cut.png")),
              HasSubstr("empty"));
  for (std::size_t length = 1; length < bytes.size(); length += 7) {
    spill(folder / "cut.png", std::string_view(bytes).substr(0, length));
    ASSERT_THAT(complaint_about(folder / "cut.png"), HasSubstr("cut off")) << length;
  }
}

TEST(ImageArchive, RefusesAFlippedBit) {
  const TemporaryFolder folder;
  const std::string hash = write_image(folder / "a.png", noisy());
  std::string bytes = slurp(folder / "a.png");
  bytes[bytes.size() / 2] = static_cast<char>(bytes[bytes.size() / 2] ^ 0x10);
  spill(folder / "a.png", bytes);
  EXPECT_THAT(complaint_about(folder / "a.png"), HasSubstr("damaged"));
}

TEST(ImageArchive, RefusesAnotherImageThanTheOneTaken) {
  const TemporaryFolder folder;
  const std::string hash = write_image(folder / "a.png", noisy());
  write_image(folder / "a.png", Image({97, 61}, 9));
  EXPECT_THAT(complaint_about(folder / "a.png", hash), HasSubstr("SHA-256"));
}

TEST(ImageArchive, RefusesColour16BitAndOtherFormatsAndSaysWhatToDo) {
  const TemporaryFolder folder;
  cv::imwrite((folder / "colour.png").string(), cv::Mat(8, 8, CV_8UC3, cv::Scalar(1, 2, 3)));
  cv::imwrite((folder / "deep.png").string(), cv::Mat(8, 8, CV_16UC1, cv::Scalar(999)));
  cv::imwrite((folder / "photo.bmp").string(), cv::Mat(8, 8, CV_8UC1, cv::Scalar(9)));
  spill(folder / "text.png", "not an image");
  EXPECT_THAT(complaint_about(folder / "colour.png"),
              AllOf(HasSubstr("colour"), HasSubstr("Convert")));
  EXPECT_THAT(complaint_about(folder / "deep.png"),
              AllOf(HasSubstr("16 bits"), HasSubstr("Convert")));
  EXPECT_THAT(complaint_about(folder / "photo.bmp"),
              AllOf(HasSubstr("not a PNG"), HasSubstr("Convert")));
  EXPECT_THAT(complaint_about(folder / "text.png"), HasSubstr("not a PNG"));
  EXPECT_THAT(complaint_about(folder / "missing.png"), HasSubstr("cannot be read"));
  EXPECT_THAT(complaint_about(folder.path()), HasSubstr("is a folder"));
}

TEST(ImageArchive, LeavesNothingBehindWhenTheDiskIsFull) {
  const TemporaryFolder folder;
  {
    const FileSizeLimit limit(500);
    EXPECT_THROW(write_image(folder / "a.png", noisy()), RecordError);
  }
  EXPECT_TRUE(std::filesystem::is_empty(folder.path()));
}

TEST(KeepRegions, KeepsTheBoxesTheSmallestAndTheLargestValue) {
  Image image = noisy();
  image.row(3)[90] = 255;  // a hot pixel far from the region
  image.row(50)[5] = 1;
  const std::vector<Region> regions{{38, 28, 42, 32}, {90, 55, 96, 60}};
  const Image kept = keep_regions(image, regions, 4);
  for (int v = 0; v < image.height; ++v)
    for (int u = 0; u < image.width; ++u) {
      const bool inside = (u >= 34 && u <= 46 && v >= 24 && v <= 36) || (u >= 86 && v >= 51);
      const bool hottest = u == 90 && v == 3;
      ASSERT_EQ(int{ImageView(kept).row(v)[u]}, inside || hottest ? int{image.row(v)[u]} : 1)
          << u << ", " << v;
    }
}

TEST(KeepRegions, WithoutRegionsKeepsOnlyTheExtremes) {
  const Image image = noisy();
  const Image kept = keep_regions(image, {}, 4);
  const auto [low, high] = std::ranges::minmax(image.pixels);
  EXPECT_EQ(std::ranges::count(kept.pixels, low), std::ssize(kept.pixels) - 1);
  EXPECT_EQ(std::ranges::count(kept.pixels, high), 1);
  EXPECT_TRUE(keep_regions(ImageView{}, {}, 4).pixels.empty());
}

TEST(ArchiveMode, IsReadByNameOrRefusedWithTheNames) {
  EXPECT_EQ(archive_mode_from_name("regions"), ArchiveMode::kRegions);
  try {
    archive_mode_from_name("some");
    FAIL() << "no error";
  } catch (const ConfigError& e) {
    EXPECT_THAT(e.what(), HasSubstr("full, regions, none"));
  }
}

}  // namespace
}  // namespace turntable
