#pragma once
#include <filesystem>
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
/// Draws one frame, the same way as the page does, without a browser or a graphics card: same session, same picture.
/// @return the end of the colour scale in mm, when colouring by distance. @throws Error.
double write_still(const std::filesystem::path& file, const SessionRecord& session, std::size_t frame,
                   const StillOptions& options);

}  // namespace weft::app
