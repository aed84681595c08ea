#include "src/evaluation/direction_effect.h"

#include <Eigen/Core>
#include <algorithm>
#include <boost/math/distributions/students_t.hpp>
#include <cmath>
#include <limits>
#include <map>
#include <stdexcept>

namespace turntable {

WithInterval direction_effect(std::span<const DirectedError> errors) {
  std::map<std::size_t, Eigen::Index> places;
  std::map<int, Eigen::Index> repeats;
  for (const DirectedError& e : errors) {
    if (e.direction == 0) throw std::invalid_argument("an error that was come to from nowhere");
    places.try_emplace(e.place, static_cast<Eigen::Index>(places.size()));
    repeats.try_emplace(e.repeat, static_cast<Eigen::Index>(repeats.size()));
  }
  const auto n = static_cast<Eigen::Index>(errors.size()),
             p = static_cast<Eigen::Index>(places.size()),
             r = static_cast<Eigen::Index>(repeats.size());
  constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
  const WithInterval nothing{kNaN, {kNaN, kNaN}};
  if (n == 0) return nothing;

  // Columns: repeats, direction, error; first freed of their means over every place, which fits the places' terms.
  Eigen::MatrixXd columns = Eigen::MatrixXd::Zero(n, r + 2),
                  means = Eigen::MatrixXd::Zero(p, r + 2);
  Eigen::VectorXd counts = Eigen::VectorXd::Zero(p);
  for (Eigen::Index i = 0; i < n; ++i) {
    const DirectedError& e = errors[static_cast<std::size_t>(i)];
    columns(i, repeats.at(e.repeat)) = 1.0;
    columns(i, r) = e.direction > 0 ? 0.5 : -0.5;
    columns(i, r + 1) = e.error;
    means.row(places.at(e.place)) += columns.row(i);
    counts(places.at(e.place)) += 1.0;
  }
  for (Eigen::Index i = 0; i < n; ++i) {
    const Eigen::Index place = places.at(errors[static_cast<std::size_t>(i)].place);
    columns.row(i) -= means.row(place) / counts(place);
  }
  // Then of each other, one after the other (Gram-Schmidt, twice for the digits); what the ones before tell is none.
  const double tells = 1e-9 * std::sqrt(static_cast<double>(n));
  Eigen::Index terms = 0;
  for (Eigen::Index c = 0; c < columns.cols(); ++c) {
    for (int pass = 0; pass < 2; ++pass)
      for (Eigen::Index b = 0; b < std::min(c, r); ++b)
        columns.col(c) -= columns.col(b).dot(columns.col(c)) * columns.col(b);
    if (c >= r) continue;
    const double norm = columns.col(c).norm();
    terms += norm > tells;
    columns.col(c) *= norm > tells ? 1.0 / norm : 0.0;
  }
  const auto d = columns.col(r), e = columns.col(r + 1);
  const double squares = d.squaredNorm();
  if (squares <= tells * tells) return nothing;
  const double effect = d.dot(e) / squares;
  const Eigen::Index freedom = n - p - terms - 1;
  if (freedom < 1) return {effect, {kNaN, kNaN}};
  const double sigma =
      std::sqrt((e - effect * d).squaredNorm() / static_cast<double>(freedom) / squares);
  const boost::math::students_t distribution(static_cast<double>(freedom));
  const double half = boost::math::quantile(distribution, 0.975) * sigma;
  return {effect, {effect - half, effect + half}};
}

}  // namespace turntable
