#include "src/imaging/free_views.h"

#include <fmt/format.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>
#include <limits>
#include <numbers>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>

#include "src/core/errors.h"

namespace turntable {
namespace {

using Eigen::Index;
using Eigen::Matrix2d;
using Eigen::MatrixXd;
using Eigen::VectorXd;

constexpr int kMaxOrder = 9;
constexpr int kMaxSteps = 60;
/// A step has arrived that changes the residuals by less than this, rms, and this part of theirs.
constexpr double kArrivedPx = 1e-6, kArrived = 1e-4;
/// A view whose distance is not known to this part was not determined.
constexpr double kDeterminedPart = 0.01;
/// Relative to a unit diagonal. The least only keeps rounding in check.
constexpr double kFirstDamping = 1e-4, kLeastDamping = 1e-12, kSingular = 1e-11;
constexpr double kOutlierSigmas = 6.0;
constexpr double kNeverOutlierPx = 0.1;

/// Camera frame <-> plane frame.
const Matrix3d kTurnedOver = Vector3d(1, -1, -1).asDiagonal();

/// Legendre products of one pixel, in the order of `IrtModel::terms`.
VectorXd basis(const Vector2d& pixel, ImageSize size, int order) {
  VectorXd out((order + 1) * (order + 2) / 2);
  IrtModel::basis(pixel, size, order, out.data());
  return out;
}

/// d(x, y at height z) / d(u, v), mm/px.
Matrix2d mm_per_px(const IrtModel& model, const Vector2d& pixel, double z_mm) {
  Matrix2d M;
  for (const Index axis : {0, 1}) {
    const Vector2d half = 0.5 * Vector2d::Unit(axis);
    M.col(axis) = model.ray(pixel + half).at(z_mm, model.planes()) -
                  model.ray(pixel - half).at(z_mm, model.planes());
  }
  return M;
}

/// Normal equations N step = -g of the sum of squares, px^2. Unknowns: the coefficients x_a.., x_b..,
/// y_a.., y_b.. (none if the rays are frozen), then turn (rad) and move (mm) of each view.
struct Normals {
  MatrixXd N;
  VectorXd g;
  double sum = 0.0;

