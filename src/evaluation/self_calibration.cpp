#include "src/evaluation/self_calibration.h"

#include <ceres/cost_function.h>
#include <ceres/crs_matrix.h>
#include <ceres/manifold.h>
#include <ceres/problem.h>
#include <ceres/solver.h>
#include <fmt/format.h>

#include <Eigen/SparseCholesky>
#include <cmath>
#include <map>
#include <memory>
#include <numeric>

#include "src/attitude/ray_residual.h"
#include "src/core/errors.h"
#include "src/core/units.h"
#include "src/evaluation/attitude_sensor.h"

namespace turntable {
namespace {

using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

/// Which of kAllAxes have arrivals with an error.
std::vector<std::size_t> erring_axes(const RigModel& model) {
  std::vector<std::size_t> axes;
  for (std::size_t a = 0; a < kAllAxes.size(); ++a)
    if (model.arrival_sd()[a] > 0.0) axes.push_back(a);
  return axes;
}

/// Misses of all LEDs of one pose over the noise factor, by the values and the errors of its arrivals.
class SightingCost : public ceres::CostFunction {
 public:
  SightingCost(const RigModel& model, const RigSighting& sighting, const RayPlanes& planes,
               const std::vector<std::size_t>& axes, const double& noise)
      : model_(model), sighting_(sighting), planes_(planes), axes_(axes), noise_(noise) {
    for (std::size_t i = 0; i < sighting.rays.size(); ++i)
      sighted_.emplace_back(sighting.rays[i], &sighting.spreads[i], planes);
    set_num_residuals(2 * model.points());
    mutable_parameter_block_sizes()->push_back(model.size());
    for (std::size_t k = 0; k < axes.size(); ++k) mutable_parameter_block_sizes()->push_back(1);
  }

  bool Evaluate(double const* const* blocks, double* residuals, double** jacobians) const override {
    const Eigen::Map<const Eigen::VectorXd> values(blocks[0], model_.size());
    TablePosition at = sighting_.at;
    for (std::size_t k = 0; k < axes_.size(); ++k) {
      const double error = model_.arrival_sd()[axes_[k]] * *blocks[k + 1];
      if (kAllAxes[axes_[k]] == AxisId::kStage)
        at.stage_mm += error;
      else
        at.angles[kAllAxes[axes_[k]]] += rad_from_deg(error);
    }
    RigModel::Derivatives derivatives;
    const Eigen::VectorXd leds =
        model_.leds(values, at, jacobians != nullptr ? &derivatives : nullptr);
    for (int i = 0; i < model_.points(); ++i) {
      const Vector3d X = leds.segment<3>(3 * i);
      const RayResidual r = sighted_[static_cast<std::size_t>(i)].residual(X, X.z() - planes_.a_mm);
      for (int c = 0; c < 2; ++c) {
        residuals[2 * i + c] = r.r(c) / noise_;
        if (jacobians == nullptr) continue;
        const Eigen::RowVector3d by_place = r.row(c).transpose() / noise_;
        if (jacobians[0] != nullptr)
          Eigen::Map<Eigen::RowVectorXd>(jacobians[0] + (2 * i + c) * model_.size(),
                                         model_.size()) =
              by_place * derivatives.by_value.middleRows<3>(3 * i);
        for (std::size_t k = 0; k < axes_.size(); ++k)
          if (jacobians[k + 1] != nullptr)
            jacobians[k + 1][2 * i + c] =
                model_.arrival_sd()[axes_[k]] *
                by_place.dot(derivatives.by_axis.block<3, 1>(3 * i, static_cast<int>(axes_[k])));
      }
    }
    return true;
  }

 private:
  const RigModel& model_;
  const RigSighting& sighting_;
  const RayPlanes& planes_;
  const std::vector<std::size_t>& axes_;
  const double& noise_;
  std::vector<Sighted> sighted_;
};

/// (x - expected) / sd, number by number.
class PriorCost : public ceres::CostFunction {
 public:
  PriorCost(Eigen::VectorXd expected, Eigen::VectorXd sd)
      : expected_(std::move(expected)), sd_(std::move(sd)) {
    set_num_residuals(static_cast<int>(sd_.size()));
    mutable_parameter_block_sizes()->push_back(static_cast<int>(sd_.size()));
  }

  bool Evaluate(double const* const* blocks, double* residuals, double** jacobians) const override {
    const Eigen::Index n = sd_.size();
    Eigen::Map<Eigen::VectorXd>(residuals, n) =
        (Eigen::Map<const Eigen::VectorXd>(blocks[0], n) - expected_).cwiseQuotient(sd_);
    if (jacobians != nullptr && jacobians[0] != nullptr)
      Eigen::Map<RowMajor>(jacobians[0], n, n) = sd_.cwiseInverse().asDiagonal();
    return true;
  }

