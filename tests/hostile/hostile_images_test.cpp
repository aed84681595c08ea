// Ten thousand seeded images that no one would wish for, through everything that looks at images.
// Two things may not happen: a crash (this program is built with the address and undefined-behaviour
// sanitizers), and a wrong answer given as right. Finding nothing, and saying why, is fine; that the
// searches do find what is there is held by the kinds that show a target alone.
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <string>
#include <vector>

#include "src/attitude/correspondence.h"
#include "src/core/parallel.h"
#include "src/vision/pattern.h"
#include "src/vision/spots.h"
#include "tests/support/draws.h"
#include "tests/support/test_images.h"

namespace turntable {
namespace {

constexpr int kImages = 10'000;
constexpr ImageSize kSize{240, 180};

enum Kind {
  kEmpty,
  kTiny,
  kUniform,
  kNoise,
  kSaturated,
  kSpeckle,
  kStripes,
  kSixteenBit,
  kColour,
  kPatternAlone,
  kPatternNoisy,
  kPatternHalf,
  kPatternTwice,
  kPatternMirrored,
  kPatternDirty,
  kPatternWrong,
  kTargetAlone,
  kTargetReflections,
  kTargetTwice,
  kTargetHalf,
  kKinds
};

/// 7 x 7 circles with the four bigger ones of the shipped rigs.
PatternConfig pattern_config() {
  PatternConfig p;
  p.columns = p.rows = 7;
  p.origin_column = p.origin_row = 3;
  p.spacing_mm = 10.0;
  p.radius_mm = 2.6;
  p.direction_radius_mm = 4.0;
  p.direction_circles = {{0, 0}, {1, 0}, {0, 2}, {-2, 0}};
  return p;
}

/// Radius of the circle drawn at a lattice position; 0 beyond the pattern. @param wrong moves one
/// bigger circle to where none belongs.
double radius_at(const PatternConfig& p, int column, int row, bool wrong) {
  if (std::abs(column) > 3 || std::abs(row) > 3) return 0.0;
  for (std::size_t i = 0; i < p.direction_circles.size(); ++i) {
    const std::array<int, 2> shown = wrong && i == 2 ? std::array{1, -2} : p.direction_circles[i];
    if (shown[0] == column && shown[1] == row) return p.direction_radius_mm;
  }
  return p.radius_mm;
}

/// The mean over 2 x 2 places of each pixel, noise added. Plain numbers: of what these images cost
/// most is drawing them.
Image draw(const Eigen::Matrix3d& H_px_from_plane, const PatternConfig& p, double noise, bool wrong,
           Random& random) {
  std::array<double, 81> radii;  // columns and rows -4 to 4
  for (int i = 0; i < 81; ++i)
    radii[static_cast<std::size_t>(i)] = radius_at(p, i % 9 - 4, i / 9 - 4, wrong);
  const Eigen::Matrix3d back = H_px_from_plane.inverse() / p.spacing_mm;
  std::array<double, 9> h;
  Eigen::Map<Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(h.data()) = back;
  h[6] *= p.spacing_mm, h[7] *= p.spacing_mm, h[8] *= p.spacing_mm;
  Image image(kSize, 0);
  for (int v = 0; v < kSize.height; ++v) {
    std::uint8_t* const row = image.row(v);
    for (int u = 0; u < kSize.width; ++u) {
      int inside = 0;
      for (int k = 0; k < 4; ++k) {
        const double su = u + (k % 2 - 0.5) / 2.0, sv = v + (k / 2 - 0.5) / 2.0;
        const double w = 1.0 / (h[6] * su + h[7] * sv + h[8]);
        const double x = w * (h[0] * su + h[1] * sv + h[2]), y = w * (h[3] * su + h[4] * sv + h[5]);
        if (!(std::abs(x) < 4.0 && std::abs(y) < 4.0)) continue;
        const int column = static_cast<int>(x + 4.5), line = static_cast<int>(y + 4.5);
        const double dx = p.spacing_mm * (x - (column - 4)), dy = p.spacing_mm * (y - (line - 4));
        const double r = radii[static_cast<std::size_t>(9 * line + column)];
        inside += dx * dx + dy * dy < r * r;
      }
      const double grey = 30.0 + 42.5 * inside + noise * random.normal();
      row[u] = static_cast<std::uint8_t>(std::clamp(grey + 0.5, 0.0, 255.0));
    }
  }
  return image;
}

/// Plane to pixel: turned, tilted up to 40 deg, shifted; v runs down, so that y up is right-handed.
Eigen::Matrix3d random_view(Random& random, double shift_px, bool mirrored) {
  const double turn = random.uniform(-std::numbers::pi, std::numbers::pi);
  const double tilt = random.uniform(-0.7, 0.7), direction = random.uniform(0, std::numbers::pi);
  const Eigen::Matrix3d R =
      (Eigen::AngleAxisd(tilt, Eigen::Vector3d(std::cos(direction), std::sin(direction), 0)) *
       Eigen::AngleAxisd(turn, Eigen::Vector3d::UnitZ()))
          .toRotationMatrix();
  const double f = 400.0, z = random.uniform(190, 260);
  Eigen::Matrix3d K;
  K << f, 0, 0.5 * kSize.width + random.uniform(-shift_px, shift_px), 0, -f,
      0.5 * kSize.height + random.uniform(-shift_px, shift_px), 0, 0, 1;
  Eigen::Matrix3d H;
  H << R.col(0) * (mirrored ? -1.0 : 1.0), R.col(1), Eigen::Vector3d(0, 0, z);
  return K * H;
}

/// Bright smears and dots that belong to nothing.
void add_dirt(Image& image, Random& random, int count) {
  for (int k = 0; k < count; ++k) {
    const double u0 = random.uniform(0, image.width), v0 = random.uniform(0, image.height);
    const double a = random.uniform(1, 6), b = random.uniform(1, 6);
    const double grey = random.uniform(60, 255);
    for (int v = std::max(0, static_cast<int>(v0 - 6));
         v < std::min<int>(image.height, static_cast<int>(v0) + 7); ++v)
      for (int u = std::max(0, static_cast<int>(u0 - 6));
           u < std::min<int>(image.width, static_cast<int>(u0) + 7); ++u)
        if (std::pow((u - u0) / a, 2) + std::pow((v - v0) / b, 2) <= 1.0)
          image.row(v)[u] = static_cast<std::uint8_t>(grey);
  }
}

/// An eighth of the least distance of two circles: a point farther off than this, and than four
/// times the uncertainty that it states (dirt at a circle's edge takes its centre along), is wrong.
constexpr double kSamePx = 1.5;

/// What is true of one image.
struct Truth {
  Image image;
  std::vector<Eigen::Matrix3d> patterns;              ///< plane to pixel of each that is drawn
  std::vector<Eigen::Matrix3d> lattices;              ///< the same, wrong and mirrored ones too
  std::vector<std::vector<Eigen::Vector2d>> targets;  ///< LED pixels of each that is drawn
  bool grid_by_accident = false;  ///< shows bright blobs on a lattice, as many as it happens
};

const TargetModel& target() {
  static const TargetModel model(
      std::vector<Vector3d>{{0, 0, 0}, {40, 0, 12}, {-8, 36, 20}, {-30, -24, 30}});
  return model;
}

struct Camera {
  static constexpr double kFocal = 300.0, kHeight = 350.0;
  static Eigen::Vector2d pixel(const Vector3d& at) {
    return {0.5 * kSize.width + kFocal * at.x() / (kHeight - at.z()),
            0.5 * kSize.height - kFocal * at.y() / (kHeight - at.z())};
  }
  static constexpr RayPlanes kPlanes{0.0, 60.0};
  static Ray ray(const Eigen::Vector2d& px) {
    const auto on = [&](double z) {
      return Vector2d((px.x() - 0.5 * kSize.width) * (kHeight - z) / kFocal,
                      (0.5 * kSize.height - px.y()) * (kHeight - z) / kFocal);
    };
    const Vector2d a = on(kPlanes.a_mm), b = on(kPlanes.b_mm);
    return Ray{a, b};
  }
};

std::vector<Eigen::Vector2d> random_target(Random& random, double reach_mm) {
  const Matrix3d R = (Eigen::AngleAxisd(random.uniform(-3.1, 3.1), Vector3d::UnitZ()) *
                      Eigen::AngleAxisd(random.uniform(-0.5, 0.5), Vector3d::UnitX()) *
                      Eigen::AngleAxisd(random.uniform(-0.5, 0.5), Vector3d::UnitY()))
                         .toRotationMatrix();
  const Vector3d at(random.uniform(-reach_mm, reach_mm), random.uniform(-reach_mm, reach_mm),
                    random.uniform(0, 60));
  std::vector<Eigen::Vector2d> out;
  for (int k = 0; k < target().size(); ++k)
    out.push_back(Camera::pixel(R * target().points().col(k) + at));
  return out;
}

std::vector<BlobAt> blobs_at(const std::vector<Eigen::Vector2d>& px, double peak) {
  std::vector<BlobAt> out;
  for (const auto& p : px) out.push_back({p.x(), p.y(), 1.8, peak});
  return out;
}

Truth make(int index, Random& random) {
  Truth t;
  const Kind kind = static_cast<Kind>(index % kKinds);
  const PatternConfig p = pattern_config();
  const auto pattern = [&](const Eigen::Matrix3d& H, double noise, bool wrong) {
    t.lattices.push_back(H);
    return draw(H, p, noise, wrong, random);
  };
  switch (kind) {
    case kEmpty:
      t.image = Image({index % 3 == 0 ? 0 : 7, index % 3 == 1 ? 7 : 0}, 0);
      break;
    case kTiny: {
      t.image = Image({1 + static_cast<int>(random() % 12), 1 + static_cast<int>(random() % 3)}, 0);
      if (random() % 4 == 0) t.image = Image({1, 1}, 0);
      for (auto& grey : t.image.pixels) grey = static_cast<std::uint8_t>(random());
      break;
    }
    case kUniform:
      t.image = Image(kSize, static_cast<std::uint8_t>(random()));
      break;
    case kNoise:
      t.image = blobs(kSize, {}, random.uniform(0, 255), random.uniform(1, 60), random);
      break;
    case kSaturated:
      t.image = blobs(kSize, {}, 240, 30, random);
      add_dirt(t.image, random, 30);
      break;
    case kSpeckle:
      t.image = Image(kSize, 0);
      for (auto& grey : t.image.pixels)
        grey = random.uniform() < 0.2 ? 255 : static_cast<std::uint8_t>(random() % 40);
      break;
    case kStripes: {
      t.grid_by_accident = true;
      t.image = Image(kSize, 0);
      const double a = random.uniform(0.05, 1.5), b = random.uniform(0.05, 1.5);
      for (int v = 0; v < kSize.height; ++v)
        for (int u = 0; u < kSize.width; ++u)
          t.image.row(v)[u] =
              static_cast<std::uint8_t>(127 + 60 * std::sin(a * u) + 60 * std::sin(b * v));
      break;
    }
    case kSixteenBit: {
      t.patterns.push_back(random_view(random, 0, false));
      const Image shown = pattern(t.patterns[0], 2, false);
      std::vector<std::uint16_t> deep(shown.pixels.begin(), shown.pixels.end());
      const bool shallow = random() % 2 == 0;  // the upper byte is empty: all grey is lost
      for (auto& grey : deep) grey = static_cast<std::uint16_t>(shallow ? grey : grey * 257);
      t.image = to_grey({deep.data(), shown.size(), 2 * kSize.width, 1, 16});
      break;
    }
    case kColour: {
      std::vector<std::uint8_t> bgr(static_cast<std::size_t>(kSize.width * kSize.height * 3));
      for (auto& grey : bgr) grey = static_cast<std::uint8_t>(random());
      t.image = to_grey({bgr.data(), kSize, 3 * kSize.width, 3, 8});
      break;
    }
    case kPatternAlone:
    case kPatternNoisy:
    case kPatternDirty: {
      const auto H = random_view(random, 0, false);
      t.image = pattern(H, kind == kPatternNoisy ? 30 : 2, false);
      if (kind == kPatternDirty) add_dirt(t.image, random, 25);
      t.patterns.push_back(H);
      break;
    }
    case kPatternHalf: {
      const auto H = random_view(random, 110, false);
      t.image = pattern(H, 2, false);
      t.patterns.push_back(H);
      break;
    }
    case kPatternTwice: {
      const auto left = random_view(random, 0, false), right = random_view(random, 0, false);
      const Eigen::Matrix3d half{{0.5, 0, 0}, {0, 0.5, 45}, {0, 0, 1}};
      const Eigen::Matrix3d other{{0.5, 0, 120}, {0, 0.5, 45}, {0, 0, 1}};
      const Eigen::Matrix3d a = half * left, b = other * right;
      const Image one = pattern(a, 2, false), two = pattern(b, 2, false);
      t.image = one;
      for (std::size_t i = 0; i < two.pixels.size(); ++i)
        t.image.pixels[i] = std::max(one.pixels[i], two.pixels[i]);
      t.patterns = {a, b};
      break;
    }
    case kPatternMirrored:
      t.image = pattern(random_view(random, 0, true), 2, false);
      break;
    case kPatternWrong:
      t.image = pattern(random_view(random, 0, false), 2, true);
      break;
    case kTargetAlone:
    case kTargetReflections:
    case kTargetHalf:
    case kTargetTwice: {
      t.targets.push_back(random_target(random, kind == kTargetHalf ? 120 : 30));
      auto at = blobs_at(t.targets[0], 180);
      if (kind == kTargetTwice) {
        t.targets.push_back(random_target(random, 60));
        for (const BlobAt& b : blobs_at(t.targets[1], 180)) at.push_back(b);
      }
      if (kind == kTargetReflections)
        for (std::uint64_t k = 0; k <= random() % 4; ++k)
          at.push_back({random.uniform(0, kSize.width), random.uniform(0, kSize.height),
                        random.uniform(1.2, 3), random.uniform(60, 240)});
      t.image = blobs(kSize, at, 20, 2, random);
      break;
    }
    case kKinds:
      break;
  }
  return t;
}

/// What the searches said of one image; `wrong` holds the answers given as right that are not.
struct Verdict {
  bool pattern_found = false, target_found = false;
  bool pattern_wrong = false, target_wrong = false, grid_wrong = false, dark_wrong = false;
};

/// Are these the points of one of the patterns drawn, all of them?
bool right(const std::vector<PatternPoint>& points, const std::vector<Eigen::Matrix3d>& drawn,
           const Eigen::Matrix2d& turn) {
  return std::ranges::any_of(drawn, [&](const Eigen::Matrix3d& H) {
    return std::ranges::all_of(points, [&](const PatternPoint& c) {
      const Eigen::Vector2d on_plane = turn * c.on_pattern_mm;
      return ((H * on_plane.homogeneous()).hnormalized() - c.centre_px).norm() <
             std::max(kSamePx, 4.0 * c.sigma_px);
    });
  });
}

void judge_patterns(const Truth& truth, Verdict& out) {
  const PatternConfig bright = pattern_config();
  PatternConfig grid = bright, dark = bright;
  grid.kind = PatternKind::kCircleGrid;
  dark.bright = false;

  const PatternSearch search = find_pattern(truth.image, bright);
  out.pattern_found = search.status == PatternStatus::kFound;
  out.pattern_wrong =
      out.pattern_found && !right(search.points, truth.patterns, Eigen::Matrix2d::Identity());

  // A square grid may be read in any quarter turn, and its mirrored or wrong twin is as good.
  const PatternSearch equal = find_pattern(truth.image, grid);
  if (equal.status == PatternStatus::kFound && !truth.grid_by_accident) {
    bool fits = false;
    for (int quarter = 0; quarter < 4; ++quarter)
      for (const double mirror : {1.0, -1.0}) {
        Eigen::Matrix2d turn =
            Eigen::Rotation2Dd(0.5 * std::numbers::pi * quarter).toRotationMatrix();
        turn.col(0) *= mirror;
        fits = fits || right(equal.points, truth.lattices, turn);
      }
    out.grid_wrong = !fits;
  }
  out.dark_wrong = find_pattern(truth.image, dark).status == PatternStatus::kFound;
}

void judge_target(const Truth& truth, Verdict& out) {
  const SpotSearch search = find_spots(truth.image);
  std::vector<Ray> rays;
  for (const Spot& spot : search.spots) rays.push_back(Camera::ray(spot.centre_px));
  if (rays.size() > 12) return;  // a rig file's gates leave no such crowd
  CorrespondenceOptions options;
  options.sigma_mm = 0.05;
  options.max_chance = 1e-4;  // 10,000 images: less than one of them
  options.max_tilt_rad = 0.8;
  options.min_height_mm = -20;
  options.max_height_mm = 80;
  const Correspondence answer = correspond(target(), rays, Camera::kPlanes, options);
  out.target_found = answer.status == CorrespondenceStatus::kMatched;
  if (!out.target_found) return;
  out.target_wrong = std::ranges::none_of(truth.targets, [&](const auto& leds) {
    for (std::size_t k = 0; k < leds.size(); ++k) {
      const int spot = answer.ranked[0].spot_of_point[k];
      if (spot < 0 ||
          (search.spots[static_cast<std::size_t>(spot)].centre_px - leds[k]).norm() > kSamePx)
        return false;
    }
    return true;
  });
}

TEST(HostileImages, NeitherCrashNorGiveAWrongAnswerAsRight) {
  std::vector<Verdict> verdicts(kImages);
  parallel_for(kImages, [&](std::size_t index) {
    Random random = draws_of_this_test(index);
    const Truth truth = make(static_cast<int>(index), random);
    judge_patterns(truth, verdicts[index]);
    judge_target(truth, verdicts[index]);
  });

  std::array<int, kKinds> images{}, patterns{}, targets{};
  for (std::size_t index = 0; index < verdicts.size(); ++index) {
    const std::size_t kind = index % kKinds;
    const Verdict& v = verdicts[index];
    ++images[kind];
    patterns[kind] += v.pattern_found;
    targets[kind] += v.target_found;
    EXPECT_FALSE(v.pattern_wrong) << "pattern, image " << index << ", kind " << kind;
    EXPECT_FALSE(v.grid_wrong) << "grid, image " << index << ", kind " << kind;
    EXPECT_FALSE(v.dark_wrong) << "dark pattern, image " << index << ", kind " << kind;
    EXPECT_FALSE(v.target_wrong) << "target, image " << index << ", kind " << kind;
  }
  for (std::size_t kind = 0; kind < kKinds; ++kind) {
    RecordProperty("found_pattern_" + std::to_string(kind), patterns[kind]);
    RecordProperty("found_target_" + std::to_string(kind), targets[kind]);
  }
  // A search that never finds anything would pass all of the above.
  EXPECT_GT(patterns[kPatternAlone], images[kPatternAlone] * 95 / 100);
  EXPECT_GT(targets[kTargetAlone], images[kTargetAlone] * 95 / 100);
}

}  // namespace
}  // namespace turntable
