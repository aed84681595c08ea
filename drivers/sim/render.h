// From the world to grey values: discs of even radiance, seen through the lens, blurred by a
// Gaussian point spread, integrated over square pixels, with shot and read noise, rounded to 8 bit.
#pragma once

#include <cstdint>
#include <vector>

#include "drivers/sim/world.h"
#include "src/core/image.h"

namespace turntable::sim {

class Renderer {
 public:
  explicit Renderer(const World& world);

  /// What the camera sees now; `frame` addresses the noise, so that the same frame is always the
  /// same image.
  Image render(std::uint64_t frame);

 private:
  void draw_leds();
  void draw_pattern();
  void draw_circle(const Disc& disc, double radius_mm, const Vector2d& centre_on_payload);
  Image expose(std::uint64_t frame) const;

  const World& world_;
  ImageSize size_;
  std::vector<float> signal_;        ///< grey before noise
  std::vector<CameraRay> rays_;      ///< of every pixel; made when the first pattern is drawn
  std::vector<float> normal_table_;  ///< quantiles of the standard normal distribution
  World::Pose pose_;
};

}  // namespace turntable::sim
