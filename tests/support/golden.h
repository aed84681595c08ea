// Golden numbers: computed in double precision by an implementation outside this project. A lab
// that wants to check its build against numbers of its own points TURNTABLE_GOLDEN to a folder with
// files of the same names and shape.
#pragma once

#include <gtest/gtest.h>

#include <Eigen/Core>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <limits>
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <string>
#include <vector>

namespace turntable::golden {

/// What golden numbers are held to: rotation entries, statistics, and heights relative to
/// themselves.
constexpr double kAgreement = 1e-9;

inline std::filesystem::path folder() {
  if (const char* named = std::getenv("TURNTABLE_GOLDEN"); named != nullptr && *named != '\0')
    return named;
  return std::filesystem::path(TURNTABLE_SOURCE_DIR) / "tests" / "data" / "golden";
}

/// Says how many cases agreed and how closely; fails if there was none.
inline void report(const std::string& what, std::size_t cases, double worst) {
  EXPECT_GT(cases, 0u) << what;
  std::cout << what << ": " << cases << " cases, largest difference " << worst << "\n";
}

/// The file, with at least one case. @throws std::runtime_error if it is missing, is not JSON or
/// holds no case: a test that compares nothing must not pass. Give it a name: a range-for over a
/// temporary's cases sees none.
inline nlohmann::json load(const std::string& name) {
  const std::filesystem::path file = folder() / name;
  std::ifstream in(file);
  if (!in) throw std::runtime_error(file.string() + " cannot be read");
  nlohmann::json document = nlohmann::json::parse(in);
  if (!document.contains("cases") || !document.at("cases").is_array() ||
      document.at("cases").empty())
    throw std::runtime_error(file.string() + " holds no case");
  return document;
}

template <int N>
Eigen::Matrix<double, N, 1> vector(const nlohmann::json& json) {
  if (json.size() != static_cast<std::size_t>(N))
    throw std::runtime_error("expected " + std::to_string(N) + " numbers: " + json.dump());
  Eigen::Matrix<double, N, 1> out;
  for (int i = 0; i < N; ++i) out(i) = json.at(static_cast<std::size_t>(i)).get<double>();
  return out;
}

inline Eigen::Matrix3d matrix3(const nlohmann::json& json) {
  if (json.size() != 3) throw std::runtime_error("expected three rows: " + json.dump());
  Eigen::Matrix3d out;
  for (int i = 0; i < 3; ++i)
    out.row(i) = vector<3>(json.at(static_cast<std::size_t>(i))).transpose();
  return out;
}

template <int N>
std::vector<Eigen::Matrix<double, N, 1>> vectors(const nlohmann::json& json) {
  std::vector<Eigen::Matrix<double, N, 1>> out;
  for (const auto& row : json) out.push_back(vector<N>(row));
  return out;
}

template <class A, class B>
double largest_difference(const A& a, const B& b) {
  // NaN compares as infinitely far away.
  const double difference = (a - b).cwiseAbs().maxCoeff();
  return (a - b).allFinite() ? difference : std::numeric_limits<double>::infinity();
}

}  // namespace turntable::golden