 private:
  Eigen::VectorXd expected_, sd_;
};

/// The least squares problem, with all that it refers to.
class Estimation {
 public:
  Estimation(const RigModel& model, const RigSightings& sightings, std::span<const std::size_t> use,
             const Eigen::VectorXd& start, double noise)
      : model_(model), axes_(erring_axes(model)), values_(start), noise_(noise) {
    problem_.AddParameterBlock(values_.data(), model.size());
    // Places in `errors_` first: the blocks' addresses must not change.
    for (const std::size_t k : use)
      for (const std::size_t a : axes_)
        index_.emplace(std::pair(a, sightings.poses[k].arrivals[a]), index_.size());
    errors_.assign(index_.size(), 0.0);
    for (double& error : errors_) {
      problem_.AddParameterBlock(&error, 1);
      problem_.AddResidualBlock(new PriorCost(Eigen::VectorXd::Zero(1), Eigen::VectorXd::Ones(1)),
                                nullptr, &error);
    }
    problem_.AddResidualBlock(new PriorCost(model.drawing(), model.prior_sd()), nullptr,
                              values_.data());
    for (const std::size_t k : use) {
      const RigSighting& sighting = sightings.poses[k];
      std::vector<double*> blocks{values_.data()};
      for (const std::size_t a : axes_)
        blocks.push_back(&errors_[index_.at({a, sighting.arrivals[a]})]);
      problem_.AddResidualBlock(new SightingCost(model, sighting, sightings.planes, axes_, noise_),
                                nullptr, blocks);
    }
    dof_ = 2.0 * model.points() * static_cast<double>(use.size());
  }
  Estimation(const Estimation&) = delete;
  Estimation& operator=(const Estimation&) = delete;

  void hold(const std::vector<int>& held) {
    for (const int i : held) values_(i) = model_.drawing()(i);
    if (static_cast<int>(held.size()) == model_.size())
      problem_.SetParameterBlockConstant(values_.data());
    else if (!held.empty())
      problem_.SetManifold(values_.data(), new ceres::SubsetManifold(model_.size(), held));
  }

  void solve() {
    ceres::Solver::Options options;
    options.linear_solver_type = ceres::SPARSE_NORMAL_CHOLESKY;
    // Its own arithmetic, in one order: the same digits on every machine.
    options.sparse_linear_algebra_library_type = ceres::EIGEN_SPARSE;
    options.num_threads = 1;
    options.max_num_iterations = 50;
    options.function_tolerance = 1e-12;
    options.gradient_tolerance = 1e-12;
    options.parameter_tolerance = 1e-10;
    options.initial_trust_region_radius = 1e8;  // nearly linear: Gauss-Newton steps
    options.logging_type = ceres::SILENT;
    ceres::Solver::Summary summary;
    ceres::Solve(options, &problem_, &summary);
    iterations_ += static_cast<int>(summary.iterations.size());
    converged_ = summary.termination_type == ceres::CONVERGENCE;
    chi2_ = 2.0 * summary.final_cost;
  }

  /// Of the values, all free.
  Eigen::MatrixXd covariance() {
    ceres::Problem::EvaluateOptions options;
    options.parameter_blocks.push_back(values_.data());
    for (double& error : errors_) options.parameter_blocks.push_back(&error);
    ceres::CRSMatrix J;
    problem_.Evaluate(options, nullptr, nullptr, nullptr, &J);
    const Eigen::Map<const Eigen::SparseMatrix<double, Eigen::RowMajor>> rows(
        J.num_rows, J.num_cols, static_cast<int>(J.values.size()), J.rows.data(), J.cols.data(),
        J.values.data());
    const Eigen::SparseMatrix<double> normal = Eigen::SparseMatrix<double>(rows.transpose()) * rows;
    const Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>> factor(normal);
    Eigen::MatrixXd unit = Eigen::MatrixXd::Zero(J.num_cols, model_.size());
    unit.topRows(model_.size()).setIdentity();
    const Eigen::MatrixXd columns = factor.solve(unit);
    return columns.topRows(model_.size());
  }

  const Eigen::VectorXd& values() const { return values_; }
  double chi2() const { return chi2_; }
  double dof() const { return dof_; }
  int iterations() const { return iterations_; }
  bool converged() const { return converged_; }
  std::size_t arrivals() const { return errors_.size(); }
  double& noise() { return noise_; }

