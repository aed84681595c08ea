#include "src/evaluation/calibration_set.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <limits>
#include <map>
#include <nlohmann/json.hpp>
#include <numeric>
#include <set>
#include <span>

#include "src/core/errors.h"
#include "src/core/json_document.h"
#include "src/core/parallel.h"
#include "src/record/image_import.h"
#include "src/record/number_table.h"
#include "src/record/sha256.h"
#include "src/vision/circles.h"
#include "src/vision/lattice.h"

namespace turntable {
namespace {

using Name = std::array<int, 2>;  ///< row, column

/// What one image shows.
struct Seen {
  PatternSearch search;
};

Seen see_pattern(const Image& image, const std::string& file, const PatternConfig& pattern,
                 double electrons_per_grey, const char* advice) {
  PatternOptions options;
  options.electrons_per_grey = electrons_per_grey;
  Seen seen{find_pattern(image, pattern, options)};
  if (seen.search.status != PatternStatus::kFound)
    throw ConfigError(
        file, "",
        fmt::format("{} ({} candidates seen, {} cut by the border). Check focus, light and {}.",
                    pattern_status_name(seen.search.status), seen.search.candidates,
                    seen.search.cut_by_border, advice));
  return seen;
}

/// Mean position of every point over several images.
class Mean {
 public:
  void add(Name name, const Vector2d& on_plane_mm, const Vector2d& pixel_px, double sigma_px) {
    Entry& e = entries_[name];
    e.on_plane_mm = on_plane_mm;
    e.pixel_px += pixel_px;
    e.variance += sigma_px * sigma_px;
    e.known = e.known && sigma_px > 0.0;
    ++e.count;
  }
  void add(const PatternSearch& search) {
    ++images_;
    for (const PatternPoint& p : search.points)
      add({p.row, p.column}, p.on_pattern_mm, p.centre_px, p.sigma_px);
  }
  void count_image() { ++images_; }

  /// A point near the border that only some images show would average other noise than its
  /// neighbours: it is left out.
  std::vector<PlanePoint> points(double z_mm) const {
    std::vector<PlanePoint> out;
    for (const auto& [name, e] : entries_) {
      if (e.count != images_) continue;
      out.push_back({e.pixel_px / e.count, e.on_plane_mm, z_mm, name[1], name[0],
                     e.known ? std::sqrt(e.variance) / e.count : 0.0});
    }
    return out;
  }
  int images() const { return images_; }
  int seen_by_some_only() const {
    return static_cast<int>(
        std::ranges::count_if(entries_, [&](const auto& e) { return e.second.count != images_; }));
  }

 private:
  struct Entry {
    Vector2d on_plane_mm = Vector2d::Zero(), pixel_px = Vector2d::Zero();
    double variance = 0.0;
    bool known = true;
    int count = 0;
  };
  std::map<Name, Entry> entries_;
  int images_ = 0;
};

/// Patterns without direction circles may be read in two ways or four: those on planes, which are not
/// turned between images, have to be read alike.
class Readings {
 public:
  /// @throws ConfigError if this image names the points the other way round than the first did.
  void add(const PatternSearch& search, bool on_plane, const std::string& file) {
    half_ += search.half_turn_ambiguous ? 1 : 0;
    quarter_ += search.quarter_turn_ambiguous ? 1 : 0;
    if (!on_plane || !(search.half_turn_ambiguous || search.quarter_turn_ambiguous)) return;
    Vector2d mean_mm = Vector2d::Zero(), mean_px = Vector2d::Zero(), along_x = Vector2d::Zero();
    const auto count = static_cast<double>(search.points.size());
    for (const PatternPoint& p : search.points) {
      mean_mm += p.on_pattern_mm / count;
      mean_px += p.centre_px / count;
    }
    for (const PatternPoint& p : search.points)
      along_x += (p.on_pattern_mm.x() - mean_mm.x()) * (p.centre_px - mean_px);
    along_x.normalize();
    if (!first_) first_ = along_x;
    if (along_x.dot(*first_) < std::sqrt(0.5))
      throw ConfigError(
          file, "",
          "can be read in more than one way, and is read otherwise than the first image "
          "on a plane. Mount the pattern with x near to u (within 40 deg), or use one "
          "with direction circles.");
  }
  void remark(std::vector<std::string>& remarks) const {
    if (half_ + quarter_ == 0) return;
    remarks.push_back(fmt::format(
        "The pattern looks the same after {}: in {} images the reading whose x points most nearly "
        "to "
        "the right was taken.",
        quarter_ > 0 ? "a quarter turn" : "half a turn (180 deg)", std::max(half_, quarter_)));
  }

