#include <png.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "exports.hpp"
#include "sdk/files.hpp"
#include "weft/garment.hpp"

namespace weft::app {
/// What StillPainter::Scene is made of: a class of a header has no members of an anonymous namespace.
namespace still {

using Eigen::Vector3d;

/// Seen from outside the shape: a pinhole camera that looks at a point, z up.
struct Camera {
  /// Puts all points into the picture, for any direction and any shape of the picture.
  Camera(const std::vector<Vector3d>& points, const Vector3d& direction, int width, int height) {
    const double tangent = std::tan(17.5 * std::numbers::pi / 180.0);  // half the field of view, as on the page
    back = direction.normalized();
    right = Vector3d::UnitZ().cross(back).normalized();
    up = back.cross(right);
    focal = height / 2.0 / tangent;
    middle = {width / 2.0, height / 2.0};
    Vector3d target = Vector3d::Zero();
    for (const auto& point : points) target += point / static_cast<double>(points.size());
    double distance = 2.0;
    for (int step = 0; step < 12; ++step) {
      eye = target + distance * back;
      Eigen::Array2d low = Eigen::Array2d::Constant(1e9), high = -low;
      for (const auto& point : points) {
        const Eigen::Array2d seen = project(point).head<2>().array();
        low = low.min(seen);
        high = high.max(seen);
      }
      const Eigen::Array2d shift = (low + high) / 2 - middle.array();
      target += distance / focal * (shift.x() * right - shift.y() * up);
      distance *= std::max((high.x() - low.x()) / width, (high.y() - low.y()) / height) / 0.95;
    }
    eye = target + distance * back;
  }
  /// Pixel x, y (y down) and distance along the view.
  Vector3d project(const Vector3d& point) const {
    const Vector3d offset = point - eye;
    const double depth = -offset.dot(back);
    return {middle.x() + focal * offset.dot(right) / depth, middle.y() - focal * offset.dot(up) / depth, depth};
  }
  Vector3d eye, right, up, back;
  double focal;
  Eigen::Vector2d middle;
};

/// What the pictures of a session show: its shapes, the goal and the way of the hands.
/// One camera for the whole session: stills of several frames fit on each other.
struct Subject {
  explicit Subject(const SessionRecord& session) {
    const std::size_t halfway = session.segment_frame(session.segments()) / 2;
    for (const Positions* shape :
         {&session.frames.front(), &session.frames[halfway], &session.frames.back(), &session.goal}) {
      for (Index v = 0; v < shape->rows(); ++v) points.emplace_back(shape->row(v).transpose());
      low = low.cwiseMin(shape->colwise().minCoeff().transpose());
      high = high.cwiseMax(shape->colwise().maxCoeff().transpose());
    }
    const std::size_t release = session.segment_frame(session.segments());
    for (std::size_t f = 0; f <= release; ++f) {
      for (const Index vertex : session.grasp_vertices) points.emplace_back(session.frames[f].row(vertex).transpose());
    }
  }
  std::vector<Vector3d> points;
  Vector3d low = Vector3d::Constant(1e9), high = -low;  ///< box of the shapes
};

}  // namespace still

namespace {

using Eigen::Vector3d;
using still::Camera;
using still::Subject;
using Colour = Eigen::Vector3f;

constexpr int kSamples = 3;  // per pixel and axis
constexpr double kNear = 0.02;

/// Colours and 1 / depth per sample. Larger is nearer.
struct Canvas {
  Canvas(int w, int h)
      : width(w),
        height(h),
        colour(static_cast<std::size_t>(w) * h, Colour::Zero()),
        near(colour.size(), 0.0f),
        covered(colour.size(), 0) {}
  std::size_t at(int x, int y) const { return static_cast<std::size_t>(y) * width + x; }

