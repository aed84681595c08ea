#include "drivers/sim/render.h"

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <boost/math/special_functions/erf.hpp>
#include <cmath>

#include "src/core/random.h"

namespace turntable::sim {
namespace {

constexpr std::size_t kQuantiles = 1u << 16;

double gaussian_cdf(double x) { return 0.5 * std::erfc(-x * std::numbers::sqrt2 / 2.0); }

struct Box {
  int left, top, right, bottom;
};

/// Pixels within `margin` of the points, clipped to the image.
Box box_around(const std::vector<Vector2d>& points, double margin, ImageSize size) {
  Vector2d low = points.front(), high = points.front();
  for (const Vector2d& p : points) {
    low = low.cwiseMin(p);
    high = high.cwiseMax(p);
  }
  const auto clip = [](double x, int end) {
    return static_cast<int>(std::clamp(x, -1.0, end + 0.0));
  };
  return {std::max(0, clip(std::floor(low.x() - margin), size.width)),
          std::max(0, clip(std::floor(low.y() - margin), size.height)),
          std::min(size.width - 1, clip(std::ceil(high.x() + margin), size.width)),
          std::min(size.height - 1, clip(std::ceil(high.y() + margin), size.height))};
}

}  // namespace

Renderer::Renderer(const World& world) : world_(world), size_(world.image_size()) {
  normal_table_.resize(kQuantiles);
  for (std::size_t i = 0; i < kQuantiles; ++i) {
    const double p = (static_cast<double>(i) + 0.5) / kQuantiles;
    normal_table_[i] =
        static_cast<float>(std::numbers::sqrt2 * boost::math::erf_inv(2.0 * p - 1.0));
  }
}

Image Renderer::render(std::uint64_t frame) {
  const bool leds = world_.payload() == Payload::kLedTarget;
  const ImageTruth& truth = world_.image_truth();
  const double ground = leds                      ? truth.background_grey
                        : world_.pattern().bright ? truth.circle_dark_grey
                                                  : truth.circle_bright_grey;
  signal_.assign(static_cast<std::size_t>(size_.width) * static_cast<std::size_t>(size_.height),
                 static_cast<float>(ground));
  if (leds)
    draw_leds();
  else
    draw_pattern();
  return expose(frame);
}

// A disc is cut into cells small against the point spread; each cell spreads its own projected area
// from its own projected centroid, so that perspective and distortion within the disc are exact,
// not its ellipse's.
void Renderer::draw_leds() {
  constexpr int kRings = 4, kSpokes = 16;
  const ImageTruth& truth = world_.image_truth();
  const double gain = truth.led_peak_grey - truth.background_grey;
  const double reach = 5.0 * truth.blur_px + 1.0;
  std::vector<double> across, down;
  for (const Disc& disc : world_.discs()) {
    if (disc.centre.z() <= 0) continue;
    std::array<std::array<Vector2d, kSpokes>, kRings + 1> edge;
    for (int ring = 0; ring <= kRings; ++ring)
      for (int spoke = 0; spoke < kSpokes; ++spoke) {
        const double radius = static_cast<double>(ring) / kRings;
        const double angle = 2.0 * std::numbers::pi * spoke / kSpokes;
        edge[static_cast<std::size_t>(ring)][static_cast<std::size_t>(spoke)] =
            world_.lens().project(disc.centre + radius * (std::cos(angle) * disc.across +
                                                          std::sin(angle) * disc.down));
      }
    // A polygon of 16 corners is smaller than its circle.
    constexpr double kPolygonArea =
        std::numbers::pi / (0.5 * kSpokes * 0.38268343236508977);  // sin(2 pi / 16)
    for (std::size_t ring = 0; ring < kRings; ++ring)
      for (std::size_t spoke = 0; spoke < kSpokes; ++spoke) {
        const std::size_t next = (spoke + 1) % kSpokes;
        const std::array corners{edge[ring][spoke], edge[ring + 1][spoke], edge[ring + 1][next],
                                 edge[ring][next]};
        double area = 0.0;
        Vector2d moment = Vector2d::Zero();
        for (std::size_t i = 0; i < 4; ++i) {
          const Vector2d& a = corners[i] - corners[0];
          const Vector2d& b = corners[(i + 1) % 4] - corners[0];
          const double cross = 0.5 * (a.x() * b.y() - a.y() * b.x());
          area += cross;
          moment += cross * (a + b) / 3.0;
        }
        const Vector2d centre = corners[0] + moment / area;
        const Box box = box_around({centre}, reach, size_);
        const auto weights = [&](int first, int last, double at, std::vector<double>& out) {
          out.clear();
          double lower = gaussian_cdf((first - 0.5 - at) / truth.blur_px);
          for (int i = first; i <= last; ++i) {
            const double upper = gaussian_cdf((i + 0.5 - at) / truth.blur_px);
            out.push_back(upper - lower);
            lower = upper;
          }
        };
        weights(box.left, box.right, centre.x(), across);
        weights(box.top, box.bottom, centre.y(), down);
        const double light = gain * std::abs(area) * kPolygonArea;
        for (std::size_t j = 0; j < down.size(); ++j) {
          float* row = &signal_[(static_cast<std::size_t>(box.top) + j) *
                                    static_cast<std::size_t>(size_.width) +
                                static_cast<std::size_t>(box.left)];
          const double rowlight = light * down[j];
          for (std::size_t i = 0; i < across.size(); ++i)
            row[i] += static_cast<float>(rowlight * across[i]);
        }
      }
  }
}

void Renderer::draw_pattern() {
  if (rays_.empty()) {
    rays_.reserve(signal_.size());
    for (int v = 0; v < size_.height; ++v)
      for (int u = 0; u < size_.width; ++u) rays_.push_back(world_.lens().ray({u, v}));
  }
  pose_ = world_.payload_pose();
  for (const Disc& disc : world_.discs()) {
    if (disc.centre.z() <= 0) continue;
    const Vector3d on_payload =
        pose_.R_camera_from_payload.transpose() * (disc.centre - pose_.origin_in_camera);
    draw_circle(disc, disc.across.norm(), on_payload.head<2>());
  }
}

// Signed distance of each pixel from the circle's edge, measured on the pattern itself and turned
// into pixels by the local scale; the point spread makes a Gaussian step of it.
void Renderer::draw_circle(const Disc& disc, double radius_mm, const Vector2d& centre) {
  const ImageTruth& truth = world_.image_truth();
  const double sigma =
      std::sqrt(truth.blur_px * truth.blur_px + 1.0 / 12.0);  // the pixel's own box
  std::vector<Vector2d> outline;
  for (int i = 0; i < 16; ++i) {
    const double angle = 2.0 * std::numbers::pi * i / 16;
    outline.push_back(world_.lens().project(disc.centre + std::cos(angle) * disc.across +
                                            std::sin(angle) * disc.down));
  }
  const Box box = box_around(outline, 1.0 + 5.0 * sigma, size_);
  if (box.left > box.right || box.top > box.bottom) return;

  const Vector3d normal = pose_.R_camera_from_payload.col(2);
  const double height = normal.dot(pose_.origin_in_camera);
  const auto on_payload = [&](const CameraRay& ray) -> Vector2d {
    const Vector3d direction(ray.tangent.x(), ray.tangent.y(), 1.0);
    const Vector3d origin(0, 0, ray.pupil_mm);
    const Vector3d hit =
        origin + direction * ((height - normal.dot(origin)) / normal.dot(direction));
    return (pose_.R_camera_from_payload.transpose() * (hit - pose_.origin_in_camera)).head<2>();
  };
  const Vector2d middle = world_.lens().project(disc.centre);
  Eigen::Matrix2d mm_per_px;
  for (int k = 0; k < 2; ++k) {
    const Vector2d half = 0.5 * Vector2d::Unit(k);
    mm_per_px.col(k) =
        on_payload(world_.lens().ray(middle + half)) - on_payload(world_.lens().ray(middle - half));
  }

  const double contrast = truth.circle_bright_grey - truth.circle_dark_grey;
  const auto step = static_cast<float>(world_.pattern().bright ? contrast : -contrast);
  for (int v = box.top; v <= box.bottom; ++v)
    for (int u = box.left; u <= box.right; ++u) {
      const std::size_t at = static_cast<std::size_t>(v) * static_cast<std::size_t>(size_.width) +
                             static_cast<std::size_t>(u);
      const Vector2d from_centre = on_payload(rays_[at]) - centre;
      const double distance = from_centre.norm();
      const double scale =
          distance > 0 ? (mm_per_px.transpose() * from_centre).norm() / distance : 1.0;
      const double inside_px = (radius_mm - distance) / scale;
      if (inside_px < -5.0 * sigma) continue;
      signal_[at] +=
          step *
          (inside_px > 5.0 * sigma ? 1.0f : static_cast<float>(gaussian_cdf(inside_px / sigma)));
    }
}

Image Renderer::expose(std::uint64_t frame) const {
  const ImageTruth& truth = world_.image_truth();
  Image image(size_, 0);
  const auto to_grey = [](float value) {
    return static_cast<std::uint8_t>(std::clamp(value + 0.5f, 0.0f, 255.0f));
  };
  const float read_variance = static_cast<float>(truth.read_noise_grey * truth.read_noise_grey);
  const float shot_variance =
      truth.electrons_per_grey > 0 ? static_cast<float>(1.0 / truth.electrons_per_grey) : 0.0f;
  if (read_variance == 0.0f && shot_variance == 0.0f) {
    std::ranges::transform(signal_, image.pixels.begin(), to_grey);
    return image;
  }
  // Nearly all pixels are ground: their noisy grey values come from one table.
  const float ground = signal_.front();
  std::vector<std::uint8_t> ground_table(kQuantiles);
  const float ground_sigma = std::sqrt(read_variance + shot_variance * ground);
  for (std::size_t i = 0; i < kQuantiles; ++i)
    ground_table[i] = to_grey(ground + ground_sigma * normal_table_[i]);

  Random random(world_.seed(), "image noise", frame);
  std::uint64_t bits = 0;
  for (std::size_t i = 0; i < signal_.size(); ++i) {
    if (i % 4 == 0) bits = random();
    const auto draw = static_cast<std::uint16_t>(bits >> (16 * (i % 4)));
    const float s = signal_[i];
    image.pixels[i] =
        s == ground
            ? ground_table[draw]
            : to_grey(s + std::sqrt(read_variance + shot_variance * s) * normal_table_[draw]);
  }
  return image;
}

}  // namespace turntable::sim
