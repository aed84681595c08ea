// Coefficients of ray models in the form of Table 1 of the paper: rows u^r v^s, columns C_a, D_a,
// C_b, D_b (x and y on plane a, then on plane b), mm, in raw pixels (`IrtModel::monomials`).
#pragma once

#include <span>
#include <string>

#include "src/imaging/irt.h"

namespace turntable {

struct MonomialTable {
  std::string source;  ///< "ours", "published", ...
  int order = 0;
  Eigen::MatrixX4d monomials;  ///< rows by `IrtModel::terms(order)`
};

/// Tables below each other, with their source in the first column. 17 significant digits: raw
/// monomials of a high order cancel each other, and fewer digits would be another camera.
std::string monomials_to_csv(std::span<const MonomialTable> tables);
/// For reading: three digits, as published.
std::string monomials_to_markdown(std::span<const MonomialTable> tables);
/// One tabular environment, three digits.
std::string monomials_to_latex(std::span<const MonomialTable> tables);

}  // namespace turntable