 private:
  std::optional<Vector2d> first_;
  int half_ = 0, quarter_ = 0;
};

PatternView view_of(const PatternSearch& search, bool at_zero, double z_mm) {
  PatternView view;
  for (const PatternPoint& p : search.points) {
    view.pixels_px.push_back(p.centre_px);
    view.on_pattern_mm.push_back(p.on_pattern_mm);
  }
  view.at_zero = at_zero;
  view.z_mm = z_mm;
  return view;
}

/// Mean shift of the points that both show.
Vector2d shift_px(const std::vector<PlanePoint>& first, const std::vector<PlanePoint>& last) {
  std::map<Name, Vector2d> before;
  for (const PlanePoint& p : first) before[{p.row, p.column}] = p.pixel_px;
  Vector2d sum = Vector2d::Zero();
  int count = 0;
  for (const PlanePoint& p : last)
    if (const auto it = before.find({p.row, p.column}); it != before.end()) {
      sum += p.pixel_px - it->second;
      ++count;
    }
  return count > 0 ? Vector2d(sum / count) : Vector2d(NAN, NAN);
}

/// Of a level pattern; the lens changes it by a few percent over the image.
double mm_per_px(const std::vector<PlanePoint>& points) {
  Vector2d mean_px = Vector2d::Zero(), mean_mm = Vector2d::Zero();
  const auto count = static_cast<double>(points.size());
  for (const PlanePoint& p : points) {
    mean_px += p.pixel_px / count;
    mean_mm += p.on_plane_mm / count;
  }
  double square_px = 0.0, square_mm = 0.0;
  for (const PlanePoint& p : points) {
    square_px += (p.pixel_px - mean_px).squaredNorm();
    square_mm += (p.on_plane_mm - mean_mm).squaredNorm();
  }
  return std::sqrt(square_mm / square_px);  // NaN without points
}

/// Standard deviation of a point over the visits, u and v together, of the points that all show; NaN
/// without two visits or without such points.
double scatter_px(const std::vector<std::vector<PlanePoint>>& visits) {
  struct Sums {
    Vector2d mean_px = Vector2d::Zero();
    double square_px = 0.0;  ///< of the distances from the mean
    std::size_t count = 0;
  };
  std::map<Name, Sums> points;
  for (const auto& visit : visits)
    for (const PlanePoint& p : visit) {  // Welford (1962)
      Sums& s = points[{p.row, p.column}];
      const Vector2d off = p.pixel_px - s.mean_px;
      s.mean_px += off / static_cast<double>(++s.count);
      s.square_px += off.dot(p.pixel_px - s.mean_px);
    }
  double square = 0.0, freedom = 0.0;
  for (const auto& [name, s] : points)
    if (s.count == visits.size()) {
      square += s.square_px;
      freedom += static_cast<double>(s.count - 1);
    }
  return freedom > 0.0 ? std::sqrt(square / freedom) : std::numeric_limits<double>::quiet_NaN();
}

bool shows_a_plane(const PlannedPose& pose) {
  return pose.role == PoseRole::kPlaneFit || pose.role == PoseRole::kPlaneCheck;
}

}  // namespace

std::vector<PlanePoint> CalibrationSet::points(bool fitted) const {
  std::vector<PlanePoint> out;
  for (const SeenPlane& plane : planes)
    if (plane.fit == fitted) out.insert(out.end(), plane.points.begin(), plane.points.end());
  return out;
}

std::string calibration_source(const Plan& plan) {
  return fmt::format("{} (plan {})", plan.name, plan_sha256(plan).substr(0, 12));
}

bool has_calibration_sweep(const Plan& plan) {
  return std::ranges::any_of(
      plan.scenarios, [](const ScenarioInfo& s) { return s.kind == ScenarioKind::kCalibration; });
}

bool calibrates_itself(const RunState& run) {
  return has_calibration_sweep(run.plan) && given_calibration_sha256(run).empty();
}

bool is_of_own_sweep(const Calibration& calibration, const RunRecord& record) {
  if (!has_calibration_sweep(record.plan) || calibration.source != calibration_source(record.plan))
    return false;
  std::multiset<std::string> used, own;
  for (const UsedImage& image : calibration.images) used.insert(image.sha256);
  for (const TakenPose& pose : record.poses)
    if (record.plan.scenario_of(pose.planned).kind == ScenarioKind::kCalibration)
      for (const TakenImage& image : pose.images) own.insert(image.sha256);
  return used == own;
}

// ---- a sweep of this rig

CalibrationSet sweep_set(const RunRecord& record, const RunFolder& folder, const RigFile& rig,
                         const ImageProgress& progress) {
  struct Task {
    std::size_t pose;
    const TakenImage* taken;
    Seen seen;
  };
  CalibrationSet set;
  set.name = folder.root().string();
  set.source = calibration_source(record.plan);
  set.simulated = rig.simulated();
  set.size = rig.camera.image_size;
  set.spacing_mm = rig.pattern.spacing_mm;
  std::vector<const TakenPose*> poses;
  std::vector<Task> tasks;
  for (const TakenPose& pose : record.poses) {
    const ScenarioInfo& scenario = record.plan.scenario_of(pose.planned);
    if (scenario.kind != ScenarioKind::kCalibration || pose.images.empty()) continue;
    if (poses.empty()) set.order = scenario.polynomial_order;
    for (const TakenImage& taken : pose.images) {
      tasks.push_back({poses.size(), &taken, {}});
      set.images.push_back({taken.file, taken.sha256});
    }
    poses.push_back(&pose);
  }
  std::set<double> heights, wanted;
  for (const TakenPose* pose : poses)
    if (pose->planned.role == PoseRole::kPlaneFit) heights.insert(pose->planned.stage_mm);
  for (const PlannedPose& pose : record.plan.poses)
    if (pose.role == PoseRole::kPlaneFit) wanted.insert(pose.stage_mm);
  if (!record.complete() && heights.size() < 2 && wanted.size() > heights.size())
    throw ConfigError(folder.root().string(), "",
                      fmt::format("ended early: {1} of {2} poses were taken, and of the "
                                  "planes that its camera is fitted on {3} of {4}. "
                                  "\"turntable resume {0}\" takes the rest; \"turntable evaluate "
                                  "{0} --calibration FILE\" does without.",
                                  folder.root().string(), record.poses_taken(),
                                  record.plan.poses.size(), heights.size(), wanted.size()));
  if (poses.empty())
    throw ConfigError(set.name, "",
                      "holds no images of a calibration sweep. Run a campaign with a calibration "
                      "scenario, or name a calibration with --calibration.");

  std::atomic<std::size_t> done{0};
  parallel_for(tasks.size(), [&](std::size_t i) {
    const Image image = load_image(folder, *tasks[i].taken);
    const std::string file = (folder.root() / tasks[i].taken->file).string();
    if (image.size() != set.size)
      throw ConfigError(file, "",
                        fmt::format("found {} x {} px, allowed: {} x {} px as the rig file says.",
                                    image.width, image.height, set.size.width, set.size.height));
    tasks[i].seen = see_pattern(image, file, rig.pattern, rig.camera.electrons_per_grey,
                                "the pattern section of the rig file");
    ++done;
    if (progress) progress(done, tasks.size());
  });

  // Visits of one place are one plane.
  struct Place {
    Mean mean;
    std::vector<Mean> visits;
    std::set<std::pair<std::size_t, int>> sweeps;  ///< scenario and repeat
    std::vector<std::size_t> repeats;              ///< visits that are no return
    std::vector<double> stage_mm;
    std::vector<const PatternSearch*> views;
    bool fit = false;
  };
  std::map<double, Place> places;
  std::vector<double> order;  // of the first visits
  std::vector<const PatternSearch*> tilted;
  for (std::size_t k = 0; k < poses.size(); ++k) {
    const bool plane = shows_a_plane(poses[k]->planned);
    Place* place = nullptr;
    if (plane) {
      const auto [it, added] = places.try_emplace(poses[k]->planned.stage_mm);
      if (added) order.push_back(it->first);
      place = &it->second;
      place->fit = poses[k]->planned.role == PoseRole::kPlaneFit;
      place->visits.emplace_back();
      place->stage_mm.push_back(poses[k]->stage.position);
      if (place->sweeps.emplace(poses[k]->planned.scenario, poses[k]->planned.repeat).second)
        place->repeats.push_back(place->visits.size() - 1);
    }
    for (const Task& task : tasks) {
      if (task.pose != k) continue;
      if (plane) {
        place->mean.add(task.seen.search);
        place->visits.back().add(task.seen.search);
        place->views.push_back(&task.seen.search);
      } else {
        set.views.push_back(view_of(task.seen.search, false, 0.0));
      }
    }
  }
  Readings readings;
  for (const Task& task : tasks)
    readings.add(task.seen.search, shows_a_plane(poses[task.pose]->planned),
                 (folder.root() / task.taken->file).string());
  readings.remark(set.remarks);
  for (const double planned : order) {
    const Place& place = places.at(planned);
    PlaneVisits stage;
    stage.z_mm = planned;
    stage.visits = static_cast<int>(place.stage_mm.size());
    stage.stage_mm =
        std::accumulate(place.stage_mm.begin(), place.stage_mm.end(), 0.0) / stage.visits;
    std::vector<std::vector<PlanePoint>> seen;  // at each visit
    for (const Mean& visit : place.visits) seen.push_back(visit.points(0));
    if (stage.visits > 1) {
      const double scale = mm_per_px(seen.front());
      stage.drift_mm = place.stage_mm.back() - place.stage_mm.front();
      stage.drift_px = shift_px(seen.front(), seen.back());
      stage.drift_plane_mm = scale * stage.drift_px.norm();
      std::vector<std::vector<PlanePoint>> repeats;
      for (const std::size_t visit : place.repeats) repeats.push_back(std::move(seen[visit]));
      stage.repeat_rms_px = scatter_px(repeats);
      stage.repeat_rms_mm = scale * stage.repeat_rms_px;
    }
    set.stage.push_back(stage);
    set.planes.push_back({stage.stage_mm, place.fit, place.mean.points(stage.stage_mm)});
    for (const PatternSearch* view : place.views)
      set.views.push_back(view_of(*view, true, stage.stage_mm));
    if (const int some = place.mean.seen_by_some_only(); some > 0)
      set.remarks.push_back(
          fmt::format("{} points of the plane at {:g} mm were not seen in all of its {} images and "
                      "are left out.",
                      some, planned, place.mean.images()));
  }
  const auto shown = std::ranges::find_if(
      tasks, [&](const Task& t) { return shows_a_plane(poses[t.pose]->planned); });
  if (shown != tasks.end())
    set.example = PatternExample{shown->taken->file, load_image(folder, *shown->taken),
                                 shown->seen.search.points};
  return set;
}

// ---- images and points that a lab has already

namespace {

class SetReader {
 public:
  SetReader(const std::filesystem::path& file, const ImageProgress& progress)
      : file_(file.string()),
        folder_(file.parent_path()),
        json_(load_json(file, "calibration-set")),
        progress_(progress) {}

