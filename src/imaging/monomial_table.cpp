#include "src/imaging/monomial_table.h"

#include <fmt/format.h>

namespace turntable {
namespace {

/// Calls `row(source, r, s, four coefficients)` for every row of every table.
template <class Row>
void for_each_row(std::span<const MonomialTable> tables, Row&& row) {
  for (const MonomialTable& table : tables) {
    const auto terms = IrtModel::terms(table.order);
    for (std::size_t i = 0; i < terms.size(); ++i)
      row(table.source, terms[i].first, terms[i].second,
          table.monomials.row(static_cast<Eigen::Index>(i)));
  }
}

}  // namespace

std::string monomials_to_csv(std::span<const MonomialTable> tables) {
  std::string out = "source,r,s,C_a_mm,D_a_mm,C_b_mm,D_b_mm\n";
  for_each_row(tables, [&](const std::string& source, int r, int s, const auto& c) {
    out += fmt::format("{},{},{},{:.16e},{:.16e},{:.16e},{:.16e}\n", source, r, s, c(0), c(1), c(2),
                       c(3));
  });
  return out;
}

std::string monomials_to_markdown(std::span<const MonomialTable> tables) {
  std::string out =
      "| source | coefficient of u^r v^s | C a / mm px^-(r+s) | D a / mm px^-(r+s) | "
      "C b / mm px^-(r+s) | D b / mm px^-(r+s) |\n|---|---|--:|--:|--:|--:|\n";
  for_each_row(tables, [&](const std::string& source, int r, int s, const auto& c) {
    out += fmt::format("| {} | {}{} | {:.2e} | {:.2e} | {:.2e} | {:.2e} |\n", source, r, s, c(0),
                       c(1), c(2), c(3));
  });
  return out;
}

std::string monomials_to_latex(std::span<const MonomialTable> tables) {
  // \num of siunitx would want a package; this needs none.
  const auto number = [](double value) {
    const std::string text = fmt::format("{:.2e}", value);
    const auto e = text.find('e');
    return fmt::format("${} \\cdot 10^{{{}}}$", text.substr(0, e), std::stoi(text.substr(e + 1)));
  };
  std::string out = "\\begin{tabular}{llrrrr}\n\\hline\nsource & $r\\,s$";
  for (const char* column : {"C^a", "D^a", "C^b", "D^b"})
    out += fmt::format(" & ${}_{{rs}}$ / mm\\,px$^{{-(r+s)}}$", column);
  out += " \\\\\n\\hline\n";
  for_each_row(tables, [&](const std::string& source, int r, int s, const auto& c) {
    out += fmt::format("{} & {}\\,{} & {} & {} & {} & {} \\\\\n", source, r, s, number(c(0)),
                       number(c(1)), number(c(2)), number(c(3)));
  });
  return out + "\\hline\n\\end{tabular}\n";
}

}  // namespace turntable