  /// Calls visit(sample, weights of a, b, c; 1 / depth) for every sample inside a triangle of projected points.
  template <class Visit>
  void triangle(const Vector3d& a, const Vector3d& b, const Vector3d& c, Visit visit) const {
    if (std::min({a.z(), b.z(), c.z()}) < kNear) return;
    const double area = (b.x() - a.x()) * (c.y() - a.y()) - (b.y() - a.y()) * (c.x() - a.x());
    if (std::abs(area) < 1e-12) return;
    const int x0 = std::max(0, static_cast<int>(std::ceil(std::min({a.x(), b.x(), c.x()}) - 0.5)));
    const int x1 = std::min(width - 1, static_cast<int>(std::floor(std::max({a.x(), b.x(), c.x()}) - 0.5)));
    const int y0 = std::max(0, static_cast<int>(std::ceil(std::min({a.y(), b.y(), c.y()}) - 0.5)));
    const int y1 = std::min(height - 1, static_cast<int>(std::floor(std::max({a.y(), b.y(), c.y()}) - 0.5)));
    for (int y = y0; y <= y1; ++y) {
      for (int x = x0; x <= x1; ++x) {
        const double px = x + 0.5, py = y + 0.5;
        const double u = ((b.x() - px) * (c.y() - py) - (b.y() - py) * (c.x() - px)) / area;
        const double v = ((c.x() - px) * (a.y() - py) - (c.y() - py) * (a.x() - px)) / area;
        const double w = 1.0 - u - v;
        if (u < 0 || v < 0 || w < 0) continue;
        visit(at(x, y), u, v, w, static_cast<float>(u / a.z() + v / b.z() + w / c.z()));
      }
    }
  }
  /// A line of the given thickness in samples, hidden where something is nearer by more than the slack.
  void line(const Vector3d& a, const Vector3d& b, double thickness, const Colour& paint, float opacity, float slack) {
    if (std::min(a.z(), b.z()) < kNear) return;
    const int steps = static_cast<int>(std::max(std::abs(b.x() - a.x()), std::abs(b.y() - a.y()))) + 1;
    const bool flat = std::abs(b.x() - a.x()) > std::abs(b.y() - a.y());
    const int reach = std::max(1, static_cast<int>(std::lround(thickness)));
    for (int i = 0; i <= steps; ++i) {
      const double t = static_cast<double>(i) / steps;
      const auto inverse = static_cast<float>((1 - t) / a.z() + t / b.z());
      for (int k = 0; k < reach; ++k) {
        const double shift = k - (reach - 1) / 2.0;
        const int x = static_cast<int>(std::floor(a.x() + t * (b.x() - a.x()) + (flat ? 0 : shift)));
        const int y = static_cast<int>(std::floor(a.y() + t * (b.y() - a.y()) + (flat ? shift : 0)));
        if (x < 0 || y < 0 || x >= width || y >= height || near[at(x, y)] > inverse * (1 + slack)) continue;
        colour[at(x, y)] += opacity * (paint - colour[at(x, y)]);
        covered[at(x, y)] = 1;
      }
    }
  }

  /// A filled circle around a point, as if all of it were where the point is.
  void disc(const Vector3d& centre, double radius, const Colour& paint) {
    if (centre.z() < kNear) return;
    const auto inverse = static_cast<float>(1.0 / centre.z());
    const int x0 = static_cast<int>(centre.x() - radius), y0 = static_cast<int>(centre.y() - radius);
    const int size = static_cast<int>(std::ceil(2 * radius));
    for (int y = std::max(0, y0); y <= std::min(height - 1, y0 + size); ++y) {
      for (int x = std::max(0, x0); x <= std::min(width - 1, x0 + size); ++x) {
        if (std::hypot(x + 0.5 - centre.x(), y + 0.5 - centre.y()) > radius) continue;
        if (near[at(x, y)] > inverse * 1.02f) continue;
        colour[at(x, y)] = paint;
        covered[at(x, y)] = 1;
      }
    }
  }

