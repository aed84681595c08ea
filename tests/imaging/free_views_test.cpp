#include "src/imaging/free_views.h"

#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <map>
#include <numbers>
#include <opencv2/calib3d.hpp>
#include <sstream>

#include "src/core/errors.h"
#include "tests/support/draws.h"
#include "tests/support/real_data.h"
#include "tests/support/simulated_view.h"

namespace turntable {
namespace {

constexpr ImageSize kSize{1024, 1024};

struct TrueView {
  FreeView view;
  Matrix3d R_plane_from_target;
  Vector3d position_mm;
};

/// A board of circles every 20 mm held before the simulated rig's lens, tilted up to `tilt_deg` and
/// turned anyhow; odd columns stand `step_mm` higher.
std::vector<TrueView> hand_held(int views, double noise_px, std::uint64_t draw,
                                double tilt_deg = 35.0, double step_mm = 0.0) {
  const SimulatedView camera(shipped_rig("simulated"));
  const sim::Lens& lens = const_cast<SimulatedView&>(camera).world().lens();
  Random random = draws_of_this_test(draw);
  std::vector<TrueView> out;
  while (static_cast<int>(out.size()) < views) {
    TrueView t;
    const double about = random.uniform(0.0, 2.0 * std::numbers::pi);
    const double tilt = random.uniform(0.3, 1.0) * tilt_deg / 180.0 * std::numbers::pi;
    const double turn = random.uniform(-std::numbers::pi, std::numbers::pi);
    t.R_plane_from_target =
        rotation_from_vector(tilt * Vector3d(std::cos(about), std::sin(about), 0.0)) *
        rotation_from_vector(Vector3d(0, 0, turn));
    t.position_mm = Vector3d(random.uniform(-60, 60), random.uniform(-60, 60), random.uniform(-800, -450));
    for (int row = -7; row <= 7; ++row)
      for (int column = -9; column <= 9; ++column) {
        const Vector3d P(20.0 * column, 20.0 * row, column % 2 == 0 ? 0.0 : step_mm);
        const Vector3d X = t.R_plane_from_target * P + t.position_mm;
        Vector2d pixel = lens.project({X.x(), -X.y(), -X.z()});
        if (pixel.minCoeff() < 10 || pixel.maxCoeff() > 1013) continue;
        pixel += noise_px * Vector2d(random.normal(), random.normal());
        t.view.on_target_mm.push_back(P);
        t.view.pixels_px.push_back(pixel);
      }
    if (t.view.pixels_px.size() >= 60) out.push_back(t);
  }
  return out;
}

std::vector<FreeView> seen(const std::vector<TrueView>& views) {
  std::vector<FreeView> out;
  for (const TrueView& t : views) out.push_back(t.view);
  return out;
}

struct HeldOut {
  double rms_px = 0.0;    // length per point, poses fitted
  double turn_deg = 0.0;  // largest difference of two views' motions from the true frame to the fitted one
  double move_mm = 0.0;   // the same, of where it takes the middle of the measured volume
};
HeldOut hold_out(const IrtModel& model, const std::vector<TrueView>& views) {
  HeldOut out;
  double sum = 0.0, points = 0.0;
  std::vector<Matrix3d> turns;
  std::vector<Vector3d> moves;
  for (const TrueView& t : views) {
    const ViewPose pose = fit_pose(model, t.view);
    EXPECT_TRUE(pose.converged);
    const auto n = static_cast<double>(t.view.pixels_px.size());
    sum += pose.rms_px * pose.rms_px * n;
    points += n;
    turns.push_back(pose.R_plane_from_target * t.R_plane_from_target.transpose());
    moves.push_back(turns.back() * (Vector3d(0, 0, -600) - t.position_mm) + pose.position_mm);
  }
  for (std::size_t i = 0; i < turns.size(); ++i)
    for (std::size_t j = 0; j < i; ++j) {
      out.turn_deg = std::max(out.turn_deg, geodesic_angle(turns[i], turns[j]) * 180.0 / std::numbers::pi);
      out.move_mm = std::max(out.move_mm, (moves[i] - moves[j]).norm());
    }
  out.rms_px = std::sqrt(sum / points);
  return out;
}

TEST(FreeViews, TrueRaysComeBackUpToARigidMotion) {
  const double noise = 0.02;
  for (const double step_mm : {0.0, 15.0}) {
    const FreeViewsFit fit = fit_rays(seen(hand_held(12, noise, 1, 35.0, step_mm)), kSize, 5);
    EXPECT_TRUE(fit.converged);
    const HeldOut held_out = hold_out(fit.model, hand_held(6, noise, 2, 35.0, step_mm));
    std::cout << fit.points << " sigma " << fit.sigma_px << " rms " << held_out.rms_px << " turn " << held_out.turn_deg << " move " << held_out.move_mm << " it " << fit.iterations << " out " << fit.outliers.size() << "\n";
    const HeldOut exact = hold_out(fit.model, hand_held(6, 0.0, 2, 35.0, step_mm));
    std::cout << "exact points: " << exact.rms_px << " turn " << exact.turn_deg << " move " << exact.move_mm << "\n";
    std::cout << fit.model.bundle_centre().first.transpose() << " " << fit.model.bundle_centre().second << "\n";
    EXPECT_NO_THROW(check_handedness(fit.model, "free views"));
  }
}

TEST(FreeViews, ErrorFallsWithTheOrderUntilTheLensIsExhausted) {
  const auto views = seen(hand_held(12, 0.0, 1));
  const CentralFit central = fit_central(views, kSize);
  std::cout << "central " << central.rms_px << " f " << central.focal_px.transpose() << "\n";
  const auto others = hand_held(6, 0.0, 2);
  for (const int order : {1, 2, 3, 4, 5, 6, 7}) {
    const FreeViewsFit fit = fit_rays(views, kSize, order, central.poses);
    const HeldOut h = hold_out(fit.model, others);
    std::cout << order << " " << fit.rms_px << " " << fit.iterations << fit.converged << " " << h.rms_px << " " << h.turn_deg << " " << h.move_mm << "\n";
  }
}

TEST(FreeViews, ViewsAtOneTiltAreRefused) {
  for (double tilt : {0.0, 1e-3, 1.0, 5.0}) {
    try {
      const FreeViewsFit fit = fit_rays(seen(hand_held(8, 0.02, 1, tilt)), kSize, 3);
      const HeldOut h = hold_out(fit.model, hand_held(6, 0.02, 2));
      std::cout << tilt << " " << fit.rms_px << " " << h.rms_px << " " << h.turn_deg << " " << h.move_mm << "\n";
    } catch (const Error& e) {
      std::cout << tilt << " " << e.what() << "\n";
    }
  }
}

// --- The box of chessboards -------------------------------------------------------------------

/// Lines of a file split at commas and blanks into numbers; lines that are not numbers are skipped.
std::vector<std::vector<double>> numbers_of(const std::filesystem::path& path) {
  std::ifstream in(path);
  std::vector<std::vector<double>> out;
  for (std::string line; std::getline(in, line);) {
    for (char& c : line)
      if (c == ',' || c == '\r') c = ' ';
    std::istringstream words(line);
    std::vector<double> row;
    for (double value; words >> value;) row.push_back(value);
    if (words.eof() && !row.empty()) out.push_back(row);
  }
  return out;
}

/// Corners of the box by (board, corner), mm. `.dsc`: a head per board (number, columns, rows,
/// pitch), then its corners (tag, column, row, x, y, z in mm); `.tp`: box from board as 3 x 4.
std::map<std::pair<int, int>, Vector3d> box_corners(const std::filesystem::path& folder) {
  std::map<int, std::vector<Vector3d>> boards;
  int board = -1;
  for (const auto& row : numbers_of(folder / "ov_cube.dsc")) {
    if (row.size() == 4) board = static_cast<int>(row[0]);
    if (row.size() == 6) boards[board].emplace_back(10.0 * row[3], 10.0 * row[4], 10.0 * row[5]);
  }
  std::map<std::pair<int, int>, Vector3d> out;
  const auto poses = numbers_of(folder / "ov_cube.tp");
  for (std::size_t i = 0; i + 3 < poses.size(); i += 4) {
    board = static_cast<int>(poses[i][0]);
    for (std::size_t k = 0; k < boards[board].size(); ++k) {
      Vector3d p;
      for (int a = 0; a < 3; ++a) {
        const auto& r = poses[i + 1 + static_cast<std::size_t>(a)];
        p(a) = Vector3d(r[0], r[1], r[2]).dot(boards[board][k]) + r[3];
      }
      out[{board, static_cast<int>(k)}] = p;
    }
  }
  return out;
}

/// Detected corners, `.orpc`: a head, then board, corner, flag, u, v.
std::vector<FreeView> box_views(const std::filesystem::path& folder, const std::string& split) {
  const auto corners = box_corners(folder);
  std::vector<std::filesystem::path> files;
  for (const auto& entry : std::filesystem::directory_iterator(folder / "corners" / split))
    if (entry.path().extension() == ".orpc") files.push_back(entry.path());
  std::ranges::sort(files);
  std::vector<FreeView> views;
  for (const auto& file : files) {
    FreeView& view = views.emplace_back();
    for (const auto& row : numbers_of(file)) {
      if (row.size() != 5) continue;
      view.on_target_mm.push_back(
          corners.at({static_cast<int>(row[0]), static_cast<int>(row[1])}));
      view.pixels_px.emplace_back(row[3], row[4]);
    }
  }
  return views;
}

/// The points whose pixels lie within a circle; of views with at least six.
std::vector<FreeView> within(const std::vector<FreeView>& views, const Vector2d& centre_px,
                             double radius_px) {
  std::vector<FreeView> out;
  for (const FreeView& view : views) {
    FreeView kept;
    for (std::size_t i = 0; i < view.pixels_px.size(); ++i) {
      if ((view.pixels_px[i] - centre_px).norm() > radius_px) continue;
      kept.pixels_px.push_back(view.pixels_px[i]);
      kept.on_target_mm.push_back(view.on_target_mm[i]);
    }
    if (kept.pixels_px.size() >= 6) out.push_back(kept);
  }
  return out;
}

/// A camera of OpenCV's: pinhole with 5 or 8 coefficients, or fisheye with 4.
struct OpenCvLens {
  bool fisheye = false;
  std::vector<double> intrinsics;  // f_u f_v c_u c_v k..
};
struct OpenCvPose {
  cv::Vec3d rotation, translation;
};

/// Projected minus seen, px, and its derivatives to (intrinsics, rotation, translation).
cv::Mat misses_of(const OpenCvLens& lens, const FreeView& view, const OpenCvPose& pose,
                  cv::Mat& to_intrinsics, cv::Mat& to_pose) {
  std::vector<cv::Point3d> points;
  for (const Vector3d& p : view.on_target_mm) points.emplace_back(p.x(), p.y(), p.z());
  const auto& c = lens.intrinsics;
  const cv::Matx33d K(c[0], 0, c[2], 0, c[1], c[3], 0, 0, 1);
  const std::vector<double> k(c.begin() + 4, c.end());
  const int n = static_cast<int>(c.size());
  std::vector<cv::Point2d> pixels;
  cv::Mat J;
  if (lens.fisheye) {  // columns: f c k rotation translation skew
    cv::fisheye::projectPoints(points, pixels, pose.rotation, pose.translation, K, k, 0.0, J);
    to_intrinsics = J.colRange(0, n);
    to_pose = J.colRange(n, n + 6);
  } else {  // columns: rotation translation f c k
    cv::projectPoints(points, pose.rotation, pose.translation, K, k, pixels, J);
    to_pose = J.colRange(0, 6);
    to_intrinsics = J.colRange(6, 6 + n);
  }
  cv::Mat miss(J.rows, 1, CV_64F);
  for (std::size_t i = 0; i < pixels.size(); ++i) {
    const int row = 2 * static_cast<int>(i);
    miss.at<double>(row) = pixels[i].x - view.pixels_px[i].x();
    miss.at<double>(row + 1) = pixels[i].y - view.pixels_px[i].y();
  }
  return miss;
}

/// Least squares by Marquardt's method over the poses and, if asked, the lens; sum of squares, px^2.
/// cv::calibrateCamera and cv::fisheye::calibrate do the same, but they start a view that is not
/// planar badly, and lose some of these.
double refine(OpenCvLens& lens, const std::vector<FreeView>& views, std::vector<OpenCvPose>& poses,
              bool lens_too) {
  const int n = lens_too ? static_cast<int>(lens.intrinsics.size()) : 0;
  const int unknowns = n + 6 * static_cast<int>(views.size());
  const auto equations = [&](const OpenCvLens& l, const std::vector<OpenCvPose>& p, cv::Mat& N,
                             cv::Mat& g) {
    N = cv::Mat::zeros(unknowns, unknowns, CV_64F);
    g = cv::Mat::zeros(unknowns, 1, CV_64F);
    double sum = 0.0;
    for (std::size_t k = 0; k < views.size(); ++k) {
      cv::Mat A, D;
      const cv::Mat miss = misses_of(l, views[k], p[k], A, D);
      const cv::Range at(n + 6 * static_cast<int>(k), n + 6 * static_cast<int>(k) + 6), top(0, n);
      N(at, at) += D.t() * D;
      g.rowRange(at) += D.t() * miss;
      if (lens_too) {
        N(top, top) += A.t() * A;
        N(top, at) += A.t() * D;
        N(at, top) += D.t() * A;
        g.rowRange(top) += A.t() * miss;
      }
      sum += miss.dot(miss);
    }
    return sum;
  };
  cv::Mat N, g;
  double sum = equations(lens, poses, N, g), damping = 1e-4;
  for (int step = 0; step < 100 && damping < 1e6; ++step) {
    cv::Mat damped = N.clone(), move;
    damped.diag() += damping * N.diag();
    cv::solve(damped, -g, move, cv::DECOMP_CHOLESKY);
    OpenCvLens next = lens;
    std::vector<OpenCvPose> next_poses = poses;
    for (int i = 0; i < n; ++i) next.intrinsics[static_cast<std::size_t>(i)] += move.at<double>(i);
    for (std::size_t k = 0; k < poses.size(); ++k)
      for (int i = 0; i < 3; ++i) {
        next_poses[k].rotation[i] += move.at<double>(n + 6 * static_cast<int>(k) + i);
        next_poses[k].translation[i] += move.at<double>(n + 6 * static_cast<int>(k) + 3 + i);
      }
    cv::Mat next_N, next_g;
    const double next_sum = equations(next, next_poses, next_N, next_g);
    if (next_sum <= sum) {
      lens = next;
      poses = next_poses;
      N = next_N;
      g = next_g;
      const bool arrived = sum - next_sum < 1e-9 * sum;
      sum = next_sum;
      if (arrived) break;
      damping *= 0.1;
    } else {
      damping *= 10.0;
    }
  }
  return sum;
}

std::vector<OpenCvPose> as_opencv(const std::vector<ViewPose>& poses) {
  const Matrix3d turned_over = Vector3d(1, -1, -1).asDiagonal();
  std::vector<OpenCvPose> out;
  for (const ViewPose& pose : poses) {
    const Vector3d r = vector_from_rotation(turned_over * pose.R_plane_from_target);
    const Vector3d t = turned_over * pose.position_mm;
    out.push_back({{r.x(), r.y(), r.z()}, {t.x(), t.y(), t.z()}});
  }
  return out;
}

std::size_t count(const std::vector<FreeView>& views) {
  std::size_t n = 0;
  for (const FreeView& view : views) n += view.pixels_px.size();
  return n;
}

/// Residuals on the test images, rms length per point: intrinsics frozen, poses fitted to all
/// points.
struct BoxFigures {
  double brown_px, rational_px, fisheye_px;
  std::map<int, double> rays_px;  // by order
};
BoxFigures measure_box(const std::filesystem::path& folder, double radius_px,
                       const std::vector<int>& orders) {
  const ImageSize size{1280, 800};
  const Vector2d centre(631.5, 401.0);
  auto train = within(box_views(folder, "train"), centre, radius_px);
  const auto test = within(box_views(folder, "test"), centre, radius_px);
  const auto points = static_cast<double>(count(test));
  const CentralFit central = fit_central(train, size);
  EXPECT_TRUE(central.converged);

  BoxFigures out;
  FreeViewsFit last;
  std::vector<ViewPose> near(test.size());
  for (const int order : orders) {
    const FreeViewsFit fit = fit_rays(train, size, order, central.poses);
    EXPECT_TRUE(fit.converged);
    last = fit;
    double sum = 0.0;
    for (std::size_t k = 0; k < test.size(); ++k) {
      near[k] = fit_pose(fit.model, test[k]);
      EXPECT_TRUE(near[k].converged);
      sum += near[k].rms_px * near[k].rms_px * static_cast<double>(test[k].pixels_px.size());
    }
    out.rays_px[order] = std::sqrt(sum / points);
    std::cout << fmt::format(
        "rays of order {}: train {:.3f} px ({} of {} points left out), test {:.3f} px\n", order,
        fit.rms_px, fit.outliers.size(), count(train), out.rays_px[order]);
  }
  // The same points for all: without what the rays took for outliers.
  std::ranges::sort(last.outliers, std::greater{},
                    [](const auto& o) { return std::pair(o.view, o.point); });
  for (const auto& [k, i] : last.outliers) {
    train[k].pixels_px.erase(train[k].pixels_px.begin() + static_cast<std::ptrdiff_t>(i));
    train[k].on_target_mm.erase(train[k].on_target_mm.begin() + static_cast<std::ptrdiff_t>(i));
  }
  const auto baseline = [&](const char* name, bool fisheye, std::size_t coefficients) {
    OpenCvLens lens{fisheye, std::vector<double>(4 + coefficients, 0.0)};
    lens.intrinsics[0] = lens.intrinsics[1] = central.focal_px.x();
    lens.intrinsics[2] = centre.x();
    lens.intrinsics[3] = centre.y();
    std::vector<OpenCvPose> poses = as_opencv(central.poses), test_poses = as_opencv(near);
    const double sum = refine(lens, train, poses, true);
    const double test_px = std::sqrt(refine(lens, test, test_poses, false) / points);
    std::cout << fmt::format("OpenCV's {}: train {:.3f} px, test {:.3f} px\n", name,
                             std::sqrt(sum / static_cast<double>(count(train))), test_px);
    return test_px;
  };
  out.brown_px = baseline("pinhole with k1 k2 p1 p2 k3", false, 5);
  out.rational_px = baseline("rational", false, 8);
  out.fisheye_px = baseline("fisheye", true, 4);
  return out;
}

TEST(FreeViewsBox, Explore) {
  const auto data = real_data();
  if (!data) GTEST_SKIP() << "no data";
  for (double r : {200., 250., 300., 350.}) {
    std::cout << "radius " << r << "\n";
    measure_box(*data / "babelcalib_cube", r, {3, 5, 6, 7, 8, 9});
  }
}

}  // namespace
}  // namespace turntable
