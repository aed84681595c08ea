#include "src/imaging/calibration.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <nlohmann/json.hpp>

#include "src/core/errors.h"
#include "src/core/json_document.h"

namespace turntable {
namespace {

using OrderedJson = nlohmann::ordered_json;

constexpr std::array<const char*, 4> kColumns{"C_a_mm", "D_a_mm", "C_b_mm", "D_b_mm"};

/// Of the products of a matrix's rows, for a file written with seven digits.
constexpr double kRotationTolerance = 1e-6;

constexpr std::array<std::pair<const char*, double ModelRow::*>, 6> kModelNumbers{
    {{"fit_rms_mm", &ModelRow::fit_rms_mm},
     {"fit_max_mm", &ModelRow::fit_max_mm},
     {"held_out_rms_mm", &ModelRow::held_out_rms_mm},
     {"held_out_max_mm", &ModelRow::held_out_max_mm},
     {"held_out_rms_px", &ModelRow::held_out_rms_px},
     {"held_out_max_px", &ModelRow::held_out_max_px}}};
constexpr std::array<std::pair<const char*, double PlaneVisits::*>, 3> kVisitNumbers{
    {{"drift_plane_mm", &PlaneVisits::drift_plane_mm},
     {"repeat_rms_px", &PlaneVisits::repeat_rms_px},
     {"repeat_rms_mm", &PlaneVisits::repeat_rms_mm}}};
constexpr std::array<std::pair<const char*, double Calibration::*>, 4> kFitNumbers{
    {{"loo_rms_mm", &Calibration::loo_rms_mm},
     {"chi2_per_dof", &Calibration::chi2_per_dof},
     {"condition", &Calibration::condition},
     {"max_leverage", &Calibration::max_leverage}}};

constexpr std::array<std::pair<const char*, double OrderRow::*>, 8> kOrderNumbers{
    {{"rms_mm", &OrderRow::rms_mm},
     {"loo_rms_mm", &OrderRow::loo_rms_mm},
     {"held_out_rms_mm", &OrderRow::held_out_rms_mm},
     {"held_out_max_mm", &OrderRow::held_out_max_mm},
     {"outside_rms_mm", &OrderRow::outside_rms_mm},
     {"condition", &OrderRow::condition},
     {"max_leverage", &OrderRow::max_leverage},
     {"chi2_per_dof", &OrderRow::chi2_per_dof}}};
constexpr std::array<std::pair<const char*, int OrderRow::*>, 6> kOrderCounts{
    {{"order", &OrderRow::order},
     {"terms", &OrderRow::terms},
     {"points", &OrderRow::points},
     {"outliers", &OrderRow::outliers},
     {"held_out_points", &OrderRow::held_out_points},
     {"outside_points", &OrderRow::outside_points}}};

constexpr const char* kCovariance = "covariance_lower_mm2";
/// Of a correlation beyond 1, by rounding.
constexpr double kCorrelationTolerance = 1e-9;

OrderedJson pair(const Vector2d& v) { return {v.x(), v.y()}; }
Vector2d pair(const Json& v) { return {v.at(0).get<double>(), v.at(1).get<double>()}; }

/// JSON has no NaN: what is not known is left out.
void put(OrderedJson& object, const char* key, double value) {
  if (std::isfinite(value)) object[key] = value;
}
double get(const Json& object, const char* key) {
  return object.value(key, std::numeric_limits<double>::quiet_NaN());
}

OrderedJson to_json(const CentralModel& m) {
  const Matrix3d& R = m.R_plane_from_camera;
  OrderedJson rows;
  for (Eigen::Index i = 0; i < 3; ++i) rows.push_back({R(i, 0), R(i, 1), R(i, 2)});
  return {{"model", central_name(m.kind)},
          {"fx_px", m.fx},
          {"fy_px", m.fy},
          {"cx_px", m.cx},
          {"cy_px", m.cy},
          {"distortion", m.distortion},
          {"rms_px", m.rms_px},
          {"views", m.views},
          {"tied_to_plane", m.tied_to_plane},
          {"R_plane_from_camera", rows},
          {"centre_mm", {m.centre_mm.x(), m.centre_mm.y(), m.centre_mm.z()}},
          {"lean", pair(m.lean)}};
}

/// `place`: its JSON pointer in file `name`.
CentralModel central_from(const Json& j, ImageSize size, const std::string& name,
                          const std::string& place) {
  CentralModel m;
  for (const CentralKind kind : kCentralKinds)
    if (j.at("model") == central_name(kind)) m.kind = kind;
  m.image_size = size;
  m.fx = j.at("fx_px");
  m.fy = j.at("fy_px");
  m.cx = j.at("cx_px");
  m.cy = j.at("cy_px");
  m.distortion = j.at("distortion").get<std::vector<double>>();
  if (m.distortion.size() != distortion_terms(m.kind))
    throw ConfigError(
        name, place + "/distortion",
        fmt::format("found {} coefficients, allowed: {} for \"{}\".", m.distortion.size(),
                    distortion_terms(m.kind), central_name(m.kind)));
  m.rms_px = j.at("rms_px");
  m.views = j.at("views");
  m.tied_to_plane = j.at("tied_to_plane");
  m.lean = pair(j.at("lean"));
  for (Eigen::Index i = 0; i < 3; ++i) {
    const Json& row = j.at("R_plane_from_camera").at(static_cast<std::size_t>(i));
    m.R_plane_from_camera.row(i) << row.at(0).get<double>(), row.at(1).get<double>(),
        row.at(2).get<double>();
    m.centre_mm(i) = j.at("centre_mm").at(static_cast<std::size_t>(i));
  }
  const double off =
      (m.R_plane_from_camera * m.R_plane_from_camera.transpose() - Matrix3d::Identity())
          .cwiseAbs()
          .maxCoeff();
  if (off > kRotationTolerance || m.R_plane_from_camera.determinant() < 0)
    throw ConfigError(name, place + "/R_plane_from_camera",
                      fmt::format("found a matrix with R R^T off by {:.1e} and determinant {:.6f}, "
                                  "allowed: a rotation (off by {:.0e} at most, determinant 1).",
                                  off, m.R_plane_from_camera.determinant(), kRotationTolerance));
  return m;
}

OrderedJson to_json(const ModelRow& row) {
  OrderedJson j{{"model", row.name}, {"parameters", row.parameters}};
  for (const auto& [key, member] : kModelNumbers) put(j, key, row.*member);
  if (!row.why_not.empty()) j["why_not"] = row.why_not;
  return j;
}

ModelRow model_row_from(const Json& j) {
  ModelRow row;
  row.name = j.at("model");
  row.parameters = j.at("parameters");
  for (const auto& [key, member] : kModelNumbers) row.*member = get(j, key);
  row.why_not = j.value("why_not", "");
  return row;
}

OrderedJson to_json(const OrderRow& row) {
  OrderedJson j;
  for (const auto& [key, member] : kOrderCounts) j[key] = row.*member;
  for (const auto& [key, member] : kOrderNumbers) put(j, key, row.*member);
  if (!row.refused.empty()) j["refused"] = row.refused;
  return j;
}

OrderRow order_row_from(const Json& j) {
  OrderRow row;
  for (const auto& [key, member] : kOrderCounts) row.*member = j.at(key);
  for (const auto& [key, member] : kOrderNumbers) row.*member = get(j, key);
  row.refused = j.value("refused", "");
  return row;
}

OrderedJson to_json(const PlaneResidual& p) {
  OrderedJson j{{"z_mm", p.z_mm}, {"fitted", p.fitted}, {"points", p.points}};
  put(j, "rms_mm", p.rms_mm);
  put(j, "max_mm", p.max_mm);
  put(j, "coverage", p.coverage);
  put(j, "noise_gain", p.noise_gain);
  return j;
}

PlaneResidual plane_from(const Json& j) {
  PlaneResidual p;
  p.z_mm = j.at("z_mm");
  p.fitted = j.at("fitted");
  p.points = j.at("points");
  p.rms_mm = get(j, "rms_mm");
  p.max_mm = get(j, "max_mm");
  p.coverage = get(j, "coverage");
  p.noise_gain = get(j, "noise_gain");
  return p;
}

/// The lower triangle by rows. Row i of the file is row `rows[i]` of the answer.
Eigen::MatrixXd covariance_from(const Json& lower, const std::vector<Eigen::Index>& rows,
                                const std::string& name) {
  const std::string pointer = fmt::format("/irt/{}", kCovariance);
  const std::size_t size = rows.size(), needed = size * (size + 1) / 2;
  if (lower.size() != needed)
    throw ConfigError(name, pointer,
                      fmt::format("found {} numbers, allowed: the lower triangle of {} x {}, {}.",
                                  lower.size(), size, size, needed));
  Eigen::MatrixXd C(static_cast<Eigen::Index>(size), static_cast<Eigen::Index>(size));
  std::size_t at = 0;
  for (std::size_t i = 0; i < size; ++i)
    for (std::size_t j = 0; j <= i; ++j)
      C(rows[i], rows[j]) = C(rows[j], rows[i]) = lower.at(at++).get<double>();
  const auto refuse = [&](std::size_t i, std::size_t j, const std::string& message) {
    throw ConfigError(name, fmt::format("{}/{}", pointer, i * (i + 1) / 2 + j), message);
  };
  for (std::size_t i = 0; i < size; ++i)
    if (const double value = C(rows[i], rows[i]); !(value >= 0))
      refuse(i, i, fmt::format("found a variance of {} mm^2, allowed: 0 or more.", value));
  for (std::size_t i = 0; i < size; ++i)
    for (std::size_t j = 0; j < i; ++j) {
      const double value = C(rows[i], rows[j]);
      const double bound = std::sqrt(C(rows[i], rows[i]) * C(rows[j], rows[j]));
      if (!(std::abs(value) <= bound * (1.0 + kCorrelationTolerance)))
        refuse(
            i, j,
            fmt::format("found {} mm^2, allowed by the variances: {} mm^2 at most.", value, bound));
    }
  return C;
}

}  // namespace

void Calibration::set_irt(const IrtFit& fit, std::span<const PlanePoint> given) {
  irt = fit.model;
  sigma_mm = fit.sigma_mm;
  points = fit.points;
  loo_rms_mm = fit.loo_rms_mm;
  chi2_per_dof = fit.chi2_per_dof;
  condition = fit.condition;
  max_leverage = fit.max_leverage;
  outliers = fit.outliers;
  planes.clear();
  for (const FittedPlane& plane : fit.planes) {
    PlaneResidual row;
    row.z_mm = plane.z_mm;
    row.points = plane.points;
    row.coverage = plane.coverage;
    row.noise_gain = plane.noise_gain;
    double squares = 0.0;
    for (const PointStatistics& p : fit.used) {
      if (given[p.index].z_mm != plane.z_mm) continue;
      squares += p.residual_mm.squaredNorm();
      row.max_mm = std::max(row.max_mm, p.residual_mm.norm());
    }
    row.rms_mm = std::sqrt(squares / std::max(1, plane.points));
    planes.push_back(row);
  }
}

const CentralModel* Calibration::find_central(std::string_view name) const {
  const auto it = std::ranges::find_if(
      central, [&](const CentralModel& m) { return central_name(m.kind) == name; });
  return it == central.end() ? nullptr : &*it;
}

const CentralModel* Calibration::undistorting() const {
  for (const CentralKind kind :
       {CentralKind::kBrown, CentralKind::kRational, CentralKind::kFisheye})
    if (const CentralModel* m = find_central(central_name(kind))) return m;
  return nullptr;
}

std::string calibration_to_json(const Calibration& c) {
  OrderedJson irt{{"plane_a_mm", c.irt.planes().a_mm},
                  {"plane_b_mm", c.irt.planes().b_mm},
                  {"order", c.irt.order()},
                  {"basis", "legendre"}};
  for (const auto& [r, s] : IrtModel::terms(c.irt.order())) irt["terms"].push_back({r, s});
  for (std::size_t k = 0; k < 4; ++k)
    for (Eigen::Index i = 0; i < c.irt.coefficients().rows(); ++i)
      irt[kColumns[k]].push_back(c.irt.coefficients()(i, static_cast<Eigen::Index>(k)));
  for (const Vector2d& p : c.irt.domain_hull_px()) irt["domain_px"].push_back(pair(p));
  irt["sigma_mm"] = c.sigma_mm;
  irt["points"] = c.points;
  for (const auto& [key, member] : kFitNumbers) put(irt, key, c.*member);
  const Eigen::MatrixXd& C = c.irt.covariance();
  for (Eigen::Index i = 0; i < C.rows(); ++i)
    for (Eigen::Index j = 0; j <= i; ++j) irt[kCovariance].push_back(C(i, j));
  irt["planes"] = OrderedJson::array();
  for (const PlaneResidual& p : c.planes) irt["planes"].push_back(to_json(p));
  irt["outliers"] = OrderedJson::array();
  for (const PlanePoint& p : c.outliers)
    irt["outliers"].push_back(
        {{"z_mm", p.z_mm}, {"column", p.column}, {"row", p.row}, {"pixel_px", pair(p.pixel_px)}});
  OrderedJson json{{"format", "turntable-calibration/1"},
                   {"source", c.source},
                   {"simulated", c.simulated},
                   {"image_size_px", {c.irt.image_size().width, c.irt.image_size().height}},
                   {"irt", irt}};
  for (const CentralModel& m : c.central) json["central"].push_back(to_json(m));
  for (const OrderRow& row : c.orders) json["orders"].push_back(to_json(row));
  for (const ModelRow& row : c.models) json["models"].push_back(to_json(row));
  for (const PlaneVisits& p : c.stage) {
    OrderedJson visits{{"z_mm", p.z_mm},
                       {"read_back_mm", p.stage_mm},
                       {"visits", p.visits},
                       {"drift_mm", p.drift_mm}};
    if (p.drift_px.allFinite()) visits["drift_px"] = {p.drift_px.x(), p.drift_px.y()};
    for (const auto& [key, member] : kVisitNumbers) put(visits, key, p.*member);
    json["stage"].push_back(visits);
  }
  for (const UsedImage& i : c.images)
    json["images"].push_back({{"file", i.file}, {"sha256", i.sha256}});
  return json.dump(1) + "\n";
}

Calibration parse_calibration(const std::string& text, const std::string& name) {
  const Json json = parse_json(text, name, "calibration");
  const Json& irt = json.at("irt");
  Calibration c;
  c.source = json.at("source");
  c.simulated = json.value("simulated", false);
  const ImageSize size{json.at("image_size_px").at(0), json.at("image_size_px").at(1)};
  const RayPlanes planes{irt.at("plane_a_mm"), irt.at("plane_b_mm")};
  if (!(planes.a_mm < planes.b_mm))
    throw ConfigError(
        name, "/irt/plane_b_mm",
        fmt::format("found {} mm, allowed: above plane_a_mm ({} mm).", planes.b_mm, planes.a_mm));

  const int order = irt.at("order");
  const auto terms = IrtModel::terms(order);
  Eigen::MatrixX4d coefficients =
      Eigen::MatrixX4d::Zero(static_cast<Eigen::Index>(terms.size()), 4);
  if (irt.at("terms").size() != terms.size())
    throw ConfigError(name, "/irt/terms",
                      fmt::format("found {} terms, allowed: {} for order {}.",
                                  irt.at("terms").size(), terms.size(), order));
  std::vector<bool> seen(terms.size(), false);
  std::vector<Eigen::Index> rows(2 * terms.size());  // of the file's terms on plane a, then b
  for (std::size_t k = 0; k < 4; ++k)
    if (irt.at(kColumns[k]).size() != terms.size())
      throw ConfigError(name, fmt::format("/irt/{}", kColumns[k]),
                        fmt::format("found {} coefficients, allowed: one per term, {}.",
                                    irt.at(kColumns[k]).size(), terms.size()));
  for (std::size_t i = 0; i < terms.size(); ++i) {
    const std::pair<int, int> term(irt.at("terms").at(i).at(0), irt.at("terms").at(i).at(1));
    const auto row = static_cast<std::size_t>(std::ranges::find(terms, term) - terms.begin());
    if (row == terms.size() || seen[row])
      throw ConfigError(name, fmt::format("/irt/terms/{}", i),
                        fmt::format("found [{}, {}], allowed: each [r, s] with r + s <= {} once.",
                                    term.first, term.second, order));
    seen[row] = true;
    rows[i] = static_cast<Eigen::Index>(row);
    rows[terms.size() + i] = static_cast<Eigen::Index>(terms.size() + row);
    for (std::size_t k = 0; k < 4; ++k)
      coefficients(static_cast<Eigen::Index>(row), static_cast<Eigen::Index>(k)) =
          irt.at(kColumns[k]).at(i);
  }
  std::vector<Vector2d> hull;
  if (irt.contains("domain_px"))
    for (const Json& p : irt.at("domain_px")) hull.push_back(pair(p));
  else
    hull = {{0, 0},
            {size.width - 1.0, 0},
            {size.width - 1.0, size.height - 1.0},
            {0, size.height - 1.0}};

  const VDirection v =
      irt.value("v_direction", "down") == std::string("up") ? VDirection::kUp : VDirection::kDown;
  const bool monomial = irt.at("basis") == "monomial";
  if (v == VDirection::kUp && !monomial)
    throw ConfigError(name, "/irt/v_direction",
                      "found \"up\", allowed: only with \"basis\": \"monomial\".");
  c.irt = monomial ? IrtModel::from_monomials(size, planes, order, coefficients, v, hull)
                   : IrtModel(size, planes, order, coefficients, hull);
  check_handedness(c.irt, name);
  if (irt.contains(kCovariance)) {
    if (monomial)
      throw ConfigError(name, fmt::format("/irt/{}", kCovariance),
                        "found with \"basis\": \"monomial\", allowed: with \"legendre\" only.");
    c.irt.set_covariance(covariance_from(irt.at(kCovariance), rows, name));
  }

  c.sigma_mm = irt.value("sigma_mm", 0.0);
  c.points = irt.value("points", 0);
  for (const Json& p : irt.value("planes", Json::array())) c.planes.push_back(plane_from(p));
  for (const Json& p : irt.value("outliers", Json::array())) {
    PlanePoint point;
    point.z_mm = p.at("z_mm");
    point.column = p.at("column");
    point.row = p.at("row");
    point.pixel_px = pair(p.at("pixel_px"));
    c.outliers.push_back(point);
  }
  for (const auto& [key, member] : kFitNumbers) c.*member = get(irt, key);
  for (const Json& j : json.value("central", Json::array())) {
    const std::string place = fmt::format("/central/{}", c.central.size());
    if (c.find_central(j.at("model").get<std::string>()))
      throw ConfigError(
          name, place + "/model",
          fmt::format("found {} a second time, allowed: each model once.", j.at("model").dump()));
    c.central.push_back(central_from(j, size, name, place));
  }
  for (const Json& j : json.value("orders", Json::array())) c.orders.push_back(order_row_from(j));
  for (const Json& j : json.value("models", Json::array())) c.models.push_back(model_row_from(j));
  for (const Json& j : json.value("stage", Json::array())) {
    c.stage.push_back(
        {j.at("z_mm"), j.at("read_back_mm"), j.at("visits"), j.at("drift_mm"), Vector2d(NAN, NAN)});
    if (j.contains("drift_px"))
      c.stage.back().drift_px = {j.at("drift_px").at(0).get<double>(),
                                 j.at("drift_px").at(1).get<double>()};
    for (const auto& [key, member] : kVisitNumbers) c.stage.back().*member = get(j, key);
  }
  for (const Json& j : json.value("images", Json::array()))
    c.images.push_back({j.at("file"), j.at("sha256")});
  return c;
}

Calibration load_calibration(const std::filesystem::path& file) {
  return parse_calibration(read_text(file), file.string());
}

}  // namespace turntable
