#include "src/imaging/free_views.h"

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <fstream>
#include <iostream>
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

constexpr ImageSize kImageSize{1024, 1024};

struct TrueView {
  FreeView view;
  Matrix3d R_plane_from_target;
  Vector3d position_mm;
};

/// A board of circles every 20 mm held before the simulated rig's lens, tilted up to `tilt_deg` and
/// turned anyhow; odd columns stand `step_mm` higher.
std::vector<TrueView> hand_held(int views, double noise_px, std::uint64_t draw,
                                double tilt_deg = 35.0, double step_mm = 0.0) {
  SimulatedView camera(shipped_rig("simulated"));
  const sim::Lens& lens = camera.world().lens();
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
    t.position_mm =
        Vector3d(random.uniform(-60, 60), random.uniform(-60, 60), random.uniform(-800, -450));
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
  double rms_px = 0.0;  // length per point, poses fitted
  double turn_deg =
      0.0;  // largest difference of two views' motions from the true frame to the fitted one
  double move_mm = 0.0;  // the same, of where it takes the middle of the measured volume
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
      out.turn_deg =
          std::max(out.turn_deg, geodesic_angle(turns[i], turns[j]) * 180.0 / std::numbers::pi);
      out.move_mm = std::max(out.move_mm, (moves[i] - moves[j]).norm());
    }
  out.rms_px = std::sqrt(sum / points);
  return out;
}

TEST(FreeViews, TrueRaysComeBackUpToARigidMotion) {
  const double noise_px = 0.02;
  for (const double step_mm : {0.0, 15.0}) {  // a planar target, and one that is not
    SCOPED_TRACE(step_mm);
    const FreeViewsFit fit =
        fit_rays(seen(hand_held(12, noise_px, 1, 35.0, step_mm)), kImageSize, 5);
    EXPECT_TRUE(fit.converged);
    EXPECT_TRUE(fit.outliers.empty());
    EXPECT_NEAR(fit.sigma_px, noise_px, 0.05 * noise_px);
    EXPECT_LT(fit.position_sd_mm, 0.02);
    EXPECT_NO_THROW(check_handedness(fit.model, "free views"));
    const HeldOut noisy = hold_out(fit.model, hand_held(6, noise_px, 2, 35.0, step_mm));
    EXPECT_LT(noisy.rms_px, 1.05 * std::numbers::sqrt2 * noise_px);
    // What the rays themselves are off.
    const HeldOut exact = hold_out(fit.model, hand_held(6, 0.0, 2, 35.0, step_mm));
    EXPECT_LT(exact.rms_px, 0.5 * noise_px);
    EXPECT_LT(exact.turn_deg, 0.01);
    EXPECT_LT(exact.move_mm, 0.05);
  }
}

TEST(FreeViews, ErrorOfHeldOutViewsFallsWithTheOrder) {
  const auto views = seen(hand_held(12, 0.0, 1));
  const auto others = hand_held(6, 0.0, 2);
  const CentralFit central = fit_central(views, kImageSize);
  EXPECT_TRUE(central.converged);
  const auto error_px = [&](int order) {
    return hold_out(fit_rays(views, kImageSize, order, central.poses).model, others).rms_px;
  };
  EXPECT_LT(error_px(3), 0.05);
  EXPECT_LT(error_px(5), 0.001);
  EXPECT_LT(error_px(7), 0.0001);
}

TEST(FreeViews, FrameStaysWhereTheStartPutIt) {
  const auto views = seen(hand_held(8, 0.02, 1));
  std::vector<ViewPose> start = fit_central(views, kImageSize).poses;
  const Matrix3d turn = rotation_from_vector(Vector3d(0.0, 0.0, 0.2));
  const Vector3d move(10.0, -20.0, 30.0);
  for (ViewPose& pose : start) {
    pose.R_plane_from_target = turn * pose.R_plane_from_target;
    pose.position_mm = turn * pose.position_mm + move;
  }
  const FreeViewsFit fit = fit_rays(views, kImageSize, 5, start);
  EXPECT_TRUE(fit.converged);
  Vector3d turns = Vector3d::Zero(), moves = Vector3d::Zero();
  for (std::size_t k = 0; k < start.size(); ++k) {
    turns += vector_from_rotation(fit.poses[k].R_plane_from_target *
                                  start[k].R_plane_from_target.transpose());
    moves += fit.poses[k].position_mm - start[k].position_mm;
  }
  EXPECT_LT(turns.norm(), 1e-4);
  EXPECT_LT(moves.norm(), 0.01);
  EXPECT_LT((fit.model.bundle_centre().first - move).norm(), 0.5);
}

