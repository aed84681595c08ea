#include "src/report/budget_tables.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "src/record/csv.h"
#include "src/record/folder.h"

namespace turntable {
namespace {

void add_contribution(std::vector<Cell>& row, const std::optional<Contribution>& c) {
  if (!c) {
    row.resize(row.size() + 4);
    return;
  }
  for (const double axis : c->axis_deg) row.emplace_back(axis);
  row.emplace_back(c->total_deg());
}

/// Every line of every budget.
Table long_table(const Plan& plan, const std::vector<ErrorBudget>& budgets) {
  Table table{"budget",
              "",
              {{"scenario", ""},
               {"solver", ""},
               {"poses", ""},
               {"left_out", ""},
               {"line", ""},
               {"amount", ""},
               {"drawn_pitch_deg", ""},
               {"drawn_roll_deg", ""},
               {"drawn_yaw_deg", ""},
               {"drawn_total_deg", ""},
               {"found_pitch_deg", ""},
               {"found_roll_deg", ""},
               {"found_yaw_deg", ""},
               {"found_total_deg", ""}},
              {}};
  for (const ErrorBudget& b : budgets) {
    const auto row = [&](std::string line, std::string amount,
                         const std::optional<Contribution>& drawn,
                         const std::optional<Contribution>& found) {
      std::vector<Cell> cells{plan.scenarios[b.scenario].name,
                              std::string(b.solver->name),
                              static_cast<std::int64_t>(b.poses),
                              static_cast<std::int64_t>(b.left_out),
                              std::move(line),
                              std::move(amount)};
      add_contribution(cells, drawn);
      add_contribution(cells, found);
      table.rows.push_back(std::move(cells));
    };
    for (const BudgetLine& line : b.lines)
      row(std::string(cause_name(line.cause)), line.amount, line.drawn, line.found);
    row("all together", "root of the sum of squares; found: pose by pose", b.drawn, b.found);
    const auto only_total = [&](std::string line, double total) {
      row(std::move(line), fmt::format("{} drawn rigs", kBudgetDraws), {}, {});
      table.rows.back()[9] = total;
    };
    only_total("drawn rigs: root mean square", b.monte_carlo_deg.value);
    only_total("drawn rigs: 2.5 % below", b.monte_carlo_deg.interval.lower);
    only_total("drawn rigs: 97.5 % below", b.monte_carlo_deg.interval.upper);
    row("observed", "as in the tables, over the same poses", {}, b.observed);
  }
  return table;
}

using Budgets = std::vector<const ErrorBudget*>;

/// One scenario: lines down, solvers across, totals only; of a rig as drawn, or of this one as found.
Table shown_table(const Plan& plan, const Budgets& budgets, bool as_found) {
  Table table{as_found ? "budget_found" : "budget",
              fmt::format("Error budget of {}, {}: contributions to the total RMSE, deg",
                          as_found ? "this rig as found" : "a rig built to its drawings",
                          plan.scenarios[budgets.front()->scenario].title),
              {{"scenario", ""}, {"line", "cause"}},
              {}};
  for (const ErrorBudget* b : budgets)
    table.columns.push_back({fmt::format("{}_deg", b->solver->name), std::string(b->solver->name)});
  if (!as_found) table.columns.push_back({"amount", "amount and source (standard uncertainty)"});
  const auto row = [&](std::string line, const std::string& amount, auto&& of_budget) {
    std::vector<Cell> cells{plan.scenarios[budgets.front()->scenario].name, std::move(line)};
    for (const ErrorBudget* b : budgets) cells.emplace_back(of_budget(*b));
    if (!as_found) cells.emplace_back(amount);
    table.rows.push_back(std::move(cells));
  };
  for (std::size_t i = 0; i < budgets.front()->lines.size(); ++i) {
    const BudgetLine& line = budgets.front()->lines[i];
    row(std::string(cause_name(line.cause)), line.amount, [&](const ErrorBudget& b) {
      return (as_found ? *b.lines[i].found : b.lines[i].drawn).total_deg();
    });
  }
  row(as_found ? "all together, pose by pose" : "all together", "root of the sum of squares",
      [&](const ErrorBudget& b) { return (as_found ? *b.found : b.drawn).total_deg(); });
  if (!as_found)
    row("rigs drawn from these tolerances [95 % of them]", fmt::format("{} rigs", kBudgetDraws),
        [](const ErrorBudget& b) { return b.monte_carlo_deg; });
  if (as_found || !budgets.front()->found)
    row("observed", "over the same poses",
        [](const ErrorBudget& b) { return b.observed.total_deg(); });
  return table;
}

Budgets of_scenario(const std::vector<ErrorBudget>& budgets, std::size_t scenario) {
  Budgets out;
  for (const ErrorBudget& b : budgets)
    if (b.scenario == scenario) out.push_back(&b);
  return out;
}

}  // namespace

std::size_t shown_scenario(const Plan& plan, const std::vector<ErrorBudget>& budgets) {
  const auto rank = [&](const ErrorBudget& b) {
    return std::pair(plan.scenarios[b.scenario].axes.size(), b.poses);
  };
  return std::ranges::max_element(budgets, {}, rank)->scenario;
}

std::vector<WrittenTable> write_budget_tables(const RunFolder& folder, const Plan& plan,
                                              const std::vector<ErrorBudget>& budgets) {
  if (budgets.empty()) return {};
  make_folder(folder.tables());
  const Budgets shown = of_scenario(budgets, shown_scenario(plan, budgets));
  std::vector<WrittenTable> written{
      write_table(long_table(plan, budgets), shown_table(plan, shown, false), folder.tables())};
  if (shown.front()->found)
    written.push_back(write_table(shown_table(plan, shown, true), folder.tables()));
  return written;
}

std::string budget_text(const std::vector<WrittenTable>& written, const Plan& plan,
                        const std::vector<ErrorBudget>& budgets) {
  const WrittenTable* table = find_table(written, "budget");
  if (table == nullptr) return {};
  const Budgets shown = of_scenario(budgets, shown_scenario(plan, budgets));
  std::string md =
      "## Error budget\n\n"
      "Where the errors of the level \"as published\" come from. *Drawn*: what "
      "each "
      "tolerance of the rig file lets expect of a rig that is built to its drawings, before "
      "anything is measured; lines add as squares "
      "(GUM), and rigs drawn at random from the same tolerances, solved without anything "
      "linearised, check the sum. ";
  if (shown.front()->found)
    md +=
        "*Found*: the same lines with the values that self-calibration found in this run. These "
        "are numbers and no tolerances: they add up pose by pose and may cancel. The lines of "
        "noise are the same in both. What the observed total exceeds the prediction by, nothing "
        "here explains.\n\n";
  else
    md += "What this rig turned out to be is not known: self-calibration was not possible.\n\n";
  md += fmt::format("### {}\n\n{}\n", markdown_text(table->title), table->markdown);
  if (const WrittenTable* found = find_table(written, "budget_found"))
    md += fmt::format("### {}\n\n{}\n", markdown_text(found->title), found->markdown);
  for (const ErrorBudget* b : shown)
    if (b->found)
      md += fmt::format(
          "- `{}`: predicted {} deg, observed {} deg: {:+.0f} %{}\n", b->solver->name,
          fixed(b->found->total_deg(), 4), fixed(b->observed.total_deg(), 4),
          std::round(100.0 * (b->found->total_deg() / b->observed.total_deg() - 1.0)) + 0.0,
          b->left_out == 0
              ? ""
              : fmt::format(" ({} poses left out, near which the solver jumps)", b->left_out));
  return md + "\nEvery scenario, axis by axis: `tables/budget.csv`.\n\n";
}

}  // namespace turntable
