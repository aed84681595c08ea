#include "src/imaging/central_model.h"

#include <fmt/format.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <opencv2/calib3d.hpp>

#include "src/core/errors.h"

namespace turntable {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
constexpr std::size_t kFewestPoints = 6;
const Vector2d kNoPoint(kNaN, kNaN);

struct Distorted {
  Vector2d at;
  Eigen::Matrix2d J;  ///< d at / d tangents
};

/// Brown and rational: the first five coefficients, and the last three if they are there.
Distorted distort(const std::vector<double>& k, const Vector2d& t) {
  const double x = t.x(), y = t.y(), s = t.squaredNorm();
  const double p1 = k[2], p2 = k[3];
  double radial = 1 + s * (k[0] + s * (k[1] + s * k[4]));
  double slope = k[0] + s * (2 * k[1] + 3 * s * k[4]);  // d radial / d r^2
  if (k.size() == 8) {
    const double below = 1 + s * (k[5] + s * (k[6] + s * k[7]));
    const double below_slope = k[5] + s * (2 * k[6] + 3 * s * k[7]);
    slope = (slope * below - radial * below_slope) / (below * below);
    radial /= below;
  }
  Distorted out;
  out.at = {x * radial + 2 * p1 * x * y + p2 * (s + 2 * x * x),
            y * radial + p1 * (s + 2 * y * y) + 2 * p2 * x * y};
  const double cross = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y;
  out.J << radial + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x, cross, cross,
      radial + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x;
  return out;
}

/// The symmetric J is positive definite exactly where the distortion has not folded over.
bool unfolded(const Eigen::Matrix2d& J) { return J.determinant() > 0 && J.trace() > 0; }

Vector2d undistort(const std::vector<double>& k, const Vector2d& distorted) {
  Vector2d t = distorted;
  Distorted d = distort(k, t);
  for (int i = 0; i < 50; ++i) {
    if (!unfolded(d.J)) return kNoPoint;
    const double miss = (d.at - distorted).norm();
    Vector2d step = d.J.inverse() * (distorted - d.at);
    Distorted next = distort(k, t + step);
    // Near the fold a full step overshoots it.
    while (!(unfolded(next.J) && (next.at - distorted).norm() <= miss) &&
           step.norm() > 1e-15 * (1 + t.norm())) {
      step *= 0.5;
      next = distort(k, t + step);
    }
    t += step;
    d = next;
    if (step.norm() <= 1e-15 * (1 + t.norm())) break;
  }
  return unfolded(d.J) && (d.at - distorted).norm() < 1e-12 ? t : kNoPoint;
}

/// theta_d and its derivative.
std::pair<double, double> fisheye(const std::vector<double>& k, double theta) {
  const double s = theta * theta;
  return {theta * (1 + s * (k[0] + s * (k[1] + s * (k[2] + s * k[3])))),
          1 + s * (3 * k[0] + s * (5 * k[1] + s * (7 * k[2] + s * 9 * k[3])))};
}

Vector2d undistort_fisheye(const std::vector<double>& k, const Vector2d& distorted) {
  const double theta_d = distorted.norm();
  if (theta_d == 0.0) return distorted;
  // Bisection keeps Newton's steps between the axis and the horizon, where tangents end.
  double low = 0.0, high = 0.5 * M_PI, theta = std::min(theta_d, 0.5 * high);
  for (int i = 0; i < 60; ++i) {
    const auto [value, slope] = fisheye(k, theta);
    (value < theta_d ? low : high) = theta;
    double next = theta - (value - theta_d) / slope;
    if (!(next > low && next < high)) next = 0.5 * (low + high);
    const double step = std::abs(next - theta);
    theta = next;
    if (step <= 1e-16) break;
  }
  const auto [value, slope] = fisheye(k, theta);
  if (slope <= 0 || std::abs(value - theta_d) > 1e-12) return kNoPoint;
  return distorted * (std::tan(theta) / theta_d);
}

/// R_plane_from_camera, centre and lean from all points with known heights together.
void tie_to_plane(CentralModel& model, std::span<const PatternView> views) {
  std::vector<cv::Point3d> object;
  std::vector<cv::Point2d> tangents;
  double lowest_mm = INFINITY, highest_mm = -INFINITY;
  for (const PatternView& view : views) {
    if (!view.at_zero) continue;
    for (std::size_t i = 0; i < view.pixels_px.size(); ++i) {
      const Vector2d t = model.normalise(view.pixels_px[i]);
      if (!t.allFinite()) continue;
      object.emplace_back(view.on_pattern_mm[i].x(), view.on_pattern_mm[i].y(), view.z_mm);
      tangents.emplace_back(t.x(), t.y());
      lowest_mm = std::min(lowest_mm, view.z_mm);
      highest_mm = std::max(highest_mm, view.z_mm);
    }
  }
  model.tied_to_plane = object.size() >= kFewestPoints;
  if (!model.tied_to_plane) {
    model.R_plane_from_camera = Vector3d(1, -1, -1).asDiagonal();
    model.centre_mm = Vector3d::Zero();
    return;
  }
  cv::Vec3d rotation, translation;
  cv::solvePnP(object, tangents, cv::Matx33d::eye(), cv::noArray(), rotation, translation);
  Matrix3d R = rotation_from_vector({rotation[0], rotation[1], rotation[2]});  // camera from plane
  Vector3d t(translation[0], translation[1], translation[2]);

  // Gauss-Newton over (omega, t, lean), R <- exp(omega) R; from a solution without the lean it is
  // there after three steps.
  const bool find_lean = highest_mm > lowest_mm;
  for (int step = 0; step < 10; ++step) {
    Eigen::Matrix<double, 8, 8> N = Eigen::Matrix<double, 8, 8>::Zero();
    Eigen::Matrix<double, 8, 1> g = Eigen::Matrix<double, 8, 1>::Zero();
    for (std::size_t i = 0; i < object.size(); ++i) {
      const double z = object[i].z;
      const Vector3d turned =
          R * Vector3d(object[i].x + model.lean.x() * z, object[i].y + model.lean.y() * z, z);
      const Vector3d p = turned + t;
      Eigen::Matrix<double, 3, 8> J;
      J << 0, turned.z(), -turned.y(), 1, 0, 0, R(0, 0) * z, R(0, 1) * z,  //
          -turned.z(), 0, turned.x(), 0, 1, 0, R(1, 0) * z, R(1, 1) * z,   //
          turned.y(), -turned.x(), 0, 0, 0, 1, R(2, 0) * z, R(2, 1) * z;
      if (!find_lean) J.rightCols<2>().setZero();
      const std::array<double, 2> miss{tangents[i].x - p.x() / p.z(),
                                       tangents[i].y - p.y() / p.z()};
      for (Eigen::Index k = 0; k < 2; ++k) {
        const Eigen::Matrix<double, 8, 1> row =
            ((J.row(k) - p(k) / p.z() * J.row(2)) / p.z()).transpose();
        N += row * row.transpose();
        g += row * miss[static_cast<std::size_t>(k)];
      }
    }
    if (!find_lean) N.bottomRightCorner<2, 2>().setIdentity();
    const Eigen::Matrix<double, 8, 1> change = N.ldlt().solve(g);
    R = rotation_from_vector(change.head<3>()) * R;
    t += change.segment<3>(3);
    model.lean += change.tail<2>();
    if (change.head<3>().norm() < 1e-14) break;
  }
  model.R_plane_from_camera = nearest_rotation(R.transpose());
  model.centre_mm = -(model.R_plane_from_camera * t);
}

}  // namespace

