// Pictures by gnuplot: data as CSV, a script beside it, and the SVG that it draws. Data and script
// are kept, so that anybody can draw them again, or otherwise.
#pragma once

#include <array>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "src/attitude/solver.h"
#include "src/record/csv.h"
#include "src/record/image_archive.h"

namespace turntable {

// Okabe & Ito (2008): told apart by colour-blind readers and in grey.
inline constexpr std::array<const char*, 6> kColours{"#0072B2", "#D55E00", "#009E73",
                                                     "#CC79A7", "#E69F00", "#56B4E9"};
/// Pale to dark, so that it reads in grey and a small value recedes: every map of errors. In steps,
/// so that a colour is found again on the scale.
inline constexpr const char* kHeat =
    "set palette maxcolors 20\nset palette defined (0 '#fdebc8', 0.35 '#E69F00', 0.7 '#a63c06', 1 "
    "'#3d1002')\n";

/// What one element of a plot command shows: the page hides it with its solver, and finds a pose in it.
struct Element {
  std::string solver;              ///< name; empty: of no single solver
  std::vector<std::size_t> poses;  ///< index of every point's pose, as they are drawn; may be empty
};

struct Figure {
  std::string name;  ///< file stem in figures/
  std::string caption;
  bool drawn = false;  ///< figures/<name>.svg exists
  /// Of all its plot commands, in their order; empty if the figure is drawn by commands alone.
  std::vector<Element> elements = {};
};

/// An entry of a key.
struct KeyEntry {
  std::string look;    ///< "points pt 4 title '...'", such as "lines " + `solver_line`
  std::string solver;  ///< that is hidden with it; empty: of no single solver
};

/// A figure being made: its data lie in <name>.csv, and gnuplot shows them.
struct Draft {
  Figure figure;
  std::string commands;  ///< the plot, with 'DATA', in quotes, for the data file
  std::string size = "900,560";

  /// Adds an element to the plot command being written, or begins one ("plot", "splot") where a line
  /// begins. gnuplot does not write into the SVG what it shows: a figure with one such element adds
  /// all of its elements this way, and the page tells them by their order.
  Draft& element(std::string_view text, Element shows = {}, std::string_view command = "plot");
  /// Ends the plot command.
  Draft& end_plot();
  /// Draws the key of all panels of a multiplot, which have "set key off", and ends it. It is a panel
  /// of its own over the whole picture: of a key that is higher than its panel gnuplot leaves entries
  /// out or puts them on the data.
  /// @param left of the key, 0 to 1, behind the panels
  Draft& end_multiplot(double left, const std::vector<KeyEntry>& key);
};

/// The colour of a solver, by its place among those of the run, in every figure.
const char* solver_colour(std::size_t place);
/// "pt 4 lc rgb '...' title 'posit'": its mark, colour and name.
std::string solver_look(const Solver& solver, std::size_t place);

/// "dt 2 lw 1.5 lc rgb '...' title 'posit'": the same of a line.
std::string solver_line(const Solver& solver, std::size_t place);

/// All solvers of a run, with their marks.
std::vector<KeyEntry> key_of_points(const std::vector<const Solver*>& solvers);

/// Pixels of a grey image for a figure: writes <folder>/<name>.png and returns the element of the plot
/// that draws it, in pixels of the whole image with v down ("set yrange [bottom:top]"). gnuplot takes
/// it into the SVG. @param part inside the image @param every one pixel drawn for the mean of so many
/// by so many, in 64 shades: noise is what makes such a picture large.
std::string image_part(const std::filesystem::path& folder, const std::string& name,
                       ImageView image, const Region& part, int every = 1);

/// The file of a figure that has one point per solver and pose: columns "solver", "pose" (index in
/// the plan, as in poses.csv), then the figure's own; the rows of a solver (and part) stand together, so that
/// gnuplot looks at no others for its points. Every such figure is made with it, so that a solver can be hidden and a pose be
/// chosen in all of them.
class PosePoints {
 public:
  explicit PosePoints(std::vector<std::string> columns);
  /// Begins a row: its numbers follow, and `end_row`, before the next one is begun. A row that is drawn has no empty cell among the
  /// columns drawn: gnuplot leaves such a point out, and those behind it could not be told any more.
  /// @param part of the rows, where a solver's points are spread over several panels
  Csv& row(const Solver& solver, std::size_t pose, std::size_t part = 0);
  /// The whole file. @throws RecordError.
  void write(const std::filesystem::path& file) const;
  std::string csv() const;
  /// A plot command of such points only is an error to gnuplot.
  bool none_of(const Solver& solver, std::size_t part = 0) const;
  /// Adds the solver's points to the plot, when all rows are there. @param x, rest gnuplot's columns ("3"
  /// or "(edge($3))", "4:5:6") @param look behind "with points", such as `solver_look`
  /// @param part whose points are drawn
  void draw(Draft& draft, const Solver& solver, std::string_view x, std::string_view rest,
            std::string_view look, std::string_view command = "plot", std::size_t part = 0) const;

 private:
  struct Rows {
    const Solver* solver;
    std::size_t part;
    Csv csv;
    std::vector<std::size_t> poses;
  };
  std::vector<std::string> columns_;
  std::vector<Rows> rows_;  ///< in the order of their first rows
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