  int width, height;
  std::vector<Colour> colour;
  std::vector<float> near;
  std::vector<unsigned char> covered;
};

Colour rgb(unsigned code) {
  return {static_cast<float>(code >> 16 & 255) / 255, static_cast<float>(code >> 8 & 255) / 255,
          static_cast<float>(code & 255) / 255};
}

/// The colour map viridis, by its values at ninths.
Colour viridis(double t) {
  static constexpr std::array<unsigned, 10> kStops = {0x440154, 0x482878, 0x3e4a89, 0x31688e, 0x26828e,
                                                      0x1f9e89, 0x35b779, 0x6ece58, 0xb5de2b, 0xfde725};
  const double at = std::clamp(t, 0.0, 1.0) * 9;
  const auto low = std::min<std::size_t>(8, static_cast<std::size_t>(at));
  return rgb(kStops[low]) +
         static_cast<float>(at - static_cast<double>(low)) * (rgb(kStops[low + 1]) - rgb(kStops[low]));
}

double nice_ceiling(double value) {
  const double power = std::pow(10.0, std::floor(std::log10(std::max(value, 1e-9))));
  for (const double step : {1.0, 2.0, 3.0, 5.0}) {
    if (step * power >= 0.999 * value) return step * power;
  }
  return 10 * power;
}

struct Surface {
  Surface(const Positions& shape, const Faces& topology, const Camera& camera)
      : positions(shape), faces(topology), normals(Positions::Zero(shape.rows(), 3)) {
    for (Index f = 0; f < faces.rows(); ++f) {
      const Vector3d a = corner(f, 0), b = corner(f, 1), c = corner(f, 2);
      for (int k = 0; k < 3; ++k) normals.row(faces(f, k)) += (b - a).cross(c - a).transpose();
    }
    for (Index v = 0; v < shape.rows(); ++v) projected.push_back(camera.project(shape.row(v).transpose()));
  }
  Vector3d corner(Index face, int k) const { return positions.row(faces(face, k)).transpose(); }
  /// The projected corners of a face.
  std::array<Vector3d, 3> corners(Index f) const {
    return {projected[faces(f, 0)], projected[faces(f, 1)], projected[faces(f, 2)]};
  }
  bool faces_camera(Index f, const Camera& camera) const {
    const Vector3d a = corner(f, 0);
    return (corner(f, 1) - a).cross(corner(f, 2) - a).dot(camera.eye - a) > 0;
  }
  /// Light on a point of a face, as the page's shader has it.
  double light(Index f, double u, double v, double w, double side, const Camera& camera) const {
    Vector3d n =
        (u * normals.row(faces(f, 0)) + v * normals.row(faces(f, 1)) + w * normals.row(faces(f, 2))).transpose();
    n = side * n.normalized();
    return 0.62 + 0.27 * std::max(0.0, n.dot(Vector3d(0.28, -0.36, 0.89))) + 0.19 * std::abs(n.dot(camera.back));
  }
  const Positions& positions;
  const Faces& faces;
  Positions normals;
  std::vector<Vector3d> projected;
};

void draw_ground(Canvas& canvas, const Camera& camera, const Vector3d& low, const Vector3d& high) {
  constexpr double kCell = 0.1;
  const auto first = [&](double x) { return static_cast<int>(std::floor((x - kCell) / kCell)); };
  const auto last = [&](double x) { return static_cast<int>(std::ceil((x + kCell) / kCell)); };
  const int x0 = first(low.x()), x1 = last(high.x()), y0 = first(low.y()), y1 = last(high.y());
  const auto rule = [&](const Vector3d& a, const Vector3d& b, bool strong) {
    canvas.line(camera.project(a), camera.project(b), strong ? 0.6 * kSamples : 0.4 * kSamples,
                rgb(strong ? 0x97a3ae : 0xc3cbd3), 1.0f, 0.0f);
  };
  for (int i = x0; i <= x1; ++i) rule({i * kCell, y0 * kCell, 0}, {i * kCell, y1 * kCell, 0}, (i - x0) % 5 == 0);
  for (int i = y0; i <= y1; ++i) rule({x0 * kCell, i * kCell, 0}, {x1 * kCell, i * kCell, 0}, (i - y0) % 5 == 0);
}

void draw_shadow(Canvas& canvas, const Camera& camera, const Positions& shape, const Faces& faces) {
  std::vector<Vector3d> flat;
  for (Index v = 0; v < shape.rows(); ++v) flat.push_back(camera.project({shape(v, 0), shape(v, 1), 2e-4}));
  for (Index f = 0; f < faces.rows(); ++f) {
    canvas.triangle(flat[faces(f, 0)], flat[faces(f, 1)], flat[faces(f, 2)],
                    [&](std::size_t i, double, double, double, float inverse) {
                      canvas.colour[i] = rgb(0xd4dae0);
                      canvas.near[i] = std::max(canvas.near[i], inverse);
                      canvas.covered[i] = 1;
                    });
  }
}

/// From what the camera looks at to the camera.
Vector3d direction_of(View view) {
  if (view == View::top) return {0, -0.001, 1};
  if (view == View::side) return {0, -1, 0.06};
  return {-0.35, -1, 0.72};
}

/// A round number of mm that holds the distances of the session's last frame.
double round_range(const SessionRecord& session) {
  const Vector at_end = session.vertex_distances_mm(session.final_shape);
  std::vector<double> sorted(at_end.begin(), at_end.end());
  std::sort(sorted.begin(), sorted.end());
  return nice_ceiling(
      std::max({10.0, 0.5 * session.goal_distance_mm(session.default_shape), sorted[sorted.size() * 98 / 100]}));
}

/// @param base base(face, front, u, v, w): the colour of a point of a face before light falls on it.
template <class Base>
void draw_cloth(Canvas& canvas, const Camera& camera, const Surface& cloth, Base base) {
  for (Index f = 0; f < cloth.faces.rows(); ++f) {
    const bool front = cloth.faces_camera(f, camera);
    const auto p = cloth.corners(f);
    canvas.triangle(p[0], p[1], p[2], [&](std::size_t i, double u, double v, double w, float inverse) {
      if (inverse <= canvas.near[i]) return;
      const Colour paint = base(f, front, u, v, w);
      canvas.colour[i] = (static_cast<float>(cloth.light(f, u, v, w, front ? 1 : -1, camera)) * paint).cwiseMin(1.0f);
      canvas.near[i] = inverse;
      canvas.covered[i] = 1;
    });
  }
}

void draw_edges(Canvas& canvas, const Surface& cloth) {
  for (Index f = 0; f < cloth.faces.rows(); ++f) {
    const auto p = cloth.corners(f);
    for (std::size_t k = 0; k < 3; ++k) canvas.line(p[k], p[(k + 1) % 3], 0.34 * kSamples, rgb(0x10202f), 0.5f, 0.002f);
  }
}

/// The nearest layer of the goal tints each sample once.
void draw_goal(Canvas& canvas, const Camera& camera, const Surface& goal) {
  std::vector<std::pair<float, Colour>> tint(canvas.colour.size(), {0.0f, Colour::Zero()});
  for (Index f = 0; f < goal.faces.rows(); ++f) {
    const double side = goal.faces_camera(f, camera) ? 1 : -1;
    const auto p = goal.corners(f);
    canvas.triangle(p[0], p[1], p[2], [&](std::size_t i, double u, double v, double w, float inverse) {
      // As on the page: within a few millimetres of the cloth, the cloth is what shows.
      const float behind = inverse / (1.0f + 0.006f * inverse);
      if (behind <= canvas.near[i] || inverse <= tint[i].first) return;
      tint[i] = {inverse, (static_cast<float>(goal.light(f, u, v, w, side, camera)) * rgb(0x00855f)).cwiseMin(1.0f)};
    });
  }
  for (std::size_t i = 0; i < tint.size(); ++i) {
    if (tint[i].first <= 0) continue;
    canvas.colour[i] += (canvas.covered[i] ? 0.42f : 1.0f) * (tint[i].second - canvas.colour[i]);
    canvas.covered[i] = 1;
  }
}

/// Where the hands went up to a frame, and where they are while they hold the cloth.
void draw_paths(Canvas& canvas, const Camera& camera, const SessionRecord& session, std::size_t frame) {
  const double pixel = canvas.width / 1600.0;  // the same share of every picture
  for (Index hand = 0; hand < std::ssize(session.grasp_vertices); ++hand) {
    const Index vertex = session.grasp_vertices[hand];
    const std::size_t release = session.held_until(hand);
    const auto at = [&](std::size_t f) { return camera.project(session.frames[f].row(vertex).transpose()); };
    for (std::size_t f = 0; f < std::min(frame, release); ++f)
      canvas.line(at(f), at(f + 1), 3.0 * pixel, rgb(0xb23a00), 1.0f, 0.005f);
    if (frame <= release) canvas.disc(at(frame), 9.0 * pixel, rgb(0xb23a00));
  }
}

/// The mean of every pixel's samples; opaque as far as they are covered.
/// @return [height, width, 4] red, green, blue, alpha.
std::vector<unsigned char> pixels_of(const Canvas& canvas) {
  const int width = canvas.width / kSamples, height = canvas.height / kSamples;
  std::vector<unsigned char> pixels;
  pixels.reserve(canvas.colour.size() / (kSamples * kSamples) * 4);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      Colour sum = Colour::Zero();
      int hits = 0;
      for (int k = 0; k < kSamples * kSamples; ++k) {
        const std::size_t i = canvas.at(x * kSamples + k % kSamples, y * kSamples + k / kSamples);
        if (!canvas.covered[i]) continue;
        sum += canvas.colour[i];
        ++hits;
      }
      if (hits > 0) sum /= static_cast<float>(hits);
      for (int c = 0; c < 3; ++c)
        pixels.push_back(static_cast<unsigned char>(std::lround(255 * std::clamp(sum[c], 0.0f, 1.0f))));
      pixels.push_back(static_cast<unsigned char>(255 * hits / (kSamples * kSamples)));
    }
  }
  return pixels;
}

}  // namespace