std::string_view central_name(CentralKind kind) {
  constexpr std::string_view names[] = {"pinhole", "brown", "rational", "fisheye"};
  return names[static_cast<std::size_t>(kind)];
}

std::size_t distortion_terms(CentralKind kind) {
  constexpr std::size_t terms[] = {0, 5, 8, 4};
  return terms[static_cast<std::size_t>(kind)];
}

Vector2d CentralModel::normalise(const Vector2d& pixel_px) const {
  const Vector2d distorted((pixel_px.x() - cx) / fx, (pixel_px.y() - cy) / fy);
  switch (kind) {
    case CentralKind::kPinhole:
      return distorted;
    case CentralKind::kBrown:
    case CentralKind::kRational:
      return undistort(distortion, distorted);
    case CentralKind::kFisheye:
      return undistort_fisheye(distortion, distorted);
  }
  return kNoPoint;
}

Vector2d CentralModel::project(const Vector3d& point_camera) const {
  if (!(point_camera.z() > 0)) return kNoPoint;
  Vector2d t = point_camera.head<2>() / point_camera.z();
  if (kind == CentralKind::kBrown || kind == CentralKind::kRational) {
    const Distorted d = distort(distortion, t);
    t = unfolded(d.J) ? d.at : kNoPoint;
  } else if (kind == CentralKind::kFisheye) {
    const double r = t.norm();
    const auto [theta_d, slope] = fisheye(distortion, std::atan(r));
    if (!(slope > 0)) return kNoPoint;
    if (r > 0) t *= theta_d / r;
  }
  return {fx * t.x() + cx, fy * t.y() + cy};
}