  CalibrationSet read() {
    set_.name = file_;
    set_.source = fmt::format("{} ({} {})", json_.at("name").get<std::string>(),
                              std::filesystem::path(file_).filename().string(),
                              sha256_hex(json_.dump()).substr(0, 12));
    const Json& order =
        json_.contains("polynomial_order") ? json_.at("polynomial_order") : Json("auto");
    set_.order = order.is_string() ? kOrderByResiduals : order.get<int>();
    set_.simulated = json_.value("simulated", false);
    if (json_.contains("image_size_px"))
      set_.size = {json_.at("image_size_px").at(0), json_.at("image_size_px").at(1)};
    read_planes();
    for (const auto& view : json_.value("views", Json::array())) add_task(view, -1);
    if (json_.contains("pattern") == json_.contains("points"))
      fail("",
           "give either \"pattern\" (it is found in the images) or \"points\" (a file of them).");
    if (set_.planes.empty() && json_.value("views", Json::array()).empty())
      fail("", "holds neither planes nor views. List the images.");
    if (json_.contains("points")) refuse_unused_images();
    if (json_.contains("pattern"))
      read_patterns();
    else
      read_points();
    if (set_.size.width == 0)
      fail("", "key \"image_size_px\" is missing; without images it has to be stated.");
    return std::move(set_);
  }

