// A report as one page that needs nothing beside it: report.md -> report.html. The text is the
// Markdown's; figures are drawn inline, style and script are built into the program (assets/).
#pragma once

#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "src/core/json_document.h"
#include "src/report/drawing.h"

namespace turntable {

/// Writes <name>.html beside <name>.md. Of raw HTML the Markdown may have "<details><summary>...
/// </summary>" and "</details>", each a paragraph of its own; everything else is shown as text.
/// @param figures those of the text, in "figures" beside it
/// @param poses what the page shows of single poses (`pose_data`), if anything
/// @return the page's path. @throws ConfigError: the Markdown or a picture cannot be read; RecordError.
std::filesystem::path write_html(const std::filesystem::path& markdown,
                                 const std::vector<Figure>& figures, const Json* poses = nullptr);

/// The same page for `PdfPrinter`: figures as images, their marks as paths, which a browser prints in a third of
/// the time of drawings inline, and as vectors all the same; everything unfolded; neither script nor
/// links to files.
/// @throws ConfigError: the Markdown or a picture cannot be read.
std::string page_for_paper(const std::filesystem::path& markdown);

/// "data:<type>;base64,..."
std::string data_uri(std::string_view type, std::string_view bytes);

/// The body of a page: headings with ids, tables that scroll in their own box, no figures yet.
std::string markdown_to_html(std::string_view markdown);

/// gnuplot's SVG as part of a page: no prolog, ids that begin with `prefix`, elements of plots (class
/// "plot") with their solver (data-solver) and poses (data-poses). An SVG whose elements are not those of the
/// figure, point by point, gets no data-poses but the class "unlinked".
std::string inline_svg(std::string_view svg, const Figure& figure, const std::string& prefix);

}  // namespace turntable
