#include "src/report/published.h"

#include <fmt/format.h>

#include <nlohmann/json.hpp>

#include "published_tables.h"
#include "src/imaging/irt.h"

namespace turntable {
namespace {

using Json = nlohmann::json;

const Json& tables() {
  static const Json json = Json::parse(embedded::published_tables().front().second);
  return json;
}

PublishedTable read(const Json& t) {
  PublishedTable table{t.at("title"), {}};
  for (const auto& [key, method] :
       {std::pair("POSIT", "POSIT"), std::pair("IRT_AOPIT", "IRT-AOPIT")})
    for (int repeat = 1; const Json& r : t.at(key)) {
      const Json &max = r.at("max_error_deg"), &rmse = r.at("rmse_deg");
      table.rows.push_back({method, repeat++, max.at("pitch"), max.at("roll"), max.at("yaw"),
                            rmse.at("pitch"), rmse.at("roll"), rmse.at("yaw"),
                            r.at("total_rmse_deg")});
    }
  return table;
}

}  // namespace

const PublishedTable& published_table(int number) {
  static const std::map<int, PublishedTable> all = [] {
    std::map<int, PublishedTable> m;
    for (const int n : {3, 4, 5}) m[n] = read(tables().at(fmt::format("table{}", n)));
    return m;
  }();
  return all.at(number);
}

const PublishedCoefficients& published_coefficients() {
  static const PublishedCoefficients published = [] {
    const Json& t = tables().at("table1");
    PublishedCoefficients p;
    p.order = t.at("order");
    p.plane_a_mm = t.at("plane_a_mm");
    p.plane_b_mm = t.at("plane_b_mm");
    const auto terms = IrtModel::terms(p.order);
    p.monomials.resize(static_cast<Eigen::Index>(terms.size()), 4);
    for (Eigen::Index i = 0; i < p.monomials.rows(); ++i) {
      const auto [r, s] = terms[static_cast<std::size_t>(i)];
      for (Eigen::Index k = 0; const char* name : {"C_a", "D_a", "C_b", "D_b"})
        p.monomials(i, k++) = t.at(name).at(fmt::format("{}{}", r, s));
    }
    return p;
  }();
  return published;
}

const std::map<int, double>& published_plane_residuals_mm() {
  static const std::map<int, double> published = [] {
    const Json& f = tables().at("figure10_max_projection_error_mm");
    return std::map<int, double>{
        {0, f.at("base")},
        {static_cast<int>(published_coefficients().plane_a_mm), f.at("plane_a")},
        {static_cast<int>(published_coefficients().plane_b_mm), f.at("plane_b")}};
  }();
  return published;
}

}  // namespace turntable