 private:
  struct Task {
    std::string file;
    int plane = -1;  ///< -1: a view
    Seen seen{};
    std::vector<Circle> circles{};
  };

  [[noreturn]] void fail(const std::string& pointer, const std::string& message) const {
    throw ConfigError(file_, pointer.empty() ? "/" : pointer, message);
  }

  void add_task(const Json& name, int plane) {
    tasks_.push_back({(folder_ / name.get<std::string>()).string(), plane});
  }

  /// What would be passed over without a word.
  void refuse_unused_images() const {
    if (json_.contains("views"))
      fail("/views", "goes with \"pattern\": points are stated on planes only. Remove it.");
    if (json_.at("points").contains("refine")) return;
    for (const Task& task : tasks_)
      fail(fmt::format("/planes/{}/images", task.plane),
           "goes with \"refine\" or \"pattern\"; points are taken as they are. Remove it, or add "
           "\"refine\" to points.");
  }

  void read_planes() {
    if (!json_.contains("planes")) return;
    int fits = 0;
    for (const Json& plane : json_.at("planes")) {
      const double z = plane.at("z_mm");
      const std::size_t at = set_.planes.size();
      for (const SeenPlane& other : set_.planes)
        if (other.z_mm == z)
          fail(fmt::format("/planes/{}/z_mm", at),
               fmt::format("found {} mm twice. Put all images of a plane into one entry.", z));
      set_.planes.push_back({z, plane.at("use") == "fit", {}});
      fits += set_.planes.back().fit ? 1 : 0;
      for (const Json& image : plane.value("images", Json::array()))
        add_task(image, static_cast<int>(at));
    }
    if (fits < 2)
      fail("/planes", fmt::format("found {} plane(s) with \"use\": \"fit\", allowed: at least 2. A "
                                  "ray needs two points.",
                                  fits));
  }