TEST(FreeViews, DisplacedPointsAreLeftOut) {
  auto views = seen(hand_held(8, 0.02, 1));
  views[2].pixels_px[17].x() += 1.0;
  views[5].pixels_px[3].y() -= 20.0;
  const FreeViewsFit fit = fit_rays(views, kImageSize, 5);
  ASSERT_EQ(fit.outliers.size(), 2u);
  EXPECT_EQ(fit.outliers[0].view, 5u);  // the worst first
  EXPECT_EQ(fit.outliers[0].point, 3u);
  EXPECT_EQ(fit.outliers[1].view, 2u);
  EXPECT_EQ(fit.outliers[1].point, 17u);
  EXPECT_NEAR(fit.sigma_px, 0.02, 0.002);
}

TEST(FreeViews, ViewsAtOneTiltAreRefused) {
  for (const double tilt_deg : {0.0, 1.0})
    EXPECT_THROW(fit_rays(seen(hand_held(8, 0.02, 1, tilt_deg)), kImageSize, 3), Error) << tilt_deg;
  EXPECT_NO_THROW(fit_rays(seen(hand_held(8, 0.02, 1, 10.0)), kImageSize, 3));
}

TEST(FreeViews, TooLittleIsRefused) {
  auto views = seen(hand_held(4, 0.02, 1));
  EXPECT_THROW(fit_rays(views, kImageSize, 0), Error);
  EXPECT_THROW(fit_rays(views, kImageSize, 10), Error);
  EXPECT_THROW(fit_rays(std::vector(views.begin(), views.begin() + 2), kImageSize, 3), Error);
  for (FreeView& view : views) {
    view.on_target_mm.resize(20);
    view.pixels_px.resize(20);
  }
  EXPECT_THROW(fit_rays(views, kImageSize, 5), Error);
  views[1].on_target_mm.resize(5);
  views[1].pixels_px.resize(5);
  EXPECT_THROW(fit_central(views, kImageSize), Error);
}

TEST(FreeViews, PoseOfPointsOnALineDoesNotConverge) {
  const FreeViewsFit fit = fit_rays(seen(hand_held(8, 0.02, 1)), kImageSize, 5);
  const TrueView whole = hand_held(1, 0.0, 2)[0];
  ViewPose start = fit_pose(fit.model, whole.view);
  EXPECT_TRUE(start.converged);
  FreeView line;
  for (std::size_t i = 0; i < whole.view.pixels_px.size(); ++i)
    if (whole.view.on_target_mm[i].y() == 0.0) {
      line.on_target_mm.push_back(whole.view.on_target_mm[i]);
      line.pixels_px.push_back(whole.view.pixels_px[i]);
    }
  ASSERT_GE(line.pixels_px.size(), 4u);
  EXPECT_FALSE(fit_pose(fit.model, line, start).converged);
  line.on_target_mm.resize(2);
  line.pixels_px.resize(2);
  EXPECT_FALSE(fit_pose(fit.model, line, start).converged);
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
      view.on_target_mm.push_back(corners.at({static_cast<int>(row[0]), static_cast<int>(row[1])}));
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
  double field_deg = 0.0;  // angle from the axis of the outermost training point
  double brown_px = 0.0, rational_px = 0.0, fisheye_px = 0.0;
  double rays_px = 0.0;

  double best_of_opencv_px() const { return std::min({brown_px, rational_px, fisheye_px}); }
};