/// What does not change from frame to frame.
struct StillPainter::Scene {
  Scene(const SessionRecord& of, const StillOptions& how)
      : session(of),
        options(how),
        subject(of),
        camera(subject.points, direction_of(how.view), how.width * kSamples, how.height * kSamples),
        range_mm(how.distance && how.range_mm <= 0 ? round_range(of) : how.range_mm) {
    for (std::size_t k = 0; k < of.obstacles.size(); ++k) obstacles.push_back(of.drawn_obstacle(k));
    if (how.goal) goal = of.drawn_goal();
  }
  const SessionRecord& session;
  StillOptions options;
  still::Subject subject;
  still::Camera camera;
  double range_mm;
  std::vector<Mesh> obstacles;
  Mesh goal;  ///< empty if it is left out
};

StillPainter::StillPainter(const SessionRecord& session, const StillOptions& options)
    : scene_(std::make_unique<const Scene>(session, options)) {}
StillPainter::~StillPainter() = default;
double StillPainter::range_mm() const { return scene_->range_mm; }
const StillOptions& StillPainter::options() const { return scene_->options; }

std::vector<unsigned char> StillPainter::draw(std::size_t frame) const {
  const SessionRecord& session = scene_->session;
  const StillOptions& options = scene_->options;
  const Camera& camera = scene_->camera;
  const Positions& shape = session.frames.at(frame);
  Canvas canvas(options.width * kSamples, options.height * kSamples);
  if (!options.transparent) {
    std::fill(canvas.colour.begin(), canvas.colour.end(), Colour::Ones());
    std::fill(canvas.covered.begin(), canvas.covered.end(), static_cast<unsigned char>(1));
    draw_ground(canvas, camera, scene_->subject.low, scene_->subject.high);
    draw_shadow(canvas, camera, shape, session.faces);
  }
  for (const Mesh& body : scene_->obstacles) {
    draw_cloth(canvas, camera, Surface(body.positions, body.faces, camera),
               [](Index, bool, double, double, double) { return rgb(0xb9b2a7); });
  }
  const Vector distances = options.distance ? session.vertex_distances_mm(shape) : Vector();
  const Surface cloth(shape, session.faces, camera);
  draw_cloth(canvas, camera, cloth, [&](Index f, bool front, double u, double v, double w) {
    if (!options.distance) return rgb(front ? 0x4a8bc9 : 0xe5a13c);
    const Faces& faces = session.faces;
    return viridis((u * distances(faces(f, 0)) + v * distances(faces(f, 1)) + w * distances(faces(f, 2))) /
                   scene_->range_mm);
  });
  if (options.edges) draw_edges(canvas, cloth);
  if (options.goal) draw_goal(canvas, camera, Surface(scene_->goal.positions, scene_->goal.faces, camera));
  if (options.paths) draw_paths(canvas, camera, session, frame);
  return pixels_of(canvas);
}

void write_still(const std::filesystem::path& file, const StillPainter& painter, std::size_t frame) {
  const std::vector<unsigned char> pixels = painter.draw(frame);
  png_image image{};
  image.version = PNG_IMAGE_VERSION;
  image.width = static_cast<png_uint_32>(painter.options().width);
  image.height = static_cast<png_uint_32>(painter.options().height);
  image.format = PNG_FORMAT_RGBA;
  // Not into a file by libpng itself, which does not say why it cannot be written.
  std::string bytes(PNG_IMAGE_PNG_SIZE_MAX(image), '\0');
  png_alloc_size_t size = bytes.size();
  if (png_image_write_to_memory(&image, bytes.data(), &size, 0, pixels.data(), 0, nullptr) == 0)
    throw Error(file.string() + ": cannot be made: " + image.message);
  write_text(file, std::string_view(bytes).substr(0, size));
}

}  // namespace weft::app
