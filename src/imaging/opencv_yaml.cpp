#include "src/imaging/opencv_yaml.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <numbers>
#include <opencv2/core.hpp>

#include "src/core/errors.h"
#include "src/core/json_document.h"

namespace turntable {
namespace {

constexpr int kHighestOrder = 9;
constexpr double kEnoughPx = 1e-3;
/// Bytes; OpenCV's own files, with all points of a calibration in them, have some hundred thousand.
constexpr std::size_t kLargestFile = 16u << 20;
/// Above the highest order by enough to see what it leaves out.
constexpr int kNodes = 24;

struct Quadrature {
  std::array<double, kNodes> at, weight;  ///< on [-1, 1]; the weights sum to 2
};

/// Gauss-Legendre nodes: zeros of P_n by Newton's method from Tricomi's guess (Abramowitz & Stegun,
/// 25.4.29).
Quadrature gauss_legendre() {
  Quadrature q;
  for (unsigned i = 0; i < kNodes; ++i) {
    double t = std::cos(std::numbers::pi * (i + 0.75) / (kNodes + 0.5)), slope = 0.0;
    for (int step = 0; step < 10; ++step) {
      const double p = std::legendre(kNodes, t);
      slope = kNodes * (t * p - std::legendre(kNodes - 1, t)) / (t * t - 1);
      t -= p / slope;
    }
    q.at[i] = t;
    q.weight[i] = 2.0 / ((1 - t * t) * slope * slope);
  }
  return q;
}

[[noreturn]] void refuse(const std::string& name, const char* key, const std::string& message) {
  throw ConfigError(name, fmt::format("/{}", key), message);
}

double number(const cv::FileNode& node, const std::string& name, const char* key) {
  if (!node.isInt() && !node.isReal())
    refuse(name, key, node.empty() ? "is missing. Add it (a number)." : "allowed: a number.");
  return node.real();
}

int extent(const cv::FileStorage& file, const std::string& name, const char* key) {
  const double value = number(file[key], name, key);
  if (!(value >= 16 && value <= 20000) || value != std::floor(value))
    refuse(name, key, fmt::format("found {} px, allowed: a whole number, 16 to 20000 px.", value));
  return static_cast<int>(value);
}

cv::Mat_<double> matrix(const cv::FileStorage& file, const std::string& name, const char* key) {
  const cv::FileNode node = file[key];
  if (node.empty()) refuse(name, key, "is missing. Add it (a matrix as OpenCV writes it).");
  // The library allocates what rows and columns ask for before it looks at the data.
  const auto side = [&](const char* of) {
    const cv::FileNode number = node.isMap() ? node[of] : cv::FileNode();
    return number.isInt() ? static_cast<std::int64_t>(static_cast<int>(number)) : 0;
  };
  const std::int64_t rows = side("rows"), columns = side("cols");
  const auto values = static_cast<std::int64_t>(node.isMap() ? node["data"].size() : 0);
  if (rows > 0 && columns > 0 && rows * columns != values)
    refuse(
        name, key,
        fmt::format("found {} numbers, allowed: {}, for {} rows and {} columns. Correct the one or "
                    "the other.",
                    values, rows * columns, rows, columns));
  if (rows <= 0 || columns <= 0)
    refuse(name, key, "allowed: a matrix as OpenCV writes it (!!opencv-matrix with its data).");
  cv::Mat m;
  try {
    node >> m;
  } catch (const cv::Exception&) {
    m.release();
  }
  if (m.empty() || m.channels() != 1)
    refuse(name, key, "allowed: a matrix as OpenCV writes it (!!opencv-matrix with its data).");
  cv::Mat_<double> out(m);
  for (const double value : out)
    if (!std::isfinite(value)) refuse(name, key, "found a number that is not finite.");
  return out;
}

/// The pinhole that comes nearest to the camera's rays over the image: u = f_x x + c_x, v likewise.
CentralModel nearest_pinhole(const CentralModel& model, const std::vector<Vector2d>& pixels,
                             const std::vector<Vector2d>& tangents,
                             const std::vector<double>& weights) {
  CentralModel out = model;
  out.kind = CentralKind::kPinhole;
  out.distortion.clear();
  out.views = 0;
  double squares = 0.0, total = 0.0;
  for (const double w : weights) total += w;
  for (const int k : {0, 1}) {
    double t1 = 0, p1 = 0, tt = 0, tp = 0;
    for (std::size_t i = 0; i < pixels.size(); ++i) {
      t1 += weights[i] * tangents[i](k) / total;
      p1 += weights[i] * pixels[i](k) / total;
    }
    for (std::size_t i = 0; i < pixels.size(); ++i) {
      tt += weights[i] * std::pow(tangents[i](k) - t1, 2);
      tp += weights[i] * (tangents[i](k) - t1) * (pixels[i](k) - p1);
    }
    const double f = tp / tt, c = p1 - f * t1;
    (k == 0 ? out.fx : out.fy) = f;
    (k == 0 ? out.cx : out.cy) = c;
    for (std::size_t i = 0; i < pixels.size(); ++i)
      squares += weights[i] * std::pow(f * tangents[i](k) + c - pixels[i](k), 2);
  }
  out.rms_px = std::sqrt(squares / total);
  return out;
}

}  // namespace

std::string to_opencv_yaml(const CentralModel& m) {
  cv::FileStorage file(
      ".yml", cv::FileStorage::WRITE | cv::FileStorage::MEMORY | cv::FileStorage::FORMAT_YAML);
  const cv::Mat K(cv::Matx33d(m.fx, 0, m.cx, 0, m.fy, m.cy, 0, 0, 1));
  // A pinhole is a brown without distortion to OpenCV, which has no file for no coefficients.
  cv::Mat k =
      cv::Mat::zeros(static_cast<int>(m.distortion.empty() ? distortion_terms(CentralKind::kBrown)
                                                           : m.distortion.size()),
                     1, CV_64F);
  for (std::size_t i = 0; i < m.distortion.size(); ++i)
    k.at<double>(static_cast<int>(i)) = m.distortion[i];
  file << "nr_of_frames" << m.views << "image_width" << m.image_size.width << "image_height"
       << m.image_size.height << "fisheye_model" << (m.kind == CentralKind::kFisheye ? 1 : 0)
       << "camera_matrix" << K << "distortion_coefficients" << k << "avg_reprojection_error"
       << m.rms_px;
  return file.releaseAndGetString();
}

CentralModel parse_opencv_yaml(const std::string& text, const std::string& name) {
  if (text.size() > kLargestFile)
    throw ConfigError(
        name, "",
        fmt::format("found {} bytes, allowed: up to {}. This is no camera file of OpenCV.",
                    text.size(), kLargestFile));
  cv::FileStorage file;
  try {
    file.open(text, cv::FileStorage::READ | cv::FileStorage::MEMORY);
  } catch (const cv::Exception&) {
    throw ConfigError(name, "",
                      "is not a camera file of OpenCV: empty, cut off, or no YAML, XML or JSON. "
                      "Write it again with OpenCV.");
  }
  if (!file.isOpened() || !file.root().isMap())
    throw ConfigError(name, "",
                      "is not a camera file of OpenCV, which starts with %YAML:1.0, <?xml or {.");
  CentralModel m;
  m.image_size = {extent(file, name, "image_width"), extent(file, name, "image_height")};
  const cv::Mat_<double> K = matrix(file, name, "camera_matrix");
  if (K.rows != 3 || K.cols != 3)
    refuse(name, "camera_matrix",
           fmt::format("found {} x {} numbers, allowed: 3 x 3.", K.rows, K.cols));
  if (K(0, 1) != 0 || K(1, 0) != 0 || K(2, 0) != 0 || K(2, 1) != 0 || K(2, 2) != 1)
    refuse(name, "camera_matrix", "allowed: [fx 0 cx; 0 fy cy; 0 0 1], without skew.");
  m.fx = K(0, 0);
  m.fy = K(1, 1);
  m.cx = K(0, 2);
  m.cy = K(1, 2);
  if (!(m.fx > 0) || !(m.fy > 0))
    refuse(name, "camera_matrix",
           fmt::format("found focal lengths {} and {} px, allowed: above 0.", m.fx, m.fy));

  const bool fisheye =
      !file["fisheye_model"].empty() && number(file["fisheye_model"], name, "fisheye_model") != 0;
  std::vector<double> k;
  if (fisheye || !file["distortion_coefficients"].empty()) {
    const cv::Mat_<double> read = matrix(file, name, "distortion_coefficients");
    if (read.rows != 1 && read.cols != 1)
      refuse(
          name, "distortion_coefficients",
          fmt::format("found {} x {} numbers, allowed: one row or column.", read.rows, read.cols));
    k.assign(read.begin(), read.end());
  }
  const auto zero_from = [&](std::size_t first) {
    return std::all_of(k.begin() + static_cast<std::ptrdiff_t>(std::min(first, k.size())), k.end(),
                       [](double value) { return value == 0.0; });
  };
  if (fisheye) {
    m.kind = CentralKind::kFisheye;
    if (k.size() != 4)
      refuse(name, "distortion_coefficients",
             fmt::format("found {} numbers, allowed: 4 with fisheye_model.", k.size()));
  } else {
    constexpr std::array<std::size_t, 6> kAllowed{0, 4, 5, 8, 12, 14};
    if (std::ranges::find(kAllowed, k.size()) == kAllowed.end())
      refuse(name, "distortion_coefficients",
             fmt::format("found {} numbers, allowed: 4, 5, 8, 12 or 14.", k.size()));
    if (!zero_from(8))
      refuse(name, "distortion_coefficients",
             "has thin-prism or tilt terms (the 9th number and on), which no model here has. "
             "Calibrate without them.");
    m.kind = zero_from(0)   ? CentralKind::kPinhole
             : zero_from(5) ? CentralKind::kBrown
                            : CentralKind::kRational;
    k.resize(distortion_terms(m.kind), 0.0);
  }
  m.distortion = k;
  if (!file["avg_reprojection_error"].empty())
    m.rms_px = number(file["avg_reprojection_error"], name, "avg_reprojection_error");
  if (!file["nr_of_frames"].empty())
    m.views =
        static_cast<int>(std::clamp(number(file["nr_of_frames"], name, "nr_of_frames"), 0.0, 1e6));
  if (!(m.rms_px >= 0))
    refuse(name, "avg_reprojection_error",
           fmt::format("found {} px, allowed: 0 or more.", m.rms_px));
  m.R_plane_from_camera = Vector3d(1, -1, -1).asDiagonal();
  return m;
}

CentralModel load_opencv_yaml(const std::filesystem::path& file) {
  return parse_opencv_yaml(read_text(file), file.string());
}

Calibration calibration_from_central(const CentralModel& given, RayPlanes planes,
                                     const std::string& source) {
  if (!(planes.a_mm < planes.b_mm) || !(planes.b_mm < 0))
    throw ConfigError(
        source, "",
        fmt::format("planes at {} mm and {} mm, allowed: both below 0, the farther one first: "
                    "the camera is at 0 and z points from the planes to it.",
                    planes.a_mm, planes.b_mm));
  CentralModel model = given;
  model.R_plane_from_camera = Vector3d(1, -1, -1).asDiagonal();
  model.centre_mm.setZero();
  model.lean.setZero();
  model.tied_to_plane = false;

  // The nodes make Legendre polynomials orthogonal as sums too, so that each coefficient is a
  // projection, and a lower order is the same coefficients cut off.
  const Quadrature q = gauss_legendre();
  const ImageSize size = model.image_size;
  const double half_width = 0.5 * (size.width - 1), half_height = 0.5 * (size.height - 1);
  std::vector<Vector2d> pixels, tangents;
  std::vector<double> weights;
  const auto terms = IrtModel::terms(kHighestOrder);
  Eigen::MatrixX4d c = Eigen::MatrixX4d::Zero(static_cast<Eigen::Index>(terms.size()), 4);
  for (std::size_t i = 0; i < kNodes; ++i)
    for (std::size_t j = 0; j < kNodes; ++j) {
      const Vector2d pixel(half_width * (1 + q.at[i]), half_height * (1 + q.at[j]));
      const Vector2d tangent = model.normalise(pixel);
      if (!tangent.allFinite())
        throw ConfigError(
            source, "",
            fmt::format("pixel ({:.0f}, {:.0f}) has no ray: the distortion folds over before it, "
                        "or it looks sideways. Crop the image to what the model covers.",
                        pixel.x(), pixel.y()));
      pixels.push_back(pixel);
      tangents.push_back(tangent);
      weights.push_back(q.weight[i] * q.weight[j]);
      const Ray ray = model.ray(pixel, planes);
      const Eigen::RowVector4d value(ray.at_a.x(), ray.at_a.y(), ray.at_b.x(), ray.at_b.y());
      for (std::size_t t = 0; t < terms.size(); ++t) {
        const auto r = static_cast<unsigned>(terms[t].first);
        const auto s = static_cast<unsigned>(terms[t].second);
        c.row(static_cast<Eigen::Index>(t)) += 0.25 * (2 * r + 1) * (2 * s + 1) * weights.back() *
                                               std::legendre(r, q.at[i]) *
                                               std::legendre(s, q.at[j]) * value;
      }
    }

  Calibration out;
  out.source = source;
  const std::vector<Vector2d> image{
      {0, 0}, {size.width - 1.0, 0}, {size.width - 1.0, size.height - 1.0}, {0, size.height - 1.0}};
  for (int order = 1; order <= kHighestOrder; ++order) {
    const auto kept = IrtModel::terms(order);
    Eigen::MatrixX4d cut(static_cast<Eigen::Index>(kept.size()), 4);
    for (std::size_t i = 0; i < kept.size(); ++i)
      cut.row(static_cast<Eigen::Index>(i)) =
          c.row(std::ranges::find(terms, kept[i]) - terms.begin());
    out.irt = IrtModel(size, planes, order, cut, image);
    double squares = 0.0, worst_px = 0.0;
    for (const Vector2d& pixel : pixels) {
      const Ray exact = model.ray(pixel, planes), fitted = out.irt.ray(pixel);
      const Ray right = model.ray(pixel + Vector2d(0.5, 0), planes);
      const Ray left = model.ray(pixel - Vector2d(0.5, 0), planes);
      const double miss = (fitted.at_b - exact.at_b).norm();
      squares += miss * miss;
      worst_px = std::max(worst_px, miss / (right.at_b - left.at_b).norm());
    }
    out.sigma_mm = std::sqrt(0.5 * squares / static_cast<double>(pixels.size()));
    if (worst_px < kEnoughPx) break;
  }
  check_handedness(out.irt, source);

  out.central.push_back(model);
  if (model.kind == CentralKind::kPinhole) {
    // Solvers that want distortion taken out find that there is none.
    CentralModel brown = model;
    brown.kind = CentralKind::kBrown;
    brown.distortion.assign(distortion_terms(brown.kind), 0.0);
    out.central.push_back(brown);
  } else {
    out.central.push_back(nearest_pinhole(model, pixels, tangents, weights));
  }
  return out;
}

}  // namespace turntable