  explicit Normals(Index unknowns)
      : N(MatrixXd::Zero(unknowns, unknowns)), g(VectorXd::Zero(unknowns)) {}
};

/// Adds a view whose pose has its six unknowns at `at`.
/// @param phi basis of each pixel, points x terms; empty if the rays are frozen.
void add_view(const IrtModel& model, const FreeView& view, const MatrixXd& phi,
              const ViewPose& pose, Index at, Normals& normals) {
  const auto n = static_cast<Index>(view.pixels_px.size());
  const RayPlanes& planes = model.planes();
  MatrixXd A(n, 2 * phi.cols());                  // d miss_x / d coefficients of x; of y the same
  MatrixXd Dx(n, 6), Dy(n, 6);                    // d miss / d pose
  VectorXd mx(n), my(n), gxx(n), gxy(n), gyy(n);  // miss; G = M^-T M^-1
  for (Index i = 0; i < n; ++i) {
    const auto k = static_cast<std::size_t>(i);
    const Vector3d turned = pose.R_plane_from_target * view.on_target_mm[k];
    const Vector3d X = turned + pose.position_mm;
    const Ray ray = model.ray(view.pixels_px[k]);
    const Vector2d miss = ray.at(X.z(), planes) - X.head<2>();
    const Matrix2d M = mm_per_px(model, view.pixels_px[k], X.z());
    const Matrix2d G = (M * M.transpose()).inverse();
    mx(i) = miss.x();
    my(i) = miss.y();
    gxx(i) = G(0, 0);
    gxy(i) = G(0, 1);
    gyy(i) = G(1, 1);
    // dX = turn x turned + move;  d miss = -dX_xy + slope dX_z
    const Vector2d slope = ray.slope(planes);
    const Vector3d ex(-1, 0, slope.x()), ey(0, -1, slope.y());
    Dx.row(i) << turned.cross(ex).transpose(), ex.transpose();
    Dy.row(i) << turned.cross(ey).transpose(), ey.transpose();
    if (phi.cols() > 0) {
      const double lambda = (X.z() - planes.a_mm) / (planes.b_mm - planes.a_mm);
      A.row(i) << (1.0 - lambda) * phi.row(i), lambda * phi.row(i);
    }
  }
  const VectorXd hx = gxx.cwiseProduct(mx) + gxy.cwiseProduct(my);
  const VectorXd hy = gxy.cwiseProduct(mx) + gyy.cwiseProduct(my);
  const MatrixXd Hx = gxx.asDiagonal() * Dx + gxy.asDiagonal() * Dy;
  const MatrixXd Hy = gxy.asDiagonal() * Dx + gyy.asDiagonal() * Dy;
  const Index c = A.cols();
  MatrixXd& N = normals.N;
  N.block(at, at, 6, 6) += Dx.transpose() * Hx + Dy.transpose() * Hy;
  normals.g.segment(at, 6) += Dx.transpose() * hx + Dy.transpose() * hy;
  normals.sum += mx.dot(hx) + my.dot(hy);
  if (c == 0) return;
  N.block(0, 0, c, c) += A.transpose() * (gxx.asDiagonal() * A);
  N.block(0, c, c, c) += A.transpose() * (gxy.asDiagonal() * A);
  N.block(c, c, c, c) += A.transpose() * (gyy.asDiagonal() * A);
  N.block(0, at, c, 6) += A.transpose() * Hx;
  N.block(c, at, c, 6) += A.transpose() * Hy;
  normals.g.head(c) += A.transpose() * hx;
  normals.g.segment(c, c) += A.transpose() * hy;
  // Below the diagonal too: the solver reads the lower half.
  N.block(c, 0, c, c) = N.block(0, c, c, c).transpose();
  N.block(at, 0, 6, 2 * c) = N.block(0, at, 2 * c, 6).transpose();
}

/// Normal equations to a unit diagonal, damped, with a wall against motion along `held`.
MatrixXd scaled(const Normals& normals, const VectorXd& scale, double damping,
                const MatrixXd& held) {
  MatrixXd S = scale.asDiagonal() * normals.N * scale.asDiagonal();
  // Against a unit diagonal this is as good as a wall, and far enough from the rounding.
  constexpr double kWall = 1e4;
  for (Index k = 0; k < held.cols(); ++k) {
    const VectorXd h = scale.cwiseProduct(held.col(k)).normalized();
    S += kWall * h * h.transpose();
  }
  S.diagonal().array() += damping;
  return S;
}

/// The damped step, and the rms change of the residuals that it should bring, px. Scaled to a unit
/// diagonal; NaN if the equations are singular.
/// @param held columns: combinations of the unknowns that must not move.
struct Step {
  VectorXd unknowns;
  double rms_px = 0.0;
};
Step damped_step(const Normals& normals, double damping, const MatrixXd& held, double points) {
  const VectorXd scale = normals.N.diagonal().cwiseSqrt().cwiseInverse();
  const MatrixXd S = scaled(normals, scale, damping, held);
  const Eigen::LDLT<MatrixXd> ldlt(S);
  Step step;
  const bool regular = ldlt.info() == Eigen::Success && ldlt.vectorD().minCoeff() > kSingular;
  step.unknowns = scale.cwiseProduct(ldlt.solve(-scale.cwiseProduct(normals.g)));
  step.rms_px = regular ? std::sqrt(step.unknowns.dot(normals.N * step.unknowns) / points)
                        : std::numeric_limits<double>::quiet_NaN();
  return step;
}

ViewPose moved(const ViewPose& pose, const VectorXd& unknowns, Index at) {
  ViewPose out = pose;
  out.R_plane_from_target =
      rotation_from_vector(unknowns.segment<3>(at)) * pose.R_plane_from_target;
  out.position_mm += unknowns.segment<3>(at + 3);
  return out;
}

IrtModel moved(const IrtModel& model, const VectorXd& unknowns) {
  const Index terms = model.coefficients().rows();
  Eigen::MatrixX4d c = model.coefficients();
  c.col(0) += unknowns.segment(0, terms);
  c.col(2) += unknowns.segment(terms, terms);
  c.col(1) += unknowns.segment(2 * terms, terms);
  c.col(3) += unknowns.segment(3 * terms, terms);
  return IrtModel(model.image_size(), model.planes(), model.order(), c, model.domain_hull_px());
}

/// Marquardt's iteration over any state. `equations(state)` gives Normals, `move(state, step)` the
/// next state.
struct Iteration {
  double sum = 0.0;
  int steps = 0;
  bool converged = false;
  bool singular = false;
};
template <class State, class Equations, class Move>
Iteration minimise(State& state, const Equations& equations, const Move& move, const MatrixXd& held,
                   double points, double damping = kFirstDamping) {
  Normals here = equations(state);
  Iteration it;
  bool full = false;  // has tried a step that damping did not shorten
  for (it.sum = here.sum; it.steps < kMaxSteps && std::isfinite(here.sum); ++it.steps) {
    const Step step = damped_step(here, damping, held, points);
    it.singular = !std::isfinite(step.rms_px);
    if (it.singular) return it;
    if (step.rms_px < kArrivedPx + kArrived * std::sqrt(here.sum / points)) {
      if (full) {
        it.converged = true;
        return it;
      }
      full = true;
      damping = kLeastDamping;
      continue;
    }
    State next = move(state, step.unknowns);
    Normals there = equations(next);
    if (there.sum <= here.sum) {
      state = std::move(next);
      here = std::move(there);
      it.sum = here.sum;
      damping = std::max(kLeastDamping, 0.03 * damping);
    } else {
      damping = 10.0 * std::max(1e-6, damping);
    }
  }
  return it;
}

MatrixXd basis_of(const FreeView& view, ImageSize size, int order) {
  MatrixXd phi(static_cast<Index>(view.pixels_px.size()), (order + 1) * (order + 2) / 2);
  for (std::size_t i = 0; i < view.pixels_px.size(); ++i)
    phi.row(static_cast<Index>(i)) = basis(view.pixels_px[i], size, order).transpose();
  return phi;
}

std::vector<cv::Point3f> to_points3(const std::vector<Vector3d>& in) {
  std::vector<cv::Point3f> out;
  for (const Vector3d& p : in)
    out.emplace_back(static_cast<float>(p.x()), static_cast<float>(p.y()),
                     static_cast<float>(p.z()));
  return out;
}
std::vector<cv::Point2f> to_points2(const std::vector<Vector2d>& in) {
  std::vector<cv::Point2f> out;
  for (const Vector2d& p : in)
    out.emplace_back(static_cast<float>(p.x()), static_cast<float>(p.y()));
  return out;
}
Vector3d to_vector(const cv::Mat& m) { return {m.at<double>(0), m.at<double>(1), m.at<double>(2)}; }

/// Pixels by the central model and their derivatives (2 x 3 per point) to the points in the plane
/// frame; infinite behind the camera.
constexpr Index kIntrinsics = 8;  // f_u f_v c_u c_v k1 k2 k3 k4
struct CentralPixels {
  std::vector<Vector2d> pixels_px;
  cv::Mat jacobian;  // 2 points x 15: f, c, k, turn, move, skew
  bool in_front = true;
};
CentralPixels project_central(const CentralFit& fit, const ViewPose& pose,
                              std::span<const Vector3d> on_target_mm) {
  CentralPixels out;
  std::vector<cv::Point3d> points;
  for (const Vector3d& p : on_target_mm) {
    const Vector3d X = kTurnedOver * (pose.R_plane_from_target * p + pose.position_mm);
    out.in_front = out.in_front && X.z() > 0.0;
    points.emplace_back(X.x(), X.y(), X.z());
  }
  std::vector<cv::Point2d> pixels;
  const cv::Matx33d K(fit.focal_px.x(), 0, fit.principal_px.x(), 0, fit.focal_px.y(),
                      fit.principal_px.y(), 0, 0, 1);
  const cv::Vec3d zero;
  cv::fisheye::projectPoints(points, pixels, zero, zero, K,
                             cv::Vec4d(fit.k[0], fit.k[1], fit.k[2], fit.k[3]), 0.0, out.jacobian);
  for (const cv::Point2d& p : pixels) out.pixels_px.emplace_back(p.x, p.y);
  return out;
}

void add_central_view(const CentralFit& fit, const FreeView& view, const ViewPose& pose, Index at,
                      Normals& normals) {
  const CentralPixels seen = project_central(fit, pose, view.on_target_mm);
  if (!seen.in_front) normals.sum = INFINITY;
  const auto n = static_cast<Index>(view.pixels_px.size());
  MatrixXd A(2 * n, kIntrinsics), D(2 * n, 6);
  VectorXd miss(2 * n);
  for (Index i = 0; i < n; ++i) {
    const auto k = static_cast<std::size_t>(i);
    miss.segment<2>(2 * i) = seen.pixels_px[k] - view.pixels_px[k];
    const Vector3d turned = pose.R_plane_from_target * view.on_target_mm[k];
    for (Index row = 2 * i; row < 2 * i + 2; ++row) {
      const double* j = seen.jacobian.ptr<double>(static_cast<int>(row));
      for (Index c = 0; c < kIntrinsics; ++c) A(row, c) = j[c];
      const Vector3d to_point = kTurnedOver * Vector3d(j[11], j[12], j[13]);
      D.row(row) << turned.cross(to_point).transpose(), to_point.transpose();
    }
  }
  normals.N.topLeftCorner(kIntrinsics, kIntrinsics) += A.transpose() * A;
  normals.N.block(0, at, kIntrinsics, 6) += A.transpose() * D;
  normals.N.block(at, 0, 6, kIntrinsics) = normals.N.block(0, at, kIntrinsics, 6).transpose();
  normals.N.block(at, at, 6, 6) += D.transpose() * D;
  normals.g.head(kIntrinsics) += A.transpose() * miss;
  normals.g.segment(at, 6) += D.transpose() * miss;
  normals.sum += miss.squaredNorm();
}

/// Pose by SQPNP (Terzakis & Lourakis, "A consistently fast and globally optimal solution to the
/// perspective-n-point problem", ECCV 2020) from tangents (x right, y down), as seen from the plane
/// frame's origin.
ViewPose sqpnp(const std::vector<Vector3d>& on_target_mm, const std::vector<Vector2d>& tangents) {
  ViewPose pose;
  cv::Mat rotation, translation;
  if (tangents.size() >= 4 &&
      cv::solvePnP(to_points3(on_target_mm), to_points2(tangents), cv::Matx33d::eye(),
                   cv::noArray(), rotation, translation, false, cv::SOLVEPNP_SQPNP)) {
    pose.R_plane_from_target = kTurnedOver * rotation_from_vector(to_vector(rotation));
    pose.position_mm = kTurnedOver * to_vector(translation);
  }
  return pose;
}

/// A view's pose as the lens r = f theta sees it, from its points up to 80 deg.
ViewPose first_pose(const CentralFit& lens, const FreeView& view) {
  std::vector<Vector3d> points;
  std::vector<Vector2d> tangents;
  for (std::size_t i = 0; i < view.pixels_px.size(); ++i) {
    const Vector2d angle = (view.pixels_px[i] - lens.principal_px).cwiseQuotient(lens.focal_px);
    const double theta = angle.norm();
    if (theta > 80.0 / 180.0 * std::numbers::pi) continue;
    points.push_back(view.on_target_mm[i]);
    tangents.push_back(theta > 0.0 ? Vector2d(angle * std::tan(theta) / theta) : angle);
  }
  return sqpnp(points, tangents);
}

std::vector<Vector2d> hull_of(std::span<const FreeView> views) {
  std::vector<cv::Point2f> all, hull;
  for (const FreeView& view : views)
    for (const cv::Point2f& p : to_points2(view.pixels_px)) all.push_back(p);
  cv::convexHull(all, hull);  // counter-clockwise for x right, y up, as `in_domain` wants it
  std::vector<Vector2d> out;
  for (const cv::Point2f& p : hull) out.emplace_back(p.x, p.y);
  return out;
}

/// Rays through given poses by linear least squares, as a first guess: M taken as that of a camera
/// without distortion and with a focal length of one image width, whose size does not matter.
IrtModel rays_through(std::span<const FreeView> views, const std::vector<MatrixXd>& phi,
                      std::span<const ViewPose> poses, RayPlanes planes, ImageSize size,
                      int order) {
  const Index terms = phi[0].cols();
  MatrixXd N = MatrixXd::Zero(2 * terms, 2 * terms), rhs = MatrixXd::Zero(2 * terms, 2);
  for (std::size_t k = 0; k < views.size(); ++k) {
    const Index n = phi[k].rows();
    MatrixXd A(n, 2 * terms), b(n, 2);
    for (Index i = 0; i < n; ++i) {
      const Vector3d X =
          poses[k].R_plane_from_target * views[k].on_target_mm[static_cast<std::size_t>(i)] +
          poses[k].position_mm;
      const double lambda = (X.z() - planes.a_mm) / (planes.b_mm - planes.a_mm);
      const double weight = 1.0 / std::abs(X.z());
      A.row(i) << weight * (1.0 - lambda) * phi[k].row(i), weight * lambda * phi[k].row(i);
      b.row(i) = weight * X.head<2>().transpose();
    }
    N += A.transpose() * A;
    rhs += A.transpose() * b;
  }
  // A whiff of damping: what the views do not determine is found out later.
  N.diagonal() *= 1.0 + 1e-12;
  const MatrixXd c = Eigen::LDLT<MatrixXd>(N).solve(rhs);
  Eigen::MatrixX4d coefficients(terms, 4);
  coefficients << c.topRows(terms), c.bottomRows(terms);
  return IrtModel(size, planes, order, coefficients, hull_of(views));
}

struct Scene {
  IrtModel model;
  std::vector<ViewPose> poses;
};

}  // namespace

Vector2d residual_px(const IrtModel& model, const ViewPose& pose, const Vector3d& on_target_mm,
                     const Vector2d& pixel_px) {
  const Vector3d X = pose.R_plane_from_target * on_target_mm + pose.position_mm;
  const Vector2d miss = model.ray(pixel_px).at(X.z(), model.planes()) - X.head<2>();
  return mm_per_px(model, pixel_px, X.z()).inverse() * miss;
}

ViewPose fit_pose(const IrtModel& model, const FreeView& view, const ViewPose& start) {
  assert(view.on_target_mm.size() == view.pixels_px.size());
  const auto n = static_cast<double>(view.pixels_px.size());
  ViewPose pose = start;
  const MatrixXd frozen(static_cast<Index>(view.pixels_px.size()), 0), nothing_held(6, 0);
  const Iteration it = minimise(
      pose,
      [&](const ViewPose& p) {
        Normals normals(6);
        add_view(model, view, frozen, p, 0, normals);
        return normals;
      },
      [](const ViewPose& p, const VectorXd& step) { return moved(p, step, 0); }, nothing_held, n);
  pose.rms_px = std::sqrt(it.sum / n);
  pose.converged = it.converged;
  return pose;
}

ViewPose fit_pose(const IrtModel& model, const FreeView& view) {
  const Vector3d centre = model.bundle_centre().first;
  std::vector<Vector2d> tangents;
  for (const Vector2d& pixel : view.pixels_px) {
    const Vector2d slope = model.ray(pixel).slope(model.planes());
    tangents.emplace_back(-slope.x(), slope.y());
  }
  ViewPose start = sqpnp(view.on_target_mm, tangents);
  start.position_mm += centre;
  return fit_pose(model, view, start);
}

std::vector<Vector2d> CentralFit::project(const ViewPose& pose,
                                          std::span<const Vector3d> on_target_mm) const {
  return project_central(*this, pose, on_target_mm).pixels_px;
}

CentralFit fit_central(std::span<const FreeView> views, ImageSize size) {
  if (views.size() < 3)
    throw Error(fmt::format("free views: found {}, needed at least three, at different tilts.",
                            views.size()));
  std::size_t points = 0;
  for (std::size_t k = 0; k < views.size(); ++k) {
    if (views[k].pixels_px.size() < 6)
      throw Error(fmt::format("free view {}: found {} points, needed at least 6. Leave it out.", k,
                              views[k].pixels_px.size()));
    points += views[k].pixels_px.size();
  }
  const auto equations = [&](const CentralFit& fit) {
    Normals normals(kIntrinsics + 6 * static_cast<Index>(views.size()));
    for (std::size_t k = 0; k < views.size(); ++k)
      add_central_view(fit, views[k], fit.poses[k], kIntrinsics + 6 * static_cast<Index>(k),
                       normals);
    return normals;
  };
  const auto move = [](const CentralFit& fit, const VectorXd& step) {
    CentralFit out = fit;
    out.focal_px += step.head<2>();
    out.principal_px += step.segment<2>(2);
    for (Index i = 0; i < 4; ++i) out.k[static_cast<std::size_t>(i)] += step(4 + i);
    for (std::size_t k = 0; k < fit.poses.size(); ++k)
      out.poses[k] = moved(fit.poses[k], step, kIntrinsics + 6 * static_cast<Index>(k));
    return out;
  };
  const MatrixXd nothing_held(kIntrinsics + 6 * static_cast<Index>(views.size()), 0);

  // One lens angle after another, in image widths, from 180 deg to a tele lens; the two that look
  // best are worked out.
  std::vector<std::pair<double, CentralFit>> starts;
  for (const double widths : {0.2, 0.3, 0.5, 0.8, 1.3, 2.0, 3.5}) {
    CentralFit fit;
    fit.focal_px.setConstant(widths * size.width);
    fit.principal_px = 0.5 * Vector2d(size.width - 1, size.height - 1);
    for (const FreeView& view : views) fit.poses.push_back(first_pose(fit, view));
    starts.emplace_back(equations(fit).sum, fit);
  }
  std::ranges::sort(starts, {}, [](const auto& start) { return start.first; });
  CentralFit best;
  Iteration best_iteration{INFINITY};
  for (std::size_t i = 0; i < 2; ++i) {
    CentralFit fit = starts[i].second;
    const Iteration it = minimise(fit, equations, move, nothing_held, static_cast<double>(points));
    if (it.sum < best_iteration.sum) {
      best = fit;
      best_iteration = it;
    }
  }
  if (!std::isfinite(best_iteration.sum))
    throw Error(
        "free views: no focal length brings the views together. Check that the pixels belong to "
        "the points of the target, and leave out what lies 80 deg or more from the axis.");
  best.rms_px = std::sqrt(best_iteration.sum / static_cast<double>(points));
  best.converged = best_iteration.converged;
  return best;
}

FreeViewsFit fit_rays(std::span<const FreeView> views, ImageSize size, int order,
                      std::span<const ViewPose> start) {
  if (order < 1 || order > kMaxOrder)
    throw Error(fmt::format("polynomial order: found {}, allowed: 1 to {}.", order, kMaxOrder));
  assert(start.empty() || start.size() == views.size());
  std::vector<FreeView> used(views.begin(), views.end());
  std::vector<std::vector<std::size_t>> names;  // point's place in the input
  std::size_t all = 0;
  for (const FreeView& view : views) {
    assert(view.on_target_mm.size() == view.pixels_px.size());
    auto& name = names.emplace_back();
    for (std::size_t i = 0; i < view.pixels_px.size(); ++i) name.push_back(i);
    all += view.pixels_px.size();
  }
  const Index terms = (order + 1) * (order + 2) / 2;
  const Index coefficients = 4 * terms;
  const Index unknowns = coefficients + 6 * static_cast<Index>(views.size());
  if (2.0 * static_cast<double>(all) < 1.5 * static_cast<double>(unknowns))
    throw Error(fmt::format(
        "order {} with {} views has {} unknowns and needs at least {} points, found {}. Show more "
        "of the target or lower the order.",
        order, views.size(), unknowns, (3 * unknowns + 3) / 4, all));

  Scene scene;
  scene.poses = start.empty() ? fit_central(views, size).poses
                              : std::vector<ViewPose>(start.begin(), start.end());
  RayPlanes planes{INFINITY, -INFINITY};
  for (std::size_t k = 0; k < views.size(); ++k)
    for (const Vector3d& p : views[k].on_target_mm) {
      const double z = (scene.poses[k].R_plane_from_target * p + scene.poses[k].position_mm).z();
      planes.a_mm = std::min(planes.a_mm, z);
      planes.b_mm = std::max(planes.b_mm, z);
    }
  std::vector<MatrixXd> phi;
  for (const FreeView& view : used) phi.push_back(basis_of(view, size, order));
  scene.model = rays_through(used, phi, scene.poses, planes, size, order);

  MatrixXd held = MatrixXd::Zero(unknowns, 6);
  for (std::size_t k = 0; k < views.size(); ++k)
    held.block(coefficients + 6 * static_cast<Index>(k), 0, 6, 6).setIdentity();
  const auto equations = [&](const Scene& s) {
    Normals normals(unknowns);
    for (std::size_t k = 0; k < used.size(); ++k)
      add_view(s.model, used[k], phi[k], s.poses[k], coefficients + 6 * static_cast<Index>(k),
               normals);
    return normals;
  };
  const auto move = [&](const Scene& s, const VectorXd& step) {
    Scene out{moved(s.model, step), {}};
    for (std::size_t k = 0; k < s.poses.size(); ++k)
      out.poses.push_back(moved(s.poses[k], step, coefficients + 6 * static_cast<Index>(k)));
    return out;
  };

  FreeViewsFit fit;
  fit.order = order;
  for (;;) {
    const std::size_t count = all - fit.outliers.size();
    const Iteration it = minimise(scene, equations, move, held, static_cast<double>(count),
                                  fit.outliers.empty() ? kFirstDamping : kLeastDamping);
    if (it.singular)
      throw Error(fmt::format(
          "the views do not determine rays of order {}: the target was shown at one tilt or one "
          "distance only, or filled too little of the image. Add tilted views or lower the order.",
          order));
    fit.iterations += it.steps;
    fit.converged = it.converged;
    fit.points = static_cast<int>(count);
    fit.rms_px = std::sqrt(it.sum / static_cast<double>(count));
    fit.sigma_px = std::sqrt(it.sum / std::max(1.0, 2.0 * static_cast<double>(count) -
                                                        static_cast<double>(unknowns - 6)));

    std::vector<std::vector<double>> misses(used.size());
    std::vector<double> sorted;
    for (std::size_t k = 0; k < used.size(); ++k) {
      double sum = 0.0;
      for (std::size_t i = 0; i < used[k].pixels_px.size(); ++i) {
        misses[k].push_back(
            residual_px(scene.model, scene.poses[k], used[k].on_target_mm[i], used[k].pixels_px[i])
                .norm());
        sum += misses[k].back() * misses[k].back();
      }
      scene.poses[k].rms_px = std::sqrt(sum / static_cast<double>(misses[k].size()));
      scene.poses[k].converged = it.converged;
      sorted.insert(sorted.end(), misses[k].begin(), misses[k].end());
    }
    // The median length of a two-dimensional normal error is 1.1774 standard deviations. A wrong
    // point pulls its neighbours along, so only those near the worst go at a time.
    std::ranges::sort(sorted);
    const double limit = std::max({kOutlierSigmas * sorted[sorted.size() / 2] / 1.1774,
                                   kNeverOutlierPx, 0.5 * sorted.back()});
    if (sorted.back() <= limit) break;
    for (std::size_t k = 0; k < used.size(); ++k) {
      for (std::size_t i = used[k].pixels_px.size(); i-- > 0;) {
        if (misses[k][i] <= limit) continue;
        const auto place = static_cast<std::ptrdiff_t>(i);
        fit.outliers.push_back({k, names[k][i]});
        names[k].erase(names[k].begin() + place);
        used[k].pixels_px.erase(used[k].pixels_px.begin() + place);
        used[k].on_target_mm.erase(used[k].on_target_mm.begin() + place);
      }
      phi[k] = basis_of(used[k], size, order);
    }
    if (fit.outliers.size() * 10 > all)
      throw Error(fmt::format(
          "{} of {} points do not fit rays of order {}: not an outlier problem. Look at the images "
          "and at the target's dimensions.",
          fit.outliers.size(), all, order));
  }
  const Normals normals = equations(scene);
  const VectorXd scale = normals.N.diagonal().cwiseSqrt().cwiseInverse();
  const MatrixXd S = scaled(normals, scale, kLeastDamping, held);
  const Index all_poses = 6 * static_cast<Index>(used.size());
  const MatrixXd columns = MatrixXd::Identity(unknowns, unknowns).rightCols(all_poses);
  const MatrixXd covariance = Eigen::LDLT<MatrixXd>(S).solve(columns).bottomRows(all_poses);
  for (std::size_t k = 0; k < used.size(); ++k) {
    const Index at = 6 * static_cast<Index>(k) + 3;
    const double variance = covariance.diagonal()
                                .segment(at, 3)
                                .cwiseProduct(scale.segment(coefficients + at, 3).cwiseAbs2())
                                .sum();
    const double sd_mm = fit.sigma_px * std::sqrt(variance);
    fit.position_sd_mm = std::max(fit.position_sd_mm, sd_mm);
    if (!(sd_mm < kDeterminedPart * scene.poses[k].position_mm.norm()))
      throw Error(fmt::format(
          "the views do not determine rays of order {}: the position of view {} is known to {:.2g} "
          "mm of {:.0f} only. Add views at other tilts and distances or lower the order.",
          order, k, sd_mm, scene.poses[k].position_mm.norm()));
  }
  fit.model = IrtModel(size, planes, order, scene.model.coefficients(), hull_of(used));
  fit.poses = std::move(scene.poses);
  return fit;
}

}  // namespace turntable