Ray CentralModel::ray(const Vector2d& pixel_px, const RayPlanes& planes) const {
  const Vector3d direction = R_plane_from_camera * normalise(pixel_px).homogeneous();
  const Vector2d slope = direction.head<2>() / direction.z();
  const auto at = [&](double z_mm) -> Vector2d {
    return centre_mm.head<2>() + slope * (z_mm - centre_mm.z()) - lean * z_mm;
  };
  return {at(planes.a_mm), at(planes.b_mm)};
}

CentralModel fit_central(CentralKind kind, std::span<const PatternView> views, ImageSize size) {
  if (views.size() < 3)
    throw Error(
        fmt::format("a {} camera needs at least three views of the pattern, found {}. Add "
                    "tilted views (pinhole_views of a scenario, views of a calibration set).",
                    central_name(kind), views.size()));
  // OpenCV takes single precision: 3e-5 px at 1000 px.
  std::vector<std::vector<cv::Point3f>> object;
  std::vector<std::vector<cv::Point2f>> image;
  for (const PatternView& view : views) {
    if (view.pixels_px.size() < kFewestPoints || view.pixels_px.size() != view.on_pattern_mm.size())
      throw Error(fmt::format(
          "a view of the pattern shows {} points ({} of them known), at least {} are needed.",
          view.pixels_px.size(), view.on_pattern_mm.size(), kFewestPoints));
    auto& o = object.emplace_back();
    auto& i = image.emplace_back();
    for (const Vector2d& p : view.on_pattern_mm)
      o.emplace_back(static_cast<float>(p.x()), static_cast<float>(p.y()), 0.0f);
    for (const Vector2d& p : view.pixels_px)
      i.emplace_back(static_cast<float>(p.x()), static_cast<float>(p.y()));
  }
  const cv::Size cv_size(size.width, size.height);
  CentralModel model;
  model.kind = kind;
  model.image_size = size;
  model.views = static_cast<int>(views.size());
  try {
    cv::Mat K, k;
    std::vector<cv::Mat> rotations, translations;
    if (kind == CentralKind::kFisheye) {
      // OpenCV's own start is a lens of 180 deg, from which a narrow one is not found.
      K = cv::initCameraMatrix2D(object, image, cv_size);
      k = cv::Mat::zeros(4, 1, CV_64F);
      model.rms_px = cv::fisheye::calibrate(
          object, image, cv_size, K, k, rotations, translations,
          cv::fisheye::CALIB_USE_INTRINSIC_GUESS | cv::fisheye::CALIB_RECOMPUTE_EXTRINSIC |
              cv::fisheye::CALIB_FIX_SKEW,
          cv::TermCriteria(cv::TermCriteria::COUNT + cv::TermCriteria::EPS, 100, 1e-10));
    } else {
      const int flags =
          kind == CentralKind::kPinhole
              ? cv::CALIB_FIX_K1 | cv::CALIB_FIX_K2 | cv::CALIB_FIX_K3 | cv::CALIB_ZERO_TANGENT_DIST
          : kind == CentralKind::kRational ? cv::CALIB_RATIONAL_MODEL
                                           : 0;
      model.rms_px = cv::calibrateCamera(
          object, image, cv_size, K, k, rotations, translations, flags,
          cv::TermCriteria(cv::TermCriteria::COUNT + cv::TermCriteria::EPS, 60, 1e-9));
    }
    model.fx = K.at<double>(0, 0);
    model.fy = K.at<double>(1, 1);
    model.cx = K.at<double>(0, 2);
    model.cy = K.at<double>(1, 2);
    for (std::size_t i = 0; i < distortion_terms(kind); ++i)
      model.distortion.push_back(k.at<double>(static_cast<int>(i)));
    if (!std::isfinite(model.rms_px) || !(model.fx > 0) || !(model.fy > 0))
      throw Error(fmt::format("no {} camera fits the views. Are they all from one direction?",
                              central_name(kind)));
    tie_to_plane(model, views);
  } catch (const cv::Exception& e) {
    throw Error(fmt::format("no {} camera fits the views: {}.", central_name(kind), e.err));
  }
  return model;
}

}  // namespace turntable