  /// Reads every image once, on all cores; `look` fills what was seen.
  template <class Look>
  void look_at_images(Look&& look) {
    std::atomic<std::size_t> done{0};
    set_.images.resize(tasks_.size());
    const bool stated = set_.size.width > 0;
    if (!stated && !tasks_.empty()) set_.size = import_image(tasks_.front().file).size();
    parallel_for(tasks_.size(), [&](std::size_t i) {
      Task& task = tasks_[i];
      const Image image = import_image(task.file);
      if (image.size() != set_.size)
        throw ConfigError(
            task.file, "",
            fmt::format(
                "found {} x {} px, allowed: {} x {} px as {}. Images of one camera have one "
                "size.",
                image.width, image.height, set_.size.width, set_.size.height,
                stated ? "image_size_px says" : tasks_.front().file + " has"));
      set_.images[i] = {std::filesystem::path(task.file).lexically_relative(folder_).string(),
                        sha256_hex(read_text(task.file))};
      if (set_.images[i].file.empty()) set_.images[i].file = task.file;
      look(task, image);
      ++done;
      if (progress_) progress_(done, tasks_.size());
    });
    refuse_same_images();
  }

  /// One image counted twice would seem to confirm itself, and on two planes it contradicts itself.
  void refuse_same_images() const {
    std::map<std::string, std::string> files;
    for (std::size_t i = 0; i < tasks_.size(); ++i)
      if (const auto [it, added] = files.try_emplace(set_.images[i].sha256, tasks_[i].file); !added)
        throw ConfigError(tasks_[i].file, "",
                          fmt::format("is the same image as {}, allowed: each image once. Take one "
                                      "of them out of the set.",
                                      it->second));
  }

  void read_patterns() {
    const PatternConfig pattern = parse_pattern(json_, file_);
    set_.spacing_mm = pattern.spacing_mm;
    for (std::size_t i = 0; i < set_.planes.size(); ++i)
      if (std::ranges::none_of(tasks_,
                               [&](const Task& t) { return t.plane == static_cast<int>(i); }))
        fail(fmt::format("/planes/{}", i), "has no images to find the pattern in.");
    look_at_images([&](Task& task, const Image& image) {
      task.seen = see_pattern(image, task.file, pattern, json_.value("electrons_per_grey", 0.0),
                              "the pattern section of the calibration set");
    });
    std::vector<Mean> means(set_.planes.size());
    Readings readings;
    for (const Task& task : tasks_) {
      readings.add(task.seen.search, task.plane >= 0, task.file);
      if (task.plane < 0) {
        set_.views.push_back(view_of(task.seen.search, false, 0.0));
      } else {
        const auto plane = static_cast<std::size_t>(task.plane);
        means[plane].add(task.seen.search);
        set_.views.push_back(view_of(task.seen.search, true, set_.planes[plane].z_mm));
      }
    }
    for (std::size_t i = 0; i < means.size(); ++i) {
      set_.planes[i].points = means[i].points(set_.planes[i].z_mm);
      if (const int some = means[i].seen_by_some_only(); some > 0)
        set_.remarks.push_back(fmt::format(
            "{} points of the plane at {:g} mm were not seen in all of its {} images and are left "
            "out.",
            some, set_.planes[i].z_mm, means[i].images()));
    }
    readings.remark(set_.remarks);
    const Task& first = tasks_.front();
    set_.example = PatternExample{set_.images.front().file, import_image(first.file),
                                  first.seen.search.points};
  }

