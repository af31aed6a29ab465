#include <webp/encode.h>
#include <webp/mux.h>

#include <algorithm>
#include <cmath>
#include <memory>

#include "exports.hpp"
#include "sdk/files.hpp"
#include "weft/error.hpp"

namespace weft::app {
namespace {

[[noreturn]] void refuse(const std::string& what, const std::string& reason) {
  throw Error("libwebp: " + what + (reason.empty() ? "" : ": " + reason));
}

struct PictureOf {
  PictureOf(const std::vector<unsigned char>& rgba, int width, int height) {
    if (WebPPictureInit(&picture) == 0) refuse("another version than the one weft was built for", "");
    picture.use_argb = 1;
    picture.width = width;
    picture.height = height;
    if (WebPPictureImportRGBA(&picture, rgba.data(), width * 4) == 0)
      refuse("a frame cannot be held", "error " + std::to_string(picture.error_code));
  }
  ~PictureOf() { WebPPictureFree(&picture); }
  PictureOf(const PictureOf&) = delete;
  PictureOf& operator=(const PictureOf&) = delete;
  WebPPicture picture;
};

}  // namespace

void export_webp(const std::filesystem::path& file, const StillPainter& painter, const std::vector<std::size_t>& frames,
                 const FilmOptions& options, const std::function<void(std::size_t)>& progress) {
  const int width = painter.options().width, height = painter.options().height;
  WebPAnimEncoderOptions animation;
  WebPConfig config;
  if (WebPAnimEncoderOptionsInit(&animation) == 0 || WebPConfigInit(&config) == 0)
    refuse("another version than the one weft was built for", "");
  animation.kmin = animation.kmax =
      0;  // no key frames: nobody jumps into a film of seconds, and each costs a whole picture
  config.lossless = options.quality == 100 ? 1 : 0;
  config.quality = static_cast<float>(options.quality);
  const std::unique_ptr<WebPAnimEncoder, void (*)(WebPAnimEncoder*)> encoder(
      WebPAnimEncoderNew(width, height, &animation), WebPAnimEncoderDelete);
  if (!encoder) refuse("no animation of this size", "");

  // Times are whole milliseconds, so each comes from the frame's number: rounding does not add up.
  const double step_ms = 1000.0 / options.frames_per_second;
  const auto starts_ms = [&](std::size_t k) { return static_cast<int>(std::lround(static_cast<double>(k) * step_ms)); };
  for (std::size_t k = 0; k < frames.size(); ++k) {
    progress(k);
    PictureOf frame(painter.draw(frames[k]), width, height);
    if (WebPAnimEncoderAdd(encoder.get(), &frame.picture, starts_ms(k), &config) == 0)
      refuse("frame " + std::to_string(frames[k]), WebPAnimEncoderGetError(encoder.get()));
  }
  const double last_ms = std::max(step_ms, 1000.0 * options.pause_s);
  const int end_ms = starts_ms(frames.size() - 1) + static_cast<int>(std::lround(last_ms));
  WebPData data;
  WebPDataInit(&data);
  const std::unique_ptr<WebPData, void (*)(WebPData*)> release(&data, WebPDataClear);
  if (WebPAnimEncoderAdd(encoder.get(), nullptr, end_ms, nullptr) == 0 ||
      WebPAnimEncoderAssemble(encoder.get(), &data) == 0)
    refuse("the animation cannot be put together", WebPAnimEncoderGetError(encoder.get()));
  write_text(file, {reinterpret_cast<const char*>(data.bytes), data.size});
}

}  // namespace weft::app
