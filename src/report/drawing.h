// Pictures by gnuplot: data as CSV, a script beside it, and the SVG that it draws. Data and script
// are kept, so that anybody can draw them again, or otherwise.
#pragma once

#include <array>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

namespace turntable {

// Okabe & Ito (2008): told apart by colour-blind readers and in grey.
inline constexpr std::array<const char*, 6> kColours{"#0072B2", "#D55E00", "#009E73",
                                                     "#CC79A7", "#E69F00", "#56B4E9"};

struct Figure {
  std::string name;  ///< file stem in figures/
  std::string caption;
  bool drawn = false;  ///< figures/<name>.svg exists
};

/// A figure being made: its data lie in <name>.csv, and gnuplot shows them.
struct Draft {
  Figure figure;
  std::string commands;  ///< the plot, with 'DATA', in quotes, for the data file
  std::string size = "900,560";
};

/// Writes the scripts and draws them on all cores. Without gnuplot, or where it fails, a figure is
/// not `drawn`, and everything else is there. @throws RecordError.
std::vector<Figure> draw(const std::filesystem::path& folder, const std::vector<Draft>& drafts);

/// One picture and nothing beside it. @param csv its data @return SVG.
/// @throws ConfigError if there is no gnuplot, or it fails; RecordError.
std::string draw_svg(const Draft& draft, std::string_view csv);

/// Markdown of the figures, for a text beside the folder "figures".
std::string figures_markdown(const std::vector<Figure>& figures);

}  // namespace turntable