  void read_points() {
    if (set_.planes.empty()) fail("", "\"points\" need \"planes\": which heights are fitted?");
    const Json& section = json_.at("points");
    const std::string name = (folder_ / section.at("file").get<std::string>()).string();
    const NumberTable table =
        read_number_table(name, {"x_mm", "y_mm", "z_mm", "u_px", "v_px"}, {"sigma_px"});
    const bool refine = section.contains("refine");
    if (refine)
      look_at_images([&](Task& task, const Image& image) {
        task.circles = find_circles(image, section.at("refine").at("circles") == "bright").circles;
      });
    const bool up = section.value("v_counts", "down") == "up";
    if (up && set_.size.height == 0)
      fail("", "key \"image_size_px\" is missing; v cannot be counted upward without it.");
    for (std::size_t i = 0; i < set_.planes.size(); ++i)
      read_plane_points(i, table, name, up, refine ? &section.at("refine") : nullptr);
    for (std::size_t row = 0; row < table.rows(); ++row)
      if (std::ranges::none_of(set_.planes, [&](const SeenPlane& p) {
            return std::abs(p.z_mm - table.at("z_mm")[row]) < 1e-6;
          }))
        throw ConfigError(
            name, fmt::format("line {}", table.lines[row]),
            fmt::format("found z = {} mm, which no entry of planes has. Add the plane, "
                        "or take the point out.",
                        table.at("z_mm")[row]));
  }

  void check_guide(const Vector2d& pixel_px, double sigma_px, int line,
                   const std::string& name) const {
    const ImageSize size = set_.size;
    if (size.width > 0 && !(pixel_px.x() >= -0.5 && pixel_px.x() <= size.width - 0.5 &&
                            pixel_px.y() >= -0.5 && pixel_px.y() <= size.height - 0.5))
      throw ConfigError(
          name, fmt::format("line {}", line),
          fmt::format("found the pixel ({:g}, {:g}), v counted downward, allowed: "
                      "inside the image of {} x {} px. Check u_px, v_px, v_counts and "
                      "image_size_px.",
                      pixel_px.x(), pixel_px.y(), size.width, size.height));
    if (sigma_px < 0.0)
      throw ConfigError(name, fmt::format("line {}, column sigma_px", line),
                        fmt::format("found {}, allowed: above 0, or 0 for unknown.", sigma_px));
  }

