#include "src/imaging/calibration.h"

#include <fmt/format.h>

#include <array>
#include <nlohmann/json.hpp>

#include "src/core/errors.h"
#include "src/core/json_document.h"
#include "src/core/units.h"

namespace turntable {
namespace {

using OrderedJson = nlohmann::ordered_json;

constexpr std::array<const char*, 4> kColumns{"C_a_mm", "D_a_mm", "C_b_mm", "D_b_mm"};

OrderedJson pair(const Vector2d& v) { return {v.x(), v.y()}; }
Vector2d pair(const Json& v) { return {v.at(0).get<double>(), v.at(1).get<double>()}; }

OrderedJson to_json(const PinholeModel& m) {
  const Vector3d v = vector_from_rotation(m.R_plane_from_camera) * kDegPerRad;
  return {{"fx_px", m.fx},
          {"fy_px", m.fy},
          {"cx_px", m.cx},
          {"cy_px", m.cy},
          {"distortion_k1_k2_p1_p2_k3", m.distortion},
          {"rms_px", m.rms_px},
          {"views", m.views},
          {"rotation_plane_from_camera_deg", {v.x(), v.y(), v.z()}}};
}

PinholeModel pinhole_from(const Json& j) {
  PinholeModel m;
  m.fx = j.at("fx_px");
  m.fy = j.at("fy_px");
  m.cx = j.at("cx_px");
  m.cy = j.at("cy_px");
  m.distortion = j.at("distortion_k1_k2_p1_p2_k3").get<std::array<double, 5>>();
  m.rms_px = j.at("rms_px");
  m.views = j.at("views");
  const auto v = j.at("rotation_plane_from_camera_deg").get<std::array<double, 3>>();
  m.R_plane_from_camera = rotation_from_vector(Vector3d(v[0], v[1], v[2]) / kDegPerRad);
  return m;
}

}  // namespace

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
  irt["planes"] = OrderedJson::array();
  for (const PlaneResidual& p : c.planes)
    irt["planes"].push_back({{"z_mm", p.z_mm},
                             {"fitted", p.fitted},
                             {"points", p.points},
                             {"rms_mm", p.rms_mm},
                             {"max_mm", p.max_mm}});
  irt["outliers"] = OrderedJson::array();
  for (const PlanePoint& p : c.outliers)
    irt["outliers"].push_back(
        {{"z_mm", p.z_mm}, {"column", p.column}, {"row", p.row}, {"pixel_px", pair(p.pixel_px)}});
  OrderedJson json{{"format", "turntable-calibration/1"},
                   {"source", c.source},
                   {"simulated", c.simulated},
                   {"image_size_px", {c.irt.image_size().width, c.irt.image_size().height}},
                   {"irt", irt}};
  if (c.pinhole) json["pinhole"] = to_json(*c.pinhole);
  if (c.pinhole_distorted) json["pinhole_distorted"] = to_json(*c.pinhole_distorted);
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

  c.sigma_mm = irt.value("sigma_mm", 0.0);
  c.points = irt.value("points", 0);
  for (const Json& p : irt.value("planes", Json::array()))
    c.planes.push_back(
        {p.at("z_mm"), p.at("fitted"), p.at("points"), p.at("rms_mm"), p.at("max_mm")});
  for (const Json& p : irt.value("outliers", Json::array())) {
    PlanePoint point;
    point.z_mm = p.at("z_mm");
    point.column = p.at("column");
    point.row = p.at("row");
    point.pixel_px = pair(p.at("pixel_px"));
    c.outliers.push_back(point);
  }
  if (json.contains("pinhole")) c.pinhole = pinhole_from(json.at("pinhole"));
  if (json.contains("pinhole_distorted"))
    c.pinhole_distorted = pinhole_from(json.at("pinhole_distorted"));
  return c;
}

Calibration load_calibration(const std::filesystem::path& file) {
  return parse_calibration(read_text(file), file.string());
}

}  // namespace turntable