 private:
  const RigModel& model_;
  std::vector<std::size_t> axes_;
  Eigen::VectorXd values_;
  double noise_;
  std::map<std::pair<std::size_t, int>, std::size_t> index_;  ///< (axis, arrival) -> errors_
  std::vector<double> errors_;  ///< of arrivals, in their standard deviations
  ceres::Problem problem_;
  double chi2_ = 0.0, dof_ = 0.0;
  int iterations_ = 0;
  bool converged_ = false;
};

std::vector<std::size_t> all_of(std::size_t count) {
  std::vector<std::size_t> out(count);
  std::iota(out.begin(), out.end(), std::size_t{0});
  return out;
}

}  // namespace

std::string_view verdict_name(Verdict verdict) {
  switch (verdict) {
    case Verdict::kDetermined:
      return "determined";
    case Verdict::kWeak:
      return "weakly determined";
    case Verdict::kHeld:
      return "held";
  }
  return "?";
}

RigSightings rig_sightings(const RunRecord& record, const RigFile& rig,
                           const Calibration& calibration, const Evaluation& evaluation) {
  RigSightings out;
  out.planes = calibration.irt.planes();
  const TargetModel target(rig.target.points_mm);
  const AttitudeSensor camera(calibration, target, default_solver());  // for its rays
  const std::vector<ArrivalNumbers> arrivals = arrival_numbers(record);
  const auto usable = [](const EvaluatedPose& pose) {
    return !pose.points_px.empty() && pose.in_domain && !pose.missed;
  };
  for (const EvaluatedPose& pose : evaluation.poses)
    if (usable(pose) && pose.covariances_px2.empty()) out.noise_stated = false;
  const Eigen::Matrix2d assumed =
      kAssumedSpotSigmaPx * kAssumedSpotSigmaPx * Eigen::Matrix2d::Identity();
  for (std::size_t k = 0; k < evaluation.poses.size(); ++k) {
    const EvaluatedPose& pose = evaluation.poses[k];
    if (!usable(pose)) continue;
    RigSighting& sighting = out.poses.emplace_back();
    out.places.push_back(k);
    sighting.at = {pose.stage_mm,
                   {rad_from_deg(pose.read_back_deg.yaw), rad_from_deg(pose.read_back_deg.roll),
                    rad_from_deg(pose.read_back_deg.pitch)}};
    sighting.arrivals = arrivals[pose.planned.index];
    for (std::size_t i = 0; i < pose.points_px.size(); ++i) {
      sighting.rays.push_back(camera.ray(pose.points_px[i]));
      sighting.spreads.push_back(
          camera.spread(pose.points_px[i], out.noise_stated ? pose.covariances_px2[i] : assumed));
    }
  }
  return out;
}

SelfCalibration self_calibrate(const RigModel& model, const RigSightings& sightings,
                               std::span<const std::size_t> use) {
  const std::vector<std::size_t> all = all_of(sightings.poses.size());
  if (use.empty()) use = all;
  if (use.size() < kMinSightings)
    throw Error(
        fmt::format("{} poses show the whole target, and self-calibration takes at least "
                    "{}. Take more poses.",
                    use.size(), kMinSightings));
  Estimation estimation(model, sightings, use, model.drawing(), 1.0);
  SelfCalibration out;
  out.poses = use.size();
  out.arrivals = estimation.arrivals();
  out.dof = estimation.dof();
  // The noise weighs the images against priors: once it is known, everything again.
  for (int pass = 0; pass < 4; ++pass) {
    estimation.solve();
    const double factor = std::sqrt(estimation.chi2() / out.dof);
    if (pass == 0) out.chi2 = estimation.chi2();
    const double before = estimation.noise();
    const double noise = before * factor;
    estimation.noise() = sightings.noise_stated ? std::max(1.0, noise) : noise;
    if (std::abs(estimation.noise() / before - 1.0) < 1e-3) break;
  }
  out.noise_factor = estimation.noise();
  out.noise_stated = sightings.noise_stated;

  const Eigen::MatrixXd covariance = estimation.covariance();
  out.sd = covariance.diagonal().cwiseSqrt();
  out.correlation =
      out.sd.cwiseInverse().asDiagonal() * covariance * out.sd.cwiseInverse().asDiagonal();
  const Eigen::VectorXd prior = model.prior_sd();
  std::vector<int> held;
  for (int i = 0; i < model.size(); ++i) {
    const double share = out.sd(i) / prior(i);
    out.verdicts.push_back(share > kHeldAbove   ? Verdict::kHeld
                           : share > kWeakAbove ? Verdict::kWeak
                                                : Verdict::kDetermined);
    if (share > kHeldAbove) held.push_back(i);
  }
  if (!held.empty()) {
    for (const int i : held) out.sd(i) = prior(i);
    estimation.hold(held);
    estimation.solve();
  }
  out.values = estimation.values();
  out.iterations = estimation.iterations();
  out.converged = estimation.converged();
  return out;
}

Eigen::VectorXd recalibrate(const RigModel& model, const RigSightings& sightings,
                            std::span<const std::size_t> use, const SelfCalibration& whole) {
  Estimation estimation(model, sightings, use, model.drawing(), whole.noise_factor);
  std::vector<int> held;
  for (int i = 0; i < model.size(); ++i)
    if (whole.held(i)) held.push_back(i);
  estimation.hold(held);
  estimation.solve();
  return estimation.values();
}

}  // namespace turntable