  void read_plane_points(std::size_t index, const NumberTable& table, const std::string& name,
                         bool up, const Json* refine) {
    SeenPlane& plane = set_.planes[index];
    struct Guide {
      int line;
      Vector2d on_plane_mm, pixel_px;
      double sigma_px;
    };
    std::vector<Guide> guides;
    for (std::size_t row = 0; row < table.rows(); ++row) {
      if (std::abs(plane.z_mm - table.at("z_mm")[row]) >= 1e-6) continue;
      const double v = table.at("v_px")[row];
      guides.push_back({table.lines[row],
                        {table.at("x_mm")[row], table.at("y_mm")[row]},
                        {table.at("u_px")[row], up ? set_.size.height - 1 - v : v},
                        table.has("sigma_px") ? table.at("sigma_px")[row] : 0.0});
      check_guide(guides.back().pixel_px, guides.back().sigma_px, guides.back().line, name);
      for (const Guide& other : std::span(guides).first(guides.size() - 1))
        if (other.on_plane_mm == guides.back().on_plane_mm)
          throw ConfigError(
              name, fmt::format("line {}", guides.back().line),
              fmt::format("found the point ({:g}, {:g}, {:g}) mm a second time, first "
                          "in line {}. State each point once.",
                          other.on_plane_mm.x(), other.on_plane_mm.y(), plane.z_mm, other.line));
    }
    if (guides.empty())
      fail(fmt::format("/planes/{}", index), fmt::format("has no points in {}.", name));
    Mean mean;
    if (refine == nullptr) {
      mean.count_image();
      for (const Guide& g : guides) mean.add({0, g.line}, g.on_plane_mm, g.pixel_px, g.sigma_px);
      plane.points = mean.points(plane.z_mm);
      return;
    }
    const double reach = refine->value("reach_px", 5.0), radius = refine->value("radius_mm", 0.0);
    for (const Guide& g : guides)
      for (const Guide& other : guides)
        if (const double apart = (g.on_plane_mm - other.on_plane_mm).norm();
            &g != &other && apart < 2.0 * radius)
          fail("/points/refine/radius_mm",
               fmt::format(
                   "found {:g} mm, allowed: circles that do not touch; those of lines {} and "
                   "{} are {:g} mm apart.",
                   radius, g.line, other.line, apart));
    int images = 0, lost = 0;
    for (const Task& task : tasks_) {
      if (task.plane != static_cast<int>(index)) continue;
      ++images;
      mean.count_image();
      std::vector<int> found(guides.size(), -1);
      std::vector<int> taken(task.circles.size(), 0);
      for (std::size_t k = 0; k < guides.size(); ++k) {
        double nearest = reach;
        for (std::size_t c = 0; c < task.circles.size(); ++c)
          if (const double d = (task.circles[c].centre_px - guides[k].pixel_px).norm();
              d <= nearest) {
            nearest = d;
            found[k] = static_cast<int>(c);
          }
        if (found[k] >= 0) ++taken[static_cast<std::size_t>(found[k])];
      }
      std::vector<Vector2d> on_plane, px;
      std::vector<std::pair<std::size_t, const Circle*>> matched;
      for (std::size_t k = 0; k < guides.size(); ++k) {
        // A circle that two guides claim is nobody's.
        if (found[k] < 0 || taken[static_cast<std::size_t>(found[k])] > 1) {
          ++lost;
          continue;
        }
        matched.emplace_back(k, &task.circles[static_cast<std::size_t>(found[k])]);
        on_plane.push_back(guides[k].on_plane_mm);
        px.push_back(matched.back().second->centre_px);
      }
      PatternMap map;
      const bool correct = radius > 0.0 && map.fit(on_plane, px);
      PatternExample example;
      for (std::size_t m = 0; m < matched.size(); ++m) {
        const auto& [k, circle] = matched[m];
        Vector2d centre = circle->centre_px;
        if (correct) centre -= centroid_bias_px(map.at(on_plane[m]), radius);
        mean.add({0, guides[k].line}, guides[k].on_plane_mm, centre, circle->sigma_px);
        example.points.push_back(
            {guides[k].line, 0, guides[k].on_plane_mm, centre, circle->sigma_px, circle->box});
      }
      if (!set_.example) {
        example.file = set_.images[static_cast<std::size_t>(&task - tasks_.data())].file;
        example.image = import_image(task.file);
        set_.example = std::move(example);
      }
    }
    if (images == 0)
      fail(fmt::format("/planes/{}", index), "has no images to refine its points in.");
    plane.points = mean.points(plane.z_mm);
    if (plane.points.empty())
      fail("/points/refine", fmt::format("no circle lies within {} px of any point of the plane at "
                                         "{:g} mm. Check v_counts, circles and reach_px.",
                                         reach, plane.z_mm));
    if (lost > 0)
      set_.remarks.push_back(fmt::format(
          "{} of {} guides on the plane at {:g} mm have no circle of their own within {} "
          "px and are left out.",
          lost, guides.size() * static_cast<std::size_t>(images), plane.z_mm, reach));
  }

  std::string file_;
  std::filesystem::path folder_;
  Json json_;
  const ImageProgress& progress_;
  CalibrationSet set_;
  std::vector<Task> tasks_;
};

}  // namespace

CalibrationSet load_calibration_set(const std::filesystem::path& file,
                                    const ImageProgress& progress) {
  return SetReader(file, progress).read();
}

}  // namespace turntable