/// @param radius_px of the circle about the image's middle that is used.
BoxFigures measure_box(const std::filesystem::path& folder, double radius_px, int order) {
  const ImageSize size{1280, 800};
  const Vector2d centre(639.5, 399.5);
  const auto train = within(box_views(folder, "train"), centre, radius_px);
  const auto test = within(box_views(folder, "test"), centre, radius_px);
  const auto points = static_cast<double>(count(test));
  const CentralFit central = fit_central(train, size);
  EXPECT_TRUE(central.converged);

  BoxFigures out;
  for (std::size_t k = 0; k < train.size(); ++k)
    for (const Vector3d& p : train[k].on_target_mm) {
      const Vector3d X = central.poses[k].R_plane_from_target * p + central.poses[k].position_mm;
      out.field_deg = std::max(out.field_deg,
                               std::atan2(X.head<2>().norm(), -X.z()) * 180.0 / std::numbers::pi);
    }

  FreeViewsFit fit = fit_rays(train, size, order, central.poses);
  EXPECT_TRUE(fit.converged);
  std::vector<ViewPose> near;
  double sum = 0.0;
  for (const FreeView& view : test) {
    near.push_back(fit_pose(fit.model, view));
    EXPECT_TRUE(near.back().converged);
    sum += near.back().rms_px * near.back().rms_px * static_cast<double>(view.pixels_px.size());
  }
  out.rays_px = std::sqrt(sum / points);
  std::cout << fmt::format(
      "up to {:.0f} deg from the axis, {} training and {} test points, rms px\n"
      "  rays of order {}: train {:.3f} ({} points left out), test {:.3f}\n",
      out.field_deg, count(train), count(test), order, fit.rms_px, fit.outliers.size(),
      out.rays_px);

  // OpenCV's cameras get the better of all training points and those that the rays kept.
  auto kept = train;
  std::ranges::sort(fit.outliers, std::greater{},
                    [](const auto& o) { return std::pair(o.view, o.point); });
  for (const auto& [k, i] : fit.outliers) {
    kept[k].pixels_px.erase(kept[k].pixels_px.begin() + static_cast<std::ptrdiff_t>(i));
    kept[k].on_target_mm.erase(kept[k].on_target_mm.begin() + static_cast<std::ptrdiff_t>(i));
  }
  const auto baseline = [&](const char* name, bool fisheye, std::size_t coefficients) {
    double best_px = INFINITY;
    for (const auto* from : std::initializer_list<const std::vector<FreeView>*>{&train, &kept}) {
      OpenCvLens lens{fisheye, std::vector<double>(4 + coefficients, 0.0)};
      lens.intrinsics[0] = lens.intrinsics[1] = central.focal_px.x();
      lens.intrinsics[2] = centre.x();
      lens.intrinsics[3] = centre.y();
      std::vector<OpenCvPose> poses = as_opencv(central.poses), test_poses = as_opencv(near);
      const double train_px =
          std::sqrt(refine(lens, *from, poses, true) / static_cast<double>(count(*from)));
      const double test_px = std::sqrt(refine(lens, test, test_poses, false) / points);
      std::cout << fmt::format("  OpenCV's {}, {} points: train {:.3f}, test {:.3f}\n", name,
                               count(*from), train_px, test_px);
      best_px = std::min(best_px, test_px);
    }
    return best_px;
  };
  out.brown_px = baseline("pinhole with k1 k2 p1 p2 k3", false, 5);
  out.rational_px = baseline("rational", false, 8);
  out.fisheye_px = baseline("fisheye", true, 4);
  return out;
}

/// 15 training and 7 test images of a box of chessboards by a wide-angle camera of 1280 x 800
/// (babelcalib, Lochman et al., ICCV 2021, MIT licence).
class FreeViewsBox : public testing::Test {
 protected:
  void SetUp() override {
    const auto data = real_data();
    if (!data || !std::filesystem::is_directory(*data / "babelcalib_cube"))
      GTEST_SKIP() << "NOT TESTED ON REAL IMAGES: babelcalib_cube is not there. Set TURNTABLE_REAL "
                      "to the folder of the real data.";
    folder_ = *data / "babelcalib_cube";
  }
  std::filesystem::path folder_;
};

TEST_F(FreeViewsBox, RaysSeeTestImagesAsWellAsTheBestOfOpenCvUpTo60Deg) {
  const BoxFigures mid = measure_box(folder_, 300.0, 7);
  EXPECT_LT(mid.rays_px, 0.19);
  EXPECT_LT(mid.rays_px, mid.best_of_opencv_px());
  const BoxFigures wide = measure_box(folder_, 350.0, 9);
  EXPECT_GT(wide.field_deg, 55.0);
  EXPECT_LT(wide.rays_px, 0.21);
  EXPECT_LT(wide.rays_px, wide.best_of_opencv_px());
}

TEST_F(FreeViewsBox, RaysOfANarrowFieldCostLittleForTheirFreedom) {
  // 662 points carry 84 coefficients a little worse than the 9 to 12 of a lens that fits anyway.
  const BoxFigures narrow = measure_box(folder_, 200.0, 5);
  EXPECT_LT(narrow.rays_px, 0.18);
  EXPECT_LT(narrow.rays_px, 1.05 * narrow.best_of_opencv_px());
}

TEST_F(FreeViewsBox, FieldsOf70DegAndMoreAreTooWideForTwoPlanes) {
  // The tangent of the angle, which the polynomials stand for, is 3 at 72 deg and infinite at 90:
  // order 9 does not follow it, and functions of the angle do.
  const BoxFigures wider = measure_box(folder_, 400.0, 9);
  EXPECT_GT(wider.field_deg, 70.0);
  EXPECT_LT(wider.rays_px, 0.45);
  EXPECT_LT(wider.rays_px, 2.0 * wider.best_of_opencv_px());
}

}  // namespace
}  // namespace turntable
