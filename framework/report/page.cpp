#include "report/page.hpp"

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>

#include "report/page_data.hpp"
#include "report/times.hpp"
#include "sdk/files.hpp"
#include "sdk/json_text.hpp"
#include "weft/hdf5_file.hpp"
#include "weft/simulator.hpp"

namespace weft {
namespace {

namespace fs = std::filesystem;
using nlohmann::ordered_json;

constexpr double kCoarseStep = 2e-4;  // for shapes that are only looked at; there are hundreds

ordered_json list(const auto& values) { return std::vector<double>(values.data(), values.data() + values.size()); }

ordered_json knowledge_json(const MaterialKnowledge& knowledge) {
  return {{"centre", list(knowledge.centre)}, {"width", list(knowledge.width)}};
}

ordered_json rows_of(const Controls& matrix) {
  auto rows = ordered_json::array();
  for (Index i = 0; i < matrix.rows(); ++i) rows.push_back(list(Vector(matrix.row(i).transpose())));
  return rows;
}

ordered_json parse_named_json(const std::string& text, const std::string& name) {
  try {
    return parse_json(text);
  } catch (const ordered_json::exception& error) {
    throw ConfigError(name + ": is not JSON: " + error.what());
  }
}

/// Compares the prediction of round r with the executed segments: mean vertex distance, mean predicted distance (root
/// of the summed variances, averaged over vertices), and the share of coordinates within one sigma.
ordered_json compare_prediction(const SessionRecord& session, std::size_t r) {
  const auto& round = session.rounds[r];
  ordered_json error = ordered_json::array(), sigma = ordered_json::array(), inside = ordered_json::array();
  for (std::size_t j = 0; j < round.mean.size(); ++j) {
    if (j < round.sigma.size()) sigma.push_back(1000.0 * round.sigma[j].rowwise().norm().mean());
    if (r + j >= session.rounds.size()) continue;
    const auto& truth = session.shape_after(static_cast<Index>(r + j));
    error.push_back(mean_distance_mm(round.mean[j], truth));
    if (j < round.sigma.size()) {
      const Positions distance = (round.mean[j] - truth).cwiseAbs();
      inside.push_back((distance.array() <= round.sigma[j].array()).cast<double>().mean());
    }
  }
  return {{"error_mm", error}, {"sigma_mm", sigma}, {"coverage_1sigma", inside}};
}

ordered_json garment_json(PageData& page, const std::string& name, const Faces& faces, Index vertices) {
  return {{"name", name}, {"vertices", vertices}, {"faces", page.faces(faces)}};
}

constexpr const char* kExperiments[] = {"planning", "estimation", "prediction", "physics", "ablation"};

/// Adds cases.h5: the resulting shapes of the cases that the page shows.
void add_cases(PageData& page, const fs::path& path) {
  const auto file = Hdf5File::open(path);
  const auto fail = [&](const std::string& what, const std::string& message) {
    throw ConfigError(path.string() + ": " + what + " " + message);
  };
  const auto corners = file.read_int("/garment/faces");
  if (corners.size() % 3 != 0) fail("/garment/faces", "must have the shape [n, 3]");
  const auto rest = file.shape("/garment/rest");
  if (rest.size() != 2 || rest[1] != 2) fail("/garment/rest", "must have the shape [n, 2]");
  const Index vertices = rest[0];
  for (const auto corner : corners) {
    if (corner < 0 || corner >= vertices) fail("/garment/faces", "names a vertex that does not exist");
  }
  Faces faces(static_cast<Index>(corners.size() / 3), 3);
  std::copy(corners.begin(), corners.end(), faces.data());
  page.json["garment"] = garment_json(page, file.read_text("/garment/name"), faces, vertices);
  const auto read_shapes = [&](const std::string& what) {
    const auto dims = file.shape(what);
    if (dims.size() != 3 || dims[1] != vertices || dims[2] != 3)
      fail(what, "must have the shape [n, " + std::to_string(vertices) + ", 3]");
    const auto values = file.read(what);
    for (const double value : values) {
      if (!std::isfinite(value)) fail(what, "holds a number that is not finite");
    }
    std::vector<Positions> rows;
    for (Index i = 0; i < dims[0]; ++i)
      rows.push_back(Eigen::Map<const Positions>(values.data() + i * vertices * 3, vertices, 3));
    return rows;
  };
  for (const std::string name : kExperiments) {
    const std::string group = "/" + name;
    if (!page.json.contains(name) || !file.has(group)) continue;
    if (file.has(group + "/shapes")) {
      const auto shapes = read_shapes(group + "/shapes");
      const auto first = file.read_int(group + "/first");
      if (first.empty() || first.front() != 0 || first.back() != static_cast<std::int64_t>(shapes.size()) ||
          !std::is_sorted(first.begin(), first.end()))
        fail(group + "/first", "must rise from 0 to the number of shapes");
      ordered_json sequences = ordered_json::array();
      for (std::size_t i = 0; i + 1 < first.size(); ++i) {
        const std::vector<Positions> one(shapes.begin() + first[i], shapes.begin() + first[i + 1]);
        sequences.push_back(one.empty() ? ordered_json() : page.shapes(one, kCoarseStep));
      }
      page.json["shapes"][name] = {{"sequences", sequences}};
      continue;
    }
    const auto goals = read_shapes(group + "/goals");
    const auto finals = read_shapes(group + "/finals");
    const auto goal_of = file.read_int(group + "/goal_of");
    if (goal_of.size() != finals.size()) fail(group + "/goal_of", "must have one entry per final shape");
    // One array per shape, since a page decodes only the shapes it shows. The arrays hold differences to the goal,
    // since small numbers compress well.
    ordered_json goal_list = ordered_json::array(), offset_list = ordered_json::array();
    for (const auto& goal : goals) goal_list.push_back(page.shapes({goal}));
    for (std::size_t i = 0; i < finals.size(); ++i) {
      if (goal_of[i] < 0 || goal_of[i] >= static_cast<std::int64_t>(goals.size()))
        fail(group + "/goal_of", "names a goal that does not exist");
      offset_list.push_back(page.shapes({finals[i] - goals[goal_of[i]]}));
    }
    page.json["shapes"][name] = {{"goals", goal_list}, {"offsets", offset_list}, {"goal_of", goal_of}};
  }
}

}  // namespace

ReportTemplate find_report_template() {
  if (const char* given = std::getenv("WEFT_REPORT_TEMPLATE")) {
    if (fs::is_regular_file(given)) return {whole_text(given), ""};
    return {"", std::string("WEFT_REPORT_TEMPLATE names ") + given + ", which is not a file"};
  }
  // <prefix>/share/weft/report, seen from <prefix>/lib or <prefix>/lib/<multiarch>.
  fs::path folder = library_folder();
  for (int level = 0; level < 3 && folder.has_relative_path(); ++level) {
    folder = folder.parent_path();
    const fs::path share = folder / "share" / "weft" / "report";
    if (fs::is_regular_file(share / "report.html")) return {whole_text(share / "report.html"), ""};
    if (fs::is_regular_file(share / "why-not.txt")) {
      std::string reason = whole_text(share / "why-not.txt");
      reason.resize(reason.find_last_not_of(" \n") + 1);
      return {"", reason};
    }
  }
  return {"", "this build of weft holds no page template (node and npm were missing when it was configured)"};
}

std::string session_page(const std::string& page_template, const SessionRecord& session) {
  PageData page;
  auto& json = page.json;
  json["kind"] = "session";
  json["summary"] = parse_named_json(session.summary, "summary of the session");
  for (const char* key : {"plan_seconds", "estimate_seconds"})  // a session.h5 alone has no times
    if (!json["summary"].contains(key)) json["summary"][key] = ordered_json::array();
  json["provenance"] = parse_named_json(session.provenance, "provenance of the session");
  json["config"] = session.config;
  json["properties"] = kPropertyNames;
  json["garment"] = garment_json(page, session.garment_name, session.faces, session.vertex_count());
  json["garment"]["held"] = session.grasp_vertices;
  for (Index hand = 0; hand < std::ssize(session.grasp_vertices); ++hand)
    json["garment"]["held_until"].push_back(session.held_until(hand));
  if (!session.trajectory.empty())
    json["trajectory"] = parse_named_json(session.trajectory, "trajectory of the session");
  auto& data = json["session"];
  data["frames_per_segment"] = kFramesPerSegment;
  data["frame_seconds"] = kFrameSeconds;
  data["released"] = session.released();
  data["release_frame"] = session.segment_frame(session.segments());
  if (session.true_material) data["true_material"] = list(*session.true_material);
  data["start_error_mm"] = session.goal_distance_mm(session.start);
  data["frames"] = page.shapes(session.frames);
  const Mesh goal = session.drawn_goal();
  data["goal"] = page.shapes({goal.positions});
  if (!session.has_correspondence) data["goal_faces"] = page.faces(goal.faces);
  data["default_shape"] = page.shapes({session.default_shape});
  data["rounds"] = ordered_json::array();
  for (std::size_t r = 0; r < session.rounds.size(); ++r) {
    const auto& round = session.rounds[r];
    ordered_json entry;
    entry["controls"] = rows_of(round.controls);
    entry["state"] = list(round.state);
    entry["knowledge"] = knowledge_json(round.knowledge);
    entry["error_mm"] = session.goal_distance_mm(session.shape_after(static_cast<Index>(r)));
    entry["prediction"] = compare_prediction(session, r);
    entry["losses"] = list(round.losses);
    entry["curves"] = page.matrix(round.curves);
    entry["mean"] = page.shapes(round.mean);
    entry["sigma"] = page.shapes(round.sigma);
    entry["targets"] = page.shapes(round.targets);
    data["rounds"].push_back(std::move(entry));
  }
  if (!session.estimates.empty()) {
    data["estimates"] = ordered_json::array();
    data["estimates"].push_back(knowledge_json(MaterialKnowledge::none()));
    for (const auto& estimate : session.estimates) data["estimates"].push_back(knowledge_json(estimate));
  }
  return page.fill(page_template);
}

std::string experiment_page(const std::string& page_template, const fs::path& folder) {
  PageData page;
  auto& json = page.json;
  json["kind"] = fs::exists(folder / "ablation.json") ? "ablation" : "evaluation";
  json["properties"] = kPropertyNames;
  if (fs::exists(folder / "provenance.json")) {
    json["provenance"] = parse_named_json(with_machine_of(whole_text(folder / "provenance.json"), folder),
                                          (folder / "provenance.json").string());
  }
  if (fs::exists(folder / "config.yaml")) json["config"] = whole_text(folder / "config.yaml");
  for (const std::string name : kExperiments) {
    const fs::path file = folder / (name + ".json");
    if (!fs::exists(file)) continue;
    json[name] = parse_named_json(whole_text(file), file.string());
    json[name] = parse_named_json(with_times_of(json[name].dump(), folder, name + ".json"), file.string());
  }
  if (fs::exists(folder / "cases.h5")) add_cases(page, folder / "cases.h5");
  return page.fill(page_template);
}

std::string write_report(const fs::path& folder) {
  const auto found = find_report_template();
  if (found.text.empty()) return found.reason;
  std::string page;
  if (const fs::path file = folder / "session.h5"; fs::exists(file)) {
    SessionRecord session = read_session(file);
    session.summary = with_times_of(session.summary, folder, "summary.json");
    session.provenance = with_machine_of(session.provenance, folder);
    page = session_page(found.text, session);
  } else {
    page = experiment_page(found.text, folder);
  }
  write_text(folder / "report.html", page);
  return "";
}

}  // namespace weft
