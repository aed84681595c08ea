#include "src/imaging/pinhole.h"

#include <fmt/format.h>

#include <algorithm>
#include <opencv2/calib3d.hpp>

#include "src/core/errors.h"

namespace turntable {

bool PinholeModel::distorted() const {
  return std::ranges::any_of(distortion, [](double k) { return k != 0.0; });
}

Vector2d PinholeModel::normalise(const Vector2d& pixel_px) const {
  const Vector2d raw((pixel_px.x() - cx) / fx, (pixel_px.y() - cy) / fy);
  if (!distorted()) return raw;
  const cv::Matx33d K(fx, 0, cx, 0, fy, cy, 0, 0, 1);
  const cv::Vec<double, 5> k(distortion[0], distortion[1], distortion[2], distortion[3],
                             distortion[4]);
  const std::array<cv::Point2d, 1> in{cv::Point2d(pixel_px.x(), pixel_px.y())};
  std::array<cv::Point2d, 1> out;
  cv::undistortPoints(
      in, out, K, k, cv::noArray(), cv::noArray(),
      cv::TermCriteria(cv::TermCriteria::COUNT + cv::TermCriteria::EPS, 100, 1e-12));
  return {out[0].x, out[0].y};
}

PinholeModel fit_pinhole(std::span<const PatternView> views, ImageSize size, bool with_distortion) {
  if (views.size() < 3)
    throw Error(
        fmt::format("the pinhole baseline needs at least three views of the pattern, found {}. Add "
                    "pinhole_views to the calibration scenario.",
                    views.size()));
  if (std::ranges::none_of(views, &PatternView::at_zero))
    throw Error(
        "the pinhole baseline needs a view at zero table angles, which ties it to the plane "
        "frame.");

  std::vector<std::vector<cv::Point3f>> object;
  std::vector<std::vector<cv::Point2f>> image;
  for (const PatternView& view : views) {
    auto& o = object.emplace_back();
    auto& i = image.emplace_back();
    for (const Vector2d& p : view.on_pattern_mm)
      o.emplace_back(static_cast<float>(p.x()), static_cast<float>(p.y()), 0.0f);
    for (const Vector2d& p : view.pixels_px)
      i.emplace_back(static_cast<float>(p.x()), static_cast<float>(p.y()));
  }
  int flags = 0;
  if (!with_distortion)
    flags = cv::CALIB_FIX_K1 | cv::CALIB_FIX_K2 | cv::CALIB_FIX_K3 | cv::CALIB_ZERO_TANGENT_DIST;
  cv::Mat K, k;
  std::vector<cv::Mat> rotations, translations;
  PinholeModel model;
  model.rms_px = cv::calibrateCamera(
      object, image, cv::Size(size.width, size.height), K, k, rotations, translations, flags,
      cv::TermCriteria(cv::TermCriteria::COUNT + cv::TermCriteria::EPS, 60, 1e-9));
  model.fx = K.at<double>(0, 0);
  model.fy = K.at<double>(1, 1);
  model.cx = K.at<double>(0, 2);
  model.cy = K.at<double>(1, 2);
  model.views = static_cast<int>(views.size());
  if (with_distortion)
    for (int i = 0; i < 5; ++i) model.distortion[static_cast<std::size_t>(i)] = k.at<double>(i);

  Matrix3d sum = Matrix3d::Zero();
  for (std::size_t i = 0; i < views.size(); ++i) {
    if (!views[i].at_zero) continue;
    const cv::Mat& r = rotations[i];
    const Vector3d v(r.at<double>(0), r.at<double>(1), r.at<double>(2));
    sum += rotation_from_vector(v).transpose();
  }
  model.R_plane_from_camera = nearest_rotation(sum);
  return model;
}

}  // namespace turntable
