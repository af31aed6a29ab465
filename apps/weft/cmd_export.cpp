#include <algorithm>
#include <cstdio>
#include <optional>

#include "commands.hpp"
#include "exports.hpp"
#include "options.hpp"
#include "output.hpp"
#include "progress_line.hpp"
#include "report/page.hpp"

namespace weft::app {
namespace {

namespace fs = std::filesystem;

struct ExportOptions {
  std::string session;
  std::vector<std::string> formats;
  std::vector<std::string> stills;
  std::size_t every = 2;
  std::string view = "perspective";
  std::string size = "1600x1000";
  std::string colour = "fabric";
  bool no_goal = false, no_paths = false;
  StillOptions still;
  std::optional<double> frames_per_second;
  std::optional<double> pause_s;
  std::optional<int> quality;

  bool wants(const char* format) const { return std::find(formats.begin(), formats.end(), format) != formats.end(); }
};

/// A frame of --png: "last", "all", or a number of at most 8 digits.
bool is_frame(const std::string& text) {
  const bool is_number = text.find_first_not_of("0123456789") == std::string::npos;
  return text == "last" || text == "all" || (is_number && !text.empty() && text.size() < 9);
}

/// "last", "all" with --every, or a number. @param options whose stills is_frame() passed. @throws ConfigError.
std::vector<std::size_t> still_frames(const SessionRecord& session, const ExportOptions& options) {
  std::vector<std::size_t> frames;
  for (const auto& text : options.stills) {
    if (text == "last") {
      frames.push_back(session.frames.size() - 1);
    } else if (text == "all") {
      const auto timeline = every_nth(session, options.every);
      frames.insert(frames.end(), timeline.frames.begin(), timeline.frames.end());
    } else if (std::stoul(text) < session.frames.size()) {
      frames.push_back(std::stoul(text));
    } else {
      throw ConfigError("--png " + text + ": must be last, all, or a frame in [0, " +
                        std::to_string(session.frames.size() - 1) + "]");
    }
  }
  return frames;
}

/// Checks the options that depend on each other and completes options.still. @throws ConfigError.
void settle_options(ExportOptions& options) {
  if (options.formats.empty() && options.stills.empty())
    throw ConfigError("export: nothing to do; give --to, --png or both");
  const bool timed = options.frames_per_second || options.pause_s || options.quality;
  if (timed && !options.wants("webp"))
    throw ConfigError("--fps, --pause and --quality are of animations; give --to webp with them");
  if (std::sscanf(options.size.c_str(), "%dx%d", &options.still.width, &options.still.height) != 2 ||
      options.still.width < 16 || options.still.height < 16 || options.still.width > 8192 ||
      options.still.height > 8192) {
    throw ConfigError("--size " + options.size +
                      ": must be WIDTHxHEIGHT in pixels, such as 1600x1000, each in [16, 8192]");
  }
  options.still.view = options.view == "top" ? View::top : options.view == "side" ? View::side : View::perspective;
  options.still.distance = options.colour == "distance";
  options.still.goal = !options.no_goal;
  options.still.paths = !options.no_paths;
}

/// Frames a second at which an animation takes as long as the fold did, within what --fps allows.
double real_time_rate(std::size_t every) { return std::max(0.1, 60.0 / static_cast<double>(every)); }

/// Between two pictures. @throws Error if the user asked to stop.
void stop_if_asked(const Context& context, const fs::path& next) {
  if (*context.cancel_flag()) throw Error("interrupted; " + next.string() + " was not written");
}

void export_film(const Context& context, const fs::path& file, const StillPainter& painter, const Timeline& timeline,
                 const ExportOptions& options) {
  FilmOptions film;
  film.frames_per_second = options.frames_per_second.value_or(real_time_rate(options.every));
  film.pause_s = options.pause_s.value_or(film.pause_s);
  film.quality = options.quality.value_or(film.quality);
  ProgressLine line(context);
  const std::size_t frames = timeline.frames.size();
  export_webp(file, painter, timeline.frames, film, [&](std::size_t done) {
    stop_if_asked(context, file);
    line.show(file.filename().string() + ": " + std::to_string(10 * (10 * done / frames)) + " %");
  });
}

int run_export(Context& context, ExportOptions options) {
  const fs::path file = session_file(options.session);
  settle_options(options);
  Context::catch_signals();  // no file is left half written
  const SessionRecord session = read_session(file);
  const auto stills = still_frames(session, options);
  const bool pictures = !stills.empty() || options.wants("webp");
  // One output may be named; several go into a folder.
  const bool one = options.formats.size() + stills.size() == 1;
  const bool is_named = one && !context.out.empty();
  const fs::path folder = context.out.empty() ? file.parent_path()
                          : one               ? fs::path(context.out).parent_path()
                                              : fs::path(context.out);
  if (!folder.empty()) make_writable_folder(folder);
  const auto target = [&](const fs::path& name) { return is_named ? fs::path(context.out) : folder / name; };

  const auto timeline = every_nth(session, options.every);
  for (const auto& format : options.formats) {
    fs::path written;
    stop_if_asked(context, "a file of --to " + format);
    if (format == "gltf") {
      export_gltf(written = target("session.glb"), session, timeline);
    } else if (format == "usd") {
      export_usd(written = target("session.usda"), session, timeline);
    } else if (format == "obj") {
      export_obj(written = target("obj"), session, timeline);
    } else if (format == "csv") {
      export_csv(written = target("csv"), session, timeline);
    } else if (format == "html") {
      const auto page = find_report_template();
      if (page.text.empty()) throw Error("no page can be written: " + page.reason);
      write_text(written = target("report.html"), session_page(page.text, session));
    } else {
      continue;  // webp: below, with the other pictures
    }
    context.say(written.string());
  }
  if (!pictures) return 0;
  const StillPainter painter(session, options.still);
  const std::string scale =
      options.still.distance ? "  (colours: 0 to " + std::to_string(std::lround(painter.range_mm())) + " mm)" : "";
  if (options.wants("webp")) {
    const fs::path written = target("session.webp");
    export_film(context, written, painter, timeline, options);
    context.say(written.string() + scale);
  }
  for (const std::size_t frame : stills) {
    char name[32];
    std::snprintf(name, sizeof(name), "frame-%04zu.png", frame);
    const fs::path written = target(name);
    stop_if_asked(context, written);
    write_still(written, painter, frame);
    context.say(written.string() + scale);
  }
  return 0;
}

}  // namespace

void register_export(CLI::App& app, Context& context) {
  CLI::App* command = app.add_subcommand("export", "Write a recorded session for other programs, or as pictures");
  auto options = std::make_shared<ExportOptions>();
  command->add_option("session", options->session, "session.h5, or the folder of a run")->required();
  command->add_option("--to", options->formats, "gltf, usd, obj, csv, html or webp, an animation (repeatable)")
      ->check(CLI::IsMember({"gltf", "usd", "obj", "csv", "html", "webp"}))
      ->allow_extra_args(false);
  command
      ->add_option("--png", options->stills, "Stills: frame numbers, last, or all (with --every); separated by commas")
      ->delimiter(',')
      ->check([](const std::string& text) {
        return is_frame(text) ? std::string() : text + ", must be last, all, or the number of a frame";
      })
      ->allow_extra_args(false);
  command
      ->add_option("--every", options->every,
                   "Every n-th frame of 1/60 s; the release and the last frame are always included")
      ->check(within(std::size_t{1}, std::size_t{100000}))
      ->capture_default_str();
  command->add_option("--size", options->size, "Size of pictures in pixels")->capture_default_str();
  command->add_option("--view", options->view, "Side from which pictures show the cloth")
      ->check(CLI::IsMember({"perspective", "side", "top"}))
      ->capture_default_str();
  command
      ->add_option("--colour", options->colour,
                   "Colour of the cloth in pictures: its two sides, or its distance to the goal")
      ->check(CLI::IsMember({"fabric", "distance"}))
      ->capture_default_str();
  command
      ->add_option("--range", options->still.range_mm,
                   "End of the colour scale of distances, mm; 0: a round number that covers the session")
      ->check(within(0.0, 1e6));
  command->add_flag("--edges", options->still.edges, "Draw the mesh edges in pictures");
  command->add_flag("--no-goal", options->no_goal, "Leave the goal out of pictures");
  command->add_flag("--no-paths", options->no_paths, "Leave the path of the hands out of pictures");
  command->add_flag("--transparent", options->still.transparent, "No background and no ground in pictures");
  command
      ->add_option("--fps", options->frames_per_second,
                   "Frames a second of the animation; default: as fast as it happened, 60 / --every")
      ->check(within(0.1, 60.0));
  command->add_option("--pause", options->pause_s, "How long the animation stays at its last frame, s; default: 2")
      ->check(within(0.0, 60.0));
  command
      ->add_option("--quality", options->quality,
                   "100 (default): every pixel of the animation as drawn; lower: smaller and less exact")
      ->check(within(0, 100));
  command->add_option("--out", context.out, "File, or folder when several are written; default: beside the session");
  command->add_flag("--quiet", context.quiet, "Print nothing but errors");
  command->callback(
      [&context, options] { context.action = [&context, options] { return run_export(context, *options); }; });
}

}  // namespace weft::app
