#include "src/report/time_report.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cctype>
#include <cmath>
#include <functional>
#include <limits>
#include <map>
#include <optional>
#include <set>
#include <string_view>
#include <utility>

#include "src/record/csv.h"
#include "src/report/table.h"

namespace turntable {
namespace {

using Times = std::map<std::string, double>;  ///< s by phase

struct Phase {
  const char* key;  ///< as the journal says it
  const char* title;
  const char* colour;
};
constexpr const char* kMotion = "motion_s";
constexpr const char* kOther = "other_s";
/// Of the rig's time, in the order of the table.
constexpr std::array<Phase, 8> kPhases{{{"homing_s", "homing", kColours[3]},
                                        {"mount_s", "changing the payload", kColours[1]},
                                        {kMotion, "motion", kColours[0]},
                                        {"settle_s", "settling", kColours[5]},
                                        {"trigger_s", "triggers", kColours[4]},
                                        {"transfer_s", "exposure and transfer", kColours[2]},
                                        {"held_s", "paused or suspended", "#777777"},
                                        {kOther, "other", "#c8c8c8"}}};
constexpr std::array<std::pair<const char*, const char*>, 4> kByTheWall{
    {{"archive_s", "archiving, beside the motion"},
     {"waited_s", "waited for the archive"},
     {"inspect_s", "looking at images"},
     {"wall_s", "the whole session"}}};

double at(const Times& times, const char* key) {
  const auto found = times.find(key);
  return found == times.end() ? 0.0 : found->second;
}

double total_s(const Times& times) {
  double sum = 0.0;
  for (const Phase& phase : kPhases) sum += at(times, phase.key);
  return sum;
}

/// With what no phase names, where that is known.
Times times_of(const RunSession& session) {
  Times times = session.time;
  if (const auto rig = times.find("rig_s"); rig != times.end())
    times[kOther] = std::max(0.0, rig->second - total_s(times));
  return times;
}

Times sum_of_sessions(const RunRecord& record) {
  Times sum;
  for (const RunSession& session : record.sessions)
    for (const auto& [key, s] : times_of(session)) sum[key] += s;
  return sum;
}

double percent(double part, double whole) { return whole > 0.0 ? 100.0 * part / whole : 0.0; }

std::string time_in_words(double s) {
  if (s < 120.0) return fmt::format("{:.1f} s", s);
  const auto whole = std::lround(s);
  if (whole < 7200) return fmt::format("{} min {:02} s", whole / 60, whole % 60);
  return fmt::format("{} h {:02} min", whole / 3600, whole / 60 % 60);
}

/// What a time axis of that length counts in.
std::pair<double, const char*> unit_for(double longest_s) {
  if (longest_s < 300.0) return {1.0, "s"};
  return longest_s < 3.0 * 3600.0 ? std::pair{60.0, "min"} : std::pair{3600.0, "h"};
}

/// Which complaints are of one kind: the text without its numbers.
std::string kind_of(const std::string& complaint) {
  std::string kind;
  for (const char c : complaint)
    if (std::isdigit(static_cast<unsigned char>(c)) == 0 && c != '.' && c != '-') kind += c;
  return kind;
}

/// "1, 2, 3, 4, 5 and 7 more"
std::string first_of(const std::set<std::size_t>& numbers) {
  constexpr std::size_t kShown = 5;
  std::string text;
  std::size_t shown = 0;
  for (const std::size_t n : numbers) {
    if (++shown > kShown) break;
    text += fmt::format("{}{}", shown == 1 ? "" : ", ", n);
  }
  return numbers.size() > kShown ? fmt::format("{} and {} more", text, numbers.size() - kShown)
                                 : text;
}

void add(Times& times, const PosePhases& phases) {
  times["motion_s"] += phases.motion_s;
  times["settle_s"] += phases.settle_s;
  times["trigger_s"] += phases.trigger_s;
  times["transfer_s"] += phases.transfer_s;
}

/// One bar per scenario, and one for all that belongs to none of the poses that count: a session's
/// total is mostly the plan's doing, and says little about where to save.
void dead_time_figure(const std::filesystem::path& folder, const RunRecord& record,
                      std::vector<Draft>& drafts) {
  struct Bar {
    std::string what;
    std::size_t poses = 0;
    Times times = {};
  };
  std::vector<Bar> bars;
  for (const ScenarioInfo& scenario : record.plan.scenarios) bars.push_back({scenario.name});
  for (const TakenPose& pose : record.poses) {
    ++bars[pose.planned.scenario].poses;
    add(bars[pose.planned.scenario].times, pose.phases);
  }
  if (!record.overlaps.empty()) {
    Bar& again = bars.emplace_back(Bar{"overlap"});
    for (const TakenPose& pose : record.overlaps) {
      ++again.poses;
      add(again.times, pose.phases);
    }
  }
  Bar rest{"between poses", 0, sum_of_sessions(record)};
  for (const Bar& bar : bars)
    for (const Phase& phase : kPhases) rest.times[phase.key] -= at(bar.times, phase.key);
  for (const Phase& phase : kPhases)  // rounded sums of the same numbers
    if (rest.times[phase.key] < 1e-6) rest.times[phase.key] = 0.0;
  bars.push_back(rest);
  std::erase_if(bars, [](const Bar& bar) { return !(total_s(bar.times) > 0.0); });
  if (bars.empty()) return;

  std::vector<std::string> header{"what", "poses"};
  for (const Phase& phase : kPhases) header.emplace_back(phase.key);
  Csv csv(header);
  double longest_s = 0.0;
  Times sum;
  for (const Bar& bar : bars) {
    csv.text(bar.what).integer(static_cast<std::int64_t>(bar.poses));
    for (const Phase& phase : kPhases) {
      csv.number(at(bar.times, phase.key), 3);
      sum[phase.key] += at(bar.times, phase.key);
    }
    csv.end_row();
    longest_s = std::max(longest_s, total_s(bar.times));
  }
  const auto [unit_s, unit] = unit_for(longest_s);
  Draft draft;
  draft.figure.name = "dead_time";
  draft.figure.caption =
      "Time on the rig's clock by phase: the poses of each scenario, with the time per pose at the "
      "end of its bar; \"overlap\", poses taken again after a break; and what belongs to none of "
      "them (homing, payloads, waits, poses that do not count).";
  draft.size = fmt::format("1000,{}", 150 + 42 * bars.size());
  draft.commands = fmt::format(
      "set multiplot\nset key off\nset xlabel 'time / {}'\nset xrange [0:{:.6g}]\n"
      "set yrange [{}.6:-0.6]\nset ytics scale 0\nset grid x noy\nset rmargin at screen 0.78\n",
      unit, 1.28 * longest_s / unit_s, bars.size() - 1);
  std::string tics, labels, before = "0";
  for (std::size_t i = 0; i < bars.size(); ++i) {
    const Bar& bar = bars[i];
    tics += fmt::format("{}'{}' {}", i == 0 ? "" : ", ", bar.what, i);
    const double s = total_s(bar.times);
    const std::string label = bar.poses == 0 ? time_in_words(s)
                                             : fmt::format("{} x {:.1f} s", bar.poses,
                                                           s / static_cast<double>(bar.poses));
    labels += fmt::format("set label '{}' at {:.6g},{} left offset 0.7,0\n", label, s / unit_s, i);
  }
  draft.commands += fmt::format("set ytics ({})\n{}", tics, labels);
  std::vector<KeyEntry> key;
  for (std::size_t k = 0; k < kPhases.size(); ++k) {
    const std::string until = fmt::format("{}+${}", before, k + 3);
    if (sum[kPhases[k].key] > 0.0) {
      const std::string look = fmt::format("boxxyerror fill solid noborder lc rgb '{}' title '{}'",
                                           kPhases[k].colour, kPhases[k].title);
      draft.element(
          fmt::format("'DATA' every ::1 using "
                      "(({})/{:g}):0:(({})/{:g}):(({})/{:g}):($0-0.36):($0+0.36) with {}",
                      until, unit_s, before, unit_s, until, unit_s, look));
      key.push_back({look, {}});
    }
    before = until;
  }
  draft.end_plot().end_multiplot(0.79, key);
  csv.write(folder / (draft.figure.name + ".csv"));
  drafts.push_back(std::move(draft));
}

struct Span {
  double from_s = 0.0, to_s = 0.0;
};

/// On the session's rig clock. @param end_s of one that nothing ended
std::vector<Span> suspensions(const RunSession& session, double end_s) {
  std::vector<Span> spans;
  bool open = false;
  for (const Interruption& i : session.interruptions) {
    if (i.what == "suspend" && i.rig_time_s) {
      spans.push_back({*i.rig_time_s, end_s});
      open = true;
    } else if (open && i.what != "sleep") {
      spans.back().to_s = i.rig_time_s.value_or(end_s);
      open = false;
    }
  }
  return spans;
}

struct ChannelStatistics {
  std::string unit;
  double sum = 0.0;
  double lower = std::numeric_limits<double>::infinity();
  double upper = -std::numeric_limits<double>::infinity();
  std::size_t read = 0, unreadable = 0;
};

std::map<std::string, ChannelStatistics> channel_statistics(const RunRecord& record) {
  std::map<std::string, ChannelStatistics> channels;
  for (const SessionTelemetry& session : record.telemetry)
    for (const TelemetryReading& reading : session.readings)
      for (std::size_t i = 0; i < session.channels.size(); ++i) {
        ChannelStatistics& c = channels[session.channels[i].name];
        c.unit = session.channels[i].unit;
        if (!reading.values[i]) {
          ++c.unreadable;
          continue;
        }
        const double value = *reading.values[i];
        ++c.read;
        c.sum += value;
        c.lower = std::min(c.lower, value);
        c.upper = std::max(c.upper, value);
      }
  return channels;
}

/// In single quotes of gnuplot.
std::string plain(const std::string& text) {
  std::string out;
  for (const char c : text) {
    if (c == '\'') out += c;
    out += static_cast<unsigned char>(c) < ' ' ? ' ' : c;
  }
  return out;
}

/// The channel in one column of the data, session by session, with the limits of its band.
std::string channel_plot(const ChannelStatistics& c, const ChannelConfig::Hold* hold,
                         std::size_t column, double unit_s, const char* look,
                         std::size_t sessions) {
  double lower = c.read > 0 ? c.lower : 0.0, upper = c.read > 0 ? c.upper : 1.0;
  const double span = std::max(upper - lower, 1e-3 * std::max(1.0, std::abs(upper)));
  std::string limits;
  if (hold != nullptr)
    for (const double limit : {hold->lower, hold->upper}) {
      // A limit far away would flatten what there is to see.
      if (limit < c.lower - span || limit > c.upper + span) continue;
      lower = std::min(lower, limit);
      upper = std::max(upper, limit);
      limits += fmt::format("{:.9g} with lines lw 1.2 dt 2 lc rgb '{}', ", limit, kColours[1]);
    }
  const double room = 0.1 * std::max(upper - lower, span);
  const std::string x = fmt::format("$3/{:g}", unit_s);
  // As text: a line goes on across an empty number, and breaks at 1/0.
  const std::string readable = fmt::format("strlen(strcol({})) > 0", column);
  return fmt::format("set yrange [{:.9g}:{:.9g}]\nplot {}", lower - room, upper + room, limits) +
         fmt::format(
             "for [s=1:{}] 'DATA' every ::1 using ($1 == s ? {} : 1/0):"
             "({} ? real(strcol({})) : 1/0) with {} lc rgb '{}', ",
             sessions, x, readable, column, look, kColours[0]) +
         fmt::format(
             "'DATA' every ::1 using ({}):({} ? 1/0 : {:.9g}) "
             "with points pt 2 ps 0.9 lw 1.5 lc rgb '{}'\n",
             x, readable, lower - 0.5 * room, kColours[1]);
}

/// One panel per channel; sessions one after another, for their clocks know nothing of each other.
void telemetry_figure(const std::filesystem::path& folder, const RunRecord& record,
                      const RigFile& rig, std::vector<Draft>& drafts) {
  const auto channels = channel_statistics(record);
  if (channels.empty()) return;
  // Where each session begins, and which of them have readings.
  std::vector<double> begins, ends;
  std::vector<std::size_t> with_readings;
  double end_s = 0.0;
  std::size_t readings = 0;
  for (std::size_t s = 0; s < record.telemetry.size(); ++s) {
    const auto& list = record.telemetry[s].readings;
    begins.push_back(end_s);
    if (!list.empty()) {
      with_readings.push_back(s);
      end_s += std::max(at(times_of(record.sessions[s]), "rig_s"), list.back().rig_time_s);
      readings += list.size();
    }
    ends.push_back(end_s);
  }

  std::vector<std::string> header{"session", "rig_time_s", "elapsed_s", "suspended"};
  for (const auto& [name, channel] : channels)
    header.push_back(fmt::format("{}_{}", name, channel.unit));
  Csv csv(header);
  const auto [unit_s, unit] = unit_for(end_s);
  std::string marks;
  int objects = 0;
  for (const std::size_t s : with_readings) {
    const SessionTelemetry& session = record.telemetry[s];
    const auto spans = suspensions(record.sessions[s], ends[s] - begins[s]);
    for (const Span& span : spans)
      marks += fmt::format(
          "set object {} rectangle from {:.6g},graph 0 to {:.6g},graph 1 behind fillcolor rgb "
          "'#f3dfb4' fillstyle solid noborder\n",
          ++objects, (begins[s] + span.from_s) / unit_s, (begins[s] + span.to_s) / unit_s);
    if (s != with_readings.front())
      marks += fmt::format(
          "set arrow from {0:.6g},graph 0 to {0:.6g},graph 1 nohead lc rgb '#777777' lw 1.5\n"
          "set label 'session {1}' at {0:.6g},graph 0.94 left offset 0.6,0 textcolor rgb "
          "'#777777'\n",
          begins[s] / unit_s, s + 1);
    for (const TelemetryReading& reading : session.readings) {
      const double t = reading.rig_time_s;
      const bool suspended = std::ranges::any_of(
          spans, [t](const Span& span) { return t >= span.from_s && t <= span.to_s; });
      csv.integer(static_cast<std::int64_t>(s + 1)).number(t, 3).number(begins[s] + t, 3);
      csv.integer(suspended ? 1 : 0);
      for (const auto& [name, unused] : channels) {
        const auto it = std::ranges::find(session.channels, name, &TelemetryChannel::name);
        const auto place = static_cast<std::size_t>(it - session.channels.begin());
        if (it != session.channels.end() && reading.values[place])
          csv.number(*reading.values[place], 6);
        else
          csv.empty();
      }
      csv.end_row();
    }
  }

  // Points where they can be told apart.
  const char* look = readings < 200 ? "linespoints lw 1.5 pt 7 ps 0.25" : "lines lw 1.2";
  Draft draft;
  draft.figure.name = "telemetry";
  draft.figure.caption = fmt::format(
      "Telemetry over the rig's time{}. Shaded: no pose was taken while a channel was outside its "
      "band (dashed: its limits). Crosses at the foot: it could not be read.",
      with_readings.size() > 1 ? ", session after session" : "");
  const double height = 80.0 + 210.0 * static_cast<double>(channels.size());
  draft.size = fmt::format("1000,{:.0f}", height);
  draft.commands = fmt::format(
      "set multiplot layout {},1 margins 0.115,0.975,{:.4f},{:.4f} spacing 0,{:.4f}\n"
      "set key off\nset xrange [0:{:.6g}]\nset format x ''\n{}",
      channels.size(), 65.0 / height, 1.0 - 25.0 / height, 20.0 / height, end_s / unit_s, marks);
  std::size_t column = 4;
  for (const auto& [name, channel] : channels) {
    const auto config = std::ranges::find(rig.telemetry.channels, name, &ChannelConfig::name);
    const bool holds = config != rig.telemetry.channels.end() && config->hold;
    if (++column == 4 + channels.size())
      draft.commands += fmt::format("set format x '% h'\nset xlabel 'rig time / {}'\n", unit);
    draft.commands += fmt::format("set ylabel '{} / {}'\n", plain(name), plain(channel.unit)) +
                      channel_plot(channel, holds ? &*config->hold : nullptr, column, unit_s, look,
                                   record.telemetry.size());
  }
  draft.commands += "unset multiplot\n";
  csv.write(folder / (draft.figure.name + ".csv"));
  drafts.push_back(std::move(draft));
}

/// "Of 31 min 29 s on the rig's clock 46.3 % were motion ..."
std::string motion_and_rest(const Times& times) {
  std::vector<std::pair<double, const char*>> rest;
  for (const Phase& phase : kPhases)
    if (std::string_view(phase.key) != kMotion && at(times, phase.key) > 0.0)
      rest.emplace_back(at(times, phase.key), phase.title);
  std::ranges::stable_sort(rest, std::greater{}, &std::pair<double, const char*>::first);
  const double whole = total_s(times), motion = percent(at(times, kMotion), whole);
  std::string text =
      fmt::format("Of {} on the rig's clock {:.1f} % were motion and {:.1f} % were not",
                  time_in_words(whole), motion, 100.0 - motion);
  for (std::size_t i = 0; i < std::min<std::size_t>(rest.size(), 2); ++i)
    text += fmt::format("{}{} {:.1f} %", i == 0 ? ", most of that: " : ", ", rest[i].second,
                        percent(rest[i].first, whole));
  return text + ".";
}

struct Column {
  std::string title;
  Times times;
  bool whole = true;  ///< a phase that is not there took no time; else nobody knows
};

/// Dead-time table: s and share of each phase.
std::string rig_time_table(const std::vector<Column>& columns) {
  std::string md = "| on the rig's clock |", rule = "|---|";
  for (const Column& c : columns) {
    md += fmt::format(" {} | % |", c.title);
    rule += "--:|--:|";
  }
  md += "\n" + rule + "\n";
  for (const Phase& phase : kPhases) {
    md += fmt::format("| {} |", phase.title);
    for (const Column& c : columns) {
      const double s = at(c.times, phase.key);
      md += c.whole || c.times.contains(phase.key)
                ? fmt::format(" {} | {} |", fixed(s, 1), fixed(percent(s, total_s(c.times)), 1))
                : " - | - |";
    }
    md += "\n";
  }
  md += "| in all |";
  for (const Column& c : columns) md += fmt::format(" {} | |", fixed(total_s(c.times), 1));
  return md + "\n";
}

std::string wall_time_table(const std::vector<Column>& columns) {
  std::string md = "| by the wall |", rule = "|---|";
  for (const Column& c : columns) {
    md += fmt::format(" {} |", c.title);
    rule += "--:|";
  }
  md += "\n" + rule + "\n";
  for (const auto& [key, title] : kByTheWall) {
    md += fmt::format("| {} |", title);
    for (const Column& c : columns)
      md += c.times.contains(key) ? fmt::format(" {} |", fixed(at(c.times, key), 1)) : " - |";
    md += "\n";
  }
  return md;
}

}  // namespace

std::string time_text(const RunRecord& record) {
  const Times all = sum_of_sessions(record);
  if (!(total_s(all) > 0.0)) return {};
  std::vector<Column> columns;
  std::set<std::size_t> silent;
  for (std::size_t s = 0; s < record.sessions.size(); ++s) {
    columns.push_back({fmt::format("session {} / s", s + 1), times_of(record.sessions[s]),
                       record.sessions[s].whole_time});
    if (!record.sessions[s].whole_time) silent.insert(s + 1);
  }
  if (columns.size() == 1)
    columns[0].title = "s";
  else
    columns.push_back({"all / s", all});
  std::string md = "## Time\n\n" + motion_and_rest(all) + "\n\n" + rig_time_table(columns);
  if (all.contains("wall_s"))
    md += "\n" + wall_time_table(columns) +
          "\n\"Other\" is what no phase names: talking to the devices between poses and, where the "
          "rig's clock is the wall's, looking at images and waiting for the archive. Times by the "
          "wall are the computer's, and differ from run to run.\n";
  if (!silent.empty())
    md += fmt::format(
        "\nOf session {} only the phases of its poses are known: it was killed before it could "
        "write where its time went. Homing, payloads, waits and everything by the wall are "
        "missing there.\n",
        first_of(silent));
  return md + "\n";
}

std::string images_text(const RunRecord& record) {
  std::size_t images = 0, again = 0, retakes = 0, poses = 0;
  struct Complaint {
    std::size_t images = 0;
    std::set<std::size_t> poses;
    std::string text;  ///< the first one's
  };
  std::map<std::pair<std::size_t, std::string>, Complaint> complaints;  // by scenario and kind
  for (const TakenPose& pose : record.poses) {
    bool complained = false;
    for (const TakenImage& image : pose.images) {
      ++images;
      retakes += static_cast<std::size_t>(image.retakes);
      again += image.retakes > 0 ? 1 : 0;
      if (image.complaint.empty()) continue;
      complained = true;
      Complaint& c = complaints[{pose.planned.scenario, kind_of(image.complaint)}];
      if (c.images++ == 0) c.text = image.complaint;
      c.poses.insert(pose.planned.index);
    }
    poses += complained ? 1 : 0;
  }
  if (images == 0) return {};
  std::string md = "## Images checked\n\n";
  if (retakes == 0 && complaints.empty())
    return md + fmt::format("All {} images were good at once.\n\n", images);
  md += fmt::format("{} of {} images were taken again in place, {} exposures in all. ", again,
                    images, retakes);
  if (complaints.empty()) return md + "Every pose is kept with good images.\n\n";
  md += fmt::format(
      "{} of {} poses are kept with a complaint about an image. Complaints go by the rig file's "
      "nominal camera and exclude nothing from the tables.\n\n"
      "| images | of poses | scenario | complaint (of the first) |\n|--:|---|---|---|\n",
      poses, record.poses.size());
  std::vector<std::pair<std::size_t, const Complaint*>> rows;
  for (const auto& [key, complaint] : complaints) rows.emplace_back(key.first, &complaint);
  std::ranges::stable_sort(
      rows, [](const auto& a, const auto& b) { return a.second->images > b.second->images; });
  constexpr std::size_t kRows = 10;
  for (std::size_t i = 0; i < std::min(rows.size(), kRows); ++i) {
    const Complaint& c = *rows[i].second;
    md += fmt::format("| {} | {} | {} | {} |\n", c.images, first_of(c.poses),
                      markdown_text(record.plan.scenarios[rows[i].first].name),
                      markdown_text(c.text));
  }
  if (rows.size() > kRows)
    md += fmt::format("\n{} more kinds of complaints are in the journal.\n", rows.size() - kRows);
  return md + "\n";
}

std::string telemetry_text(const RunRecord& record) {
  const auto channels = channel_statistics(record);
  if (channels.empty()) return {};
  std::string md =
      "## Telemetry\n\n"
      "| channel | unit | mean | min | max | readings | unreadable |\n"
      "|---|---|--:|--:|--:|--:|--:|\n";
  for (const auto& [name, c] : channels) {
    md += fmt::format("| {} | {} |", name, markdown_text(c.unit));
    if (c.read > 0)
      md += fmt::format(" {:.6g} | {:.6g} | {:.6g} |", c.sum / static_cast<double>(c.read), c.lower,
                        c.upper);
    else
      md += " - | - | - |";
    md += fmt::format(" {} | {} |\n", c.read + c.unreadable, c.unreadable);
  }
  for (const SessionTelemetry& session : record.telemetry)
    for (const TelemetryReading& reading : session.readings)
      if (!reading.trouble.empty())
        return md + fmt::format("\nThe first that could not be read: {}\n\n",
                                markdown_text(reading.trouble));
  return md + "\n";
}

std::string interruptions_text(const RunRecord& record) {
  std::string rows;
  std::size_t count = 0;
  constexpr std::size_t kRows = 40;
  for (std::size_t s = 0; s < record.sessions.size(); ++s)
    for (const Interruption& i : record.sessions[s].interruptions)
      if (++count <= kRows)
        rows += fmt::format("| {} | {} | {} | {} | {} |\n", s + 1, i.utc,
                            i.rig_time_s ? fixed(*i.rig_time_s, 1) : "-", i.what,
                            markdown_text(i.reason));
  if (count == 0) return {};
  std::string md =
      "What made the run wait, and what let it go on. Rig time is that of the last pose or reading "
      "before.\n\n"
      "| session | UTC | rig time / s | what | why |\n|--:|---|--:|---|---|\n" +
      rows;
  if (count > kRows) md += fmt::format("\n{} more are in the journal.\n", count - kRows);
  return md + "\n";
}

std::vector<Draft> time_drafts(const std::filesystem::path& folder, const RunRecord& record,
                               const RigFile& rig) {
  std::vector<Draft> drafts;
  dead_time_figure(folder, record, drafts);
  telemetry_figure(folder, record, rig, drafts);
  return drafts;
}

}  // namespace turntable
