#pragma once
#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "session/session_file.hpp"

/// Recorded sessions in the formats of other programs. docs/report.md says what each holds.
namespace weft::app {

/// Frames to export and the time of each.
struct Timeline {
  std::vector<std::size_t> frames;  ///< ascending indices into SessionRecord::frames
  std::vector<double> seconds;      ///< one per entry of `frames`
};
/// Every n-th frame, and always the one at which the hands let go and the last one.
Timeline every_nth(const SessionRecord& session, std::size_t n);

/// glTF 2.0 with one morph target per frame; binary unless the file ends in .gltf. @throws Error.
void export_gltf(const std::filesystem::path& file, const SessionRecord& session, const Timeline& timeline);
/// USD as text, points sampled over time; z up, metres, 60 time codes per second.
void export_usd(const std::filesystem::path& file, const SessionRecord& session, const Timeline& timeline);
/// folder/NNNN.obj per frame and goal.obj.
void export_obj(const std::filesystem::path& folder, const SessionRecord& session, const Timeline& timeline);
/// folder/vertices.csv (every vertex of every frame) and folder/segments.csv (a row per segment).
void export_csv(const std::filesystem::path& folder, const SessionRecord& session, const Timeline& timeline);

enum class View { perspective, side, top };
struct StillOptions {
  int width = 1600, height = 1000;  ///< pixels
  View view = View::perspective;
  bool goal = true;   ///< translucent, as on the page
  bool paths = true;  ///< where the hands went up to this frame
  bool edges = false;
  bool distance = false;     ///< colour by distance to the goal instead of front and back
  double range_mm = 0.0;     ///< end of the colour scale; 0: a round number that covers this session
  bool transparent = false;  ///< no background
};
/// Draws frames of one session, the same way as the page does, without a browser or a graphics card: same session, same
/// pictures. All of them share one camera and one colour scale.
class StillPainter {
 public:
  /// @param session must outlive this object.
  StillPainter(const SessionRecord& session, const StillOptions& options);
  ~StillPainter();
  StillPainter(const StillPainter&) = delete;
  StillPainter& operator=(const StillPainter&) = delete;
  /// @return [height, width, 4] red, green, blue, alpha; alpha is not multiplied into the colours.
  std::vector<unsigned char> draw(std::size_t frame) const;
  /// mm, the end of the colour scale of distances.
  double range_mm() const;
  const StillOptions& options() const;

 private:
  struct Scene;
  std::unique_ptr<const Scene> scene_;
};
/// Writes one frame as PNG. @throws WriteError.
void write_still(const std::filesystem::path& file, const StillPainter& painter, std::size_t frame);

struct FilmOptions {
  double frames_per_second = 30.0;  ///< (0, 60]
  double pause_s = 2.0;             ///< how long the last frame stays at least
  int quality = 100;                ///< [0, 100]; 100 loses nothing
};
/// An animated WebP that repeats without end.
/// @param progress called before each frame with the number of those that are done; what it throws ends the work.
/// @throws WriteError; Error if libwebp refuses. Nothing is written before the last frame is encoded.
void export_webp(const std::filesystem::path& file, const StillPainter& painter, const std::vector<std::size_t>& frames,
                 const FilmOptions& options, const std::function<void(std::size_t)>& progress);

}  // namespace weft::app
