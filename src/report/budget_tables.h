// The error budget as tables and text.
#pragma once

#include <string>
#include <vector>

#include "src/evaluation/error_budget.h"
#include "src/record/run_folder.h"
#include "src/report/table.h"

namespace turntable {

/// Writes tables/budget.csv (every scenario, solver and line), budget.{md,tex} (the scenario that turns
/// the most axes, a column for each solver, as drawn) and budget_found.{csv,md,tex} (the same as found,
/// if anything was). Nothing of no budgets. @throws RecordError.
std::vector<WrittenTable> write_budget_tables(const RunFolder& folder, const Plan& plan,
                                              const std::vector<ErrorBudget>& budgets);

/// The section "Error budget" of report.md. @param written tables of the run, this among them
std::string budget_text(const std::vector<WrittenTable>& written, const Plan& plan,
                        const std::vector<ErrorBudget>& budgets);

/// The scenario that the report shows: most axes, then most poses. @pre budgets is not empty.
std::size_t shown_scenario(const Plan& plan, const std::vector<ErrorBudget>& budgets);

}  // namespace turntable
