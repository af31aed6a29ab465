#include <cmath>
#include <cstdio>
#include <nlohmann/json.hpp>

#include "exports.hpp"
#include "sdk/files.hpp"
#include "sdk/json_text.hpp"
#include "weft/garment.hpp"

namespace weft::app {
namespace {

namespace fs = std::filesystem;

/// A text that is made line by line; the file appears whole or not at all.
class TextFile {
 public:
  explicit TextFile(fs::path file) : file_(std::move(file)) {}
  template <class... Values>
  void print(const char* format, auto value, Values... values) {
    char text[256];
    const int size = std::snprintf(text, sizeof(text), format, value, values...);
    text_.append(text, std::min<int>(size, sizeof(text) - 1));
  }
  void text(const std::string& text) { text_ += text; }
  void commit() const { write_text(file_, text_); }

 private:
  fs::path file_;
  std::string text_;
};

void print_points(TextFile& out, const Positions& positions) {
  out.text("[");
  for (Index v = 0; v < positions.rows(); ++v) {
    out.print("%s(%.7g, %.7g, %.7g)", v > 0 ? ", " : "", positions(v, 0), positions(v, 1), positions(v, 2));
  }
  out.text("]");
}

/// A name as USD allows it.
std::string identifier(const std::string& name) {
  std::string result = name.empty() || std::isdigit(static_cast<unsigned char>(name[0])) ? "_" + name : name;
  for (char& c : result) {
    if (!std::isalnum(static_cast<unsigned char>(c)) || static_cast<unsigned char>(c) > 127) c = '_';
  }
  return result;
}

}  // namespace

Timeline every_nth(const SessionRecord& session, std::size_t n) {
  const std::size_t last = session.frames.size() - 1;
  const std::size_t release = session.segment_frame(session.segments());
  Timeline timeline;
  for (std::size_t frame = 0; frame <= last; ++frame) {
    if (frame % n != 0 && frame != release && frame != last) continue;
    timeline.frames.push_back(frame);
    timeline.seconds.push_back(static_cast<double>(frame) * kFrameSeconds);
  }
  return timeline;
}

void export_usd(const fs::path& file, const SessionRecord& session, const Timeline& timeline) {
  TextFile out(file);
  const double end = timeline.seconds.back() / kFrameSeconds;
  out.text("#usda 1.0\n(\n    defaultPrim = \"weft\"\n    metersPerUnit = 1\n    upAxis = \"Z\"\n");
  out.print("    timeCodesPerSecond = 60\n    framesPerSecond = 60\n    startTimeCode = 0\n    endTimeCode = %g\n)\n\n",
            end);
  out.text("def Xform \"weft\"\n{\n");
  const auto print_mesh = [&](const std::string& name, const Faces& faces, bool has_rest, const Eigen::Vector3d& colour,
                              double opacity) {
    out.print("    def Mesh \"%s\"\n    {\n", identifier(name).substr(0, 100).c_str());
    out.text("        uniform token subdivisionScheme = \"none\"\n        uniform bool doubleSided = 1\n");
    out.print("        color3f[] primvars:displayColor = [(%g, %g, %g)]\n", colour.x(), colour.y(), colour.z());
    out.print("        float[] primvars:displayOpacity = [%g]\n", opacity);
    out.text("        int[] faceVertexCounts = [");
    for (Index f = 0; f < faces.rows(); ++f) out.text(f > 0 ? ", 3" : "3");
    out.text("]\n        int[] faceVertexIndices = [");
    for (Index f = 0; f < faces.rows(); ++f)
      out.print("%s%d, %d, %d", f > 0 ? ", " : "", faces(f, 0), faces(f, 1), faces(f, 2));
    out.text("]\n");
    if (!has_rest) return;
    out.text("        texCoord2f[] primvars:st = [");
    for (Index v = 0; v < session.rest.rows(); ++v)
      out.print("%s(%.7g, %.7g)", v > 0 ? ", " : "", session.rest(v, 0), session.rest(v, 1));
    out.text("] (interpolation = \"vertex\")\n");
  };
  print_mesh(session.garment_name, session.faces, true, {0.07, 0.26, 0.56}, 1.0);
  out.text("        point3f[] points.timeSamples = {\n");
  for (std::size_t k = 0; k < timeline.frames.size(); ++k) {
    out.print("            %g: ", timeline.seconds[k] / kFrameSeconds);
    print_points(out, session.frames[timeline.frames[k]]);
    out.text(",\n");
  }
  // The default value, for programs that show no animation; three.js would forget it if it came first.
  out.text("        }\n        point3f[] points = ");
  print_points(out, session.frames[timeline.frames.front()]);
  out.text("\n    }\n\n");
  const Mesh goal = session.drawn_goal();
  print_mesh(identifier(session.garment_name) == "goal" ? "goal_shape" : "goal", goal.faces, session.has_correspondence,
             {0.0, 0.25, 0.12}, 0.4);
  out.text("        point3f[] points = ");
  print_points(out, goal.positions);
  out.text("\n    }\n");
  for (std::size_t k = 0; k < session.obstacles.size(); ++k) {
    const Mesh obstacle = session.drawn_obstacle(k);
    out.text("\n");
    print_mesh(obstacle.source, obstacle.faces, false, {0.45, 0.42, 0.38}, 1.0);
    out.text("        point3f[] points = ");
    print_points(out, obstacle.positions);
    out.text("\n    }\n");
  }
  out.text("}\n");
  out.commit();
}

void export_obj(const fs::path& folder, const SessionRecord& session, const Timeline& timeline) {
  make_writable_folder(folder);
  for (const std::size_t frame : timeline.frames) {
    char name[32];
    std::snprintf(name, sizeof(name), "%04zu.obj", frame);
    write_obj(folder / name, {session.frames[frame], session.faces, session.rest, ""});
  }
  Mesh goal = session.drawn_goal();
  if (session.has_correspondence) goal.rest = session.rest;
  write_obj(folder / "goal.obj", goal);
  for (std::size_t k = 0; k < session.obstacles.size(); ++k) {
    const Mesh obstacle = session.drawn_obstacle(k);
    write_obj(folder / (obstacle.source + ".obj"), obstacle);
  }
}

void export_csv(const fs::path& folder, const SessionRecord& session, const Timeline& timeline) {
  make_writable_folder(folder);
  TextFile vertices(folder / "vertices.csv");
  vertices.text("frame,time_s,vertex,x_m,y_m,z_m\n");
  for (std::size_t k = 0; k < timeline.frames.size(); ++k) {
    const auto& shape = session.frames[timeline.frames[k]];
    for (Index v = 0; v < shape.rows(); ++v) {
      vertices.print("%zu,%.6g,%td,%.7g,%.7g,%.7g\n", timeline.frames[k], timeline.seconds[k], v, shape(v, 0),
                     shape(v, 1), shape(v, 2));
    }
  }
  vertices.commit();

  TextFile segments(folder / "segments.csv");
  const auto summary = parse_json_if_valid(session.summary);
  const auto trajectory = parse_json_if_valid(session.trajectory);
  const auto number_of = [&](const char* key, std::size_t i) {
    const bool there = summary.is_object() && summary.contains(key) && i < summary[key].size();
    return there && summary[key][i].is_number() ? summary[key][i].get<double>() : std::nan("");
  };
  const auto names = [&](const char* kind, Index count) {
    for (Index c = 0; c < count; ++c) {
      const std::size_t i = c;
      const bool named = trajectory.is_object() && trajectory.contains(kind) && i < trajectory[kind].size();
      segments.text("," +
                    (named ? trajectory[kind][i]["name"].get<std::string>() : std::string(kind) + std::to_string(c)));
    }
  };
  segments.text("segment,error_mm,predicted_error_mm,plan_seconds,estimate_seconds,plan_segments");
  if (!session.rounds.empty()) {
    names("controls", session.rounds[0].controls.cols());
    names("state", session.rounds[0].state.size());
  }
  for (const char* name : kPropertyNames) segments.print(",%s_centre,%s_width", name, name);
  segments.text("\n");
  for (std::size_t r = 0; r < session.rounds.size(); ++r) {
    const auto& round = session.rounds[r];
    const double error = session.goal_distance_mm(session.shape_after(r));
    segments.print("%zu,%.9g,%.9g,%.9g,%.9g,%td", r + 1, error, number_of("predicted_error_mm", r),
                   number_of("plan_seconds", r), number_of("estimate_seconds", r), round.controls.rows());
    for (Index c = 0; c < round.controls.cols(); ++c) segments.print(",%.9g", round.controls(0, c));
    for (Index c = 0; c < round.state.size(); ++c) segments.print(",%.9g", round.state(c));
    for (Index p = 0; p < 4; ++p) segments.print(",%.9g,%.9g", round.knowledge.centre(p), round.knowledge.width(p));
    segments.text("\n");
  }
  segments.commit();
}

}  // namespace weft::app
