#include "src/report/drawing.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <thread>

#include "src/core/errors.h"
#include "src/core/json_document.h"
#include "src/core/parallel.h"
#include "src/record/atomic_file.h"
#include "src/record/folder.h"
#include "src/report/table.h"

extern char** environ;

namespace turntable {
namespace {

/// Runs one gnuplot on scripts in a folder, one after the other: most of what a picture costs is
/// starting the program. False if there is no gnuplot or a script fails, which ends it.
bool run_gnuplot(const std::filesystem::path& at, const std::vector<std::string>& scripts) {
  const std::string folder = at.string();
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_addchdir_np(&actions, folder.c_str());
  posix_spawn_file_actions_addopen(&actions, STDIN_FILENO, "/dev/null", O_RDONLY, 0);
  posix_spawn_file_actions_addopen(&actions, STDERR_FILENO, "/dev/null", O_WRONLY, 0);
  std::vector<std::string> arguments{"gnuplot"};
  for (const std::string& script : scripts) {
    if (arguments.size() > 1) arguments.insert(arguments.end(), {"-e", "reset session"});
    arguments.push_back(script);
  }
  std::vector<char*> argv;
  for (std::string& argument : arguments) argv.push_back(argument.data());
  argv.push_back(nullptr);
  pid_t child = 0;
  const int failed = posix_spawnp(&child, "gnuplot", &actions, nullptr, argv.data(), environ);
  posix_spawn_file_actions_destroy(&actions);
  if (failed != 0) return false;
  int status = 0;
  while (waitpid(child, &status, 0) < 0 && errno == EINTR) {
  }
  return WIFEXITED(status) && WEXITSTATUS(status) == 0;
}

std::string script_of(const Draft& draft) {
  std::string commands = draft.commands;
  const std::string data = "'" + draft.figure.name + ".csv'";
  for (std::size_t at = 0; (at = commands.find("'DATA'", at)) != std::string::npos;)
    commands.replace(at, 6, data);
  return fmt::format(
      "set terminal svg standalone size {} dynamic noenhanced background rgb 'white' font "
      "'sans,13'\n"
      "set output '{}.svg'\n"
      "set datafile separator ','\nset key outside right top\nset grid lc rgb '#dddddd'\n{}",
      draft.size, draft.figure.name, commands);
}

}  // namespace

Draft& Draft::element(std::string_view text, Element shows, std::string_view command) {
  const bool begins = commands.empty() || commands.back() == '\n';
  commands += fmt::format("{} {}", begins ? command : ",", text);
  figure.elements.push_back(std::move(shows));
  return *this;
}

Draft& Draft::end_plot() {
  commands += "\n";
  return *this;
}

Draft& Draft::end_multiplot(double left, const std::vector<KeyEntry>& key) {
  commands += fmt::format(
      "reset\nset origin 0,0\nset size 1,1\nset margins 0,0,0,0\nunset border\nunset tics\n"
      "set xrange [0:1]\nset yrange [0:1]\n"
      "set key at screen {:.5f},0.97 left top Left reverse samplen 2\n",
      left);
  for (const KeyEntry& entry : key) element("1/0 with " + entry.look, {entry.solver, {}});
  end_plot();
  commands += "unset multiplot\n";
  return *this;
}

const char* solver_colour(std::size_t place) { return kColours[place % kColours.size()]; }

std::string solver_look(const Solver& solver, std::size_t place) {
  return fmt::format("pt {} lc rgb '{}' title '{}'", place + 4, solver_colour(place), solver.name);
}

std::string solver_line(const Solver& solver, std::size_t place) {
  return fmt::format("dt {} lw 1.5 lc rgb '{}' title '{}'", place % 5 + 1, solver_colour(place),
                     solver.name);
}

std::vector<KeyEntry> key_of_points(const std::vector<const Solver*>& solvers) {
  std::vector<KeyEntry> key;
  for (std::size_t k = 0; k < solvers.size(); ++k)
    key.push_back({"points " + solver_look(*solvers[k], k), std::string(solvers[k]->name)});
  return key;
}

std::string image_part(const std::filesystem::path& folder, const std::string& name,
                       ImageView image, const Region& part, int every) {
  const ImageSize size{(part.right - part.left + 1) / every, (part.bottom - part.top + 1) / every};
  Image out(size, 0);
  for (int v = 0; v < size.height; ++v)
    for (int u = 0; u < size.width; ++u) {
      int sum = 0;
      for (int j = 0; j < every; ++j)
        for (int i = 0; i < every; ++i)
          sum += image.row(part.top + v * every + j)[part.left + u * every + i];
      out.row(v)[u] = static_cast<std::uint8_t>(sum / (every * every) / 4 * 4);
    }
  write_atomically(folder / (name + ".png"), encode_png(out));
  const double middle = 0.5 * (every - 1);
  return fmt::format(
      "'{}.png' binary filetype=png flipy origin=({},{}) dx={} dy={} using 1:1:1 with rgbimage "
      "notitle",
      name, part.left + middle, part.top + middle, every, every);
}

PosePoints::PosePoints(std::vector<std::string> columns) : columns_(std::move(columns)) {
  columns_.insert(columns_.begin(), {"solver", "pose"});
}

Csv& PosePoints::row(const Solver& solver, std::size_t pose, std::size_t part) {
  auto rows = std::ranges::find_if(
      rows_, [&](const Rows& r) { return r.solver == &solver && r.part == part; });
  if (rows == rows_.end()) rows = rows_.insert(rows_.end(), Rows{&solver, part, Csv(columns_), {}});
  rows->poses.push_back(pose);
  return rows->csv.text(solver.name).integer(static_cast<std::int64_t>(pose));
}

std::string PosePoints::csv() const {
  std::string text = Csv(columns_).str();
  const std::size_t header = text.size();
  for (const Rows& rows : rows_) text += std::string_view(rows.csv.str()).substr(header);
  return text;
}

void PosePoints::write(const std::filesystem::path& file) const { write_atomically(file, csv()); }

bool PosePoints::none_of(const Solver& solver, std::size_t part) const {
  return std::ranges::none_of(rows_,
                              [&](const Rows& r) { return r.solver == &solver && r.part == part; });
}

void PosePoints::draw(Draft& draft, const Solver& solver, std::string_view x, std::string_view rest,
                      std::string_view look, std::string_view command, std::size_t part) const {
  std::size_t first = 1;  // behind the header
  for (const Rows& rows : rows_) {
    if (rows.solver == &solver && rows.part == part) {
      draft.element(fmt::format("'DATA' every ::{}::{} using {}:{} with points {}", first,
                                first + rows.poses.size() - 1, x, rest, look),
                    {std::string(solver.name), rows.poses}, command);
      return;
    }
    first += rows.poses.size();
  }
  draft.element(fmt::format("'DATA' every ::1::1 using (1/0):{} with points {}", rest, look),
                {std::string(solver.name), {}}, command);
}

std::vector<Figure> draw(const std::filesystem::path& folder, const std::vector<Draft>& drafts) {
  for (const Draft& d : drafts) write_atomically(folder / (d.figure.name + ".gp"), script_of(d));
  std::vector<Figure> figures;
  for (const Draft& d : drafts) figures.push_back(d.figure);
  const std::size_t heaps =
      std::min<std::size_t>(drafts.size(), std::max(1u, std::thread::hardware_concurrency()));
  parallel_for(heaps, [&](std::size_t heap) {
    std::vector<std::string> scripts;
    for (std::size_t i = heap; i < figures.size(); i += heaps)
      scripts.push_back(figures[i].name + ".gp");
    const bool all = run_gnuplot(folder, scripts);
    for (std::size_t i = heap; i < figures.size(); i += heaps)
      figures[i].drawn = all || run_gnuplot(folder, {figures[i].name + ".gp"});
  });
  return figures;
}

std::string draw_svg(const Draft& draft, std::string_view csv) {
  const Scratch scratch("turntable-figure");
  const std::filesystem::path& folder = scratch.path();
  write_atomically(folder / (draft.figure.name + ".csv"), csv);
  if (!draw(folder, {draft}).front().drawn)
    throw ConfigError("gnuplot", "",
                      "could not draw the picture. Install it (Debian: gnuplot-nox) or make it "
                      "found in PATH, or do without a picture.");
  return read_text(folder / (draft.figure.name + ".svg"));
}

std::string figures_markdown(const std::vector<Figure>& figures) {
  std::string md = "The data of each lie beside it as CSV, with units in the headers.\n\n";
  bool undrawn = false;
  for (const Figure& f : figures) {
    undrawn = undrawn || !f.drawn;
    const std::string caption = markdown_text(f.caption);
    md += f.drawn ? fmt::format("![{}](figures/{}.svg)\n\n{} ([data](figures/{}.csv))\n\n", caption,
                                f.name, caption, f.name)
                  : fmt::format("{} ([data](figures/{}.csv), [script](figures/{}.gp))\n\n", caption,
                                f.name, f.name);
  }
  if (undrawn)
    md +=
        "Pictures are missing where gnuplot could not draw them; install gnuplot-nox and make the "
        "report again.\n\n";
  return md;
}

}  // namespace turntable
