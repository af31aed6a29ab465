// weft export: a session is run, written in every format, and each file is read back and compared with session.h5.
#include <png.h>
#include <tiny_gltf.h>
#include <unistd.h>
#include <webp/demux.h>

#include <Eigen/Geometry>
#include <cmath>
#include <cstring>
#include <nlohmann/json.hpp>
#include <sstream>

#include "session/session_file.hpp"
#include "unit/test_program.hpp"
#include "unit/test_support.hpp"
#include "weft/garment.hpp"
#include "weft/hdf5_file.hpp"

namespace weft {
namespace {

namespace fs = std::filesystem;
using test::Outcome;
using ::testing::HasSubstr;
using ::testing::Not;

Outcome weft_command(const std::string& arguments) {
  return test::run_shell("unset WEFT_PLUGIN_PATH; '" WEFT_PROGRAM "' " + arguments);
}

std::string read_text(const fs::path& file) {
  std::ifstream stream(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), {}};
}

/// Lines of a CSV file, split at commas.
std::vector<std::vector<std::string>> read_csv(const fs::path& file) {
  std::vector<std::vector<std::string>> rows;
  std::ifstream stream(file);
  for (std::string line; std::getline(stream, line);) {
    rows.emplace_back();
    std::istringstream cells(line);
    for (std::string cell; std::getline(cells, cell, ',');) rows.back().push_back(cell);
  }
  return rows;
}

/// One session for all tests: a coarse towel, a plan without search.
class Export : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    folder_ = new test::Folder;
    const auto config =
        folder_->write("fold.yaml", "garment: " WEFT_SOURCE_DIR
                                    "/configs/garments/towel_coarse.yaml\n"
                                    "material: " WEFT_SOURCE_DIR
                                    "/configs/fabrics/basic.yaml\n"
                                    "manipulation: {grasp: [left_bottom, left_top], displacement_m: [0.38, 0]}\n"
                                    "simulator: {plugin: cloth}\n"
                                    "trajectory: {plugin: arc}\n"
                                    "predictor: {plugin: rollout}\n"
                                    "planning: {instances: 1, iterations: 0, replan_iterations: 0, horizon: 14}\n"
                                    "goal: {controls: [1.5, 0, 0.05, 0.0002, 0]}\n"
                                    "settle: {max_frames: 50}\n");
    const Outcome outcome =
        weft_command("run '" + config.string() + "' --quiet --out '" + (*folder_ / "run").string() + "'");
    ASSERT_EQ(outcome.code, 0) << outcome.output;
    session_ = new SessionRecord(read_session(*folder_ / "run/session.h5"));
  }
  static void TearDownTestSuite() {
    delete session_;
    delete folder_;
  }
  void SetUp() override { ASSERT_NE(session_, nullptr); }

  static fs::path run_folder() { return *folder_ / "run"; }
  static Outcome export_command(const std::string& arguments) {
    return weft_command("export '" + run_folder().string() + "' " + arguments);
  }
  static const Positions& frame(std::size_t k) { return session_->frames.at(k); }

  static test::Folder* folder_;
  static SessionRecord* session_;
};
test::Folder* Export::folder_ = nullptr;
SessionRecord* Export::session_ = nullptr;

TEST_F(Export, RecordsTheReleaseAndTheSettling) {
  const auto summary = nlohmann::json::parse(session_->summary);
  EXPECT_TRUE(session_->released());
  EXPECT_EQ(session_->settle_frames(), summary.at("settle_frames").get<Index>());
  EXPECT_GT(session_->settle_frames(), 6);
  EXPECT_LT((session_->frames.back() - session_->final_shape).cwiseAbs().maxCoeff(), 1e-6);
  // The held corners are at the end of the executed path until the hands let go. Then they fall.
  const auto release = static_cast<std::size_t>(session_->segment_frame(session_->segments()));
  const Index corner = session_->grasp_vertices.at(0);
  EXPECT_GT(frame(release)(corner, 2), 0.03);
  EXPECT_LT(frame(release + 5)(corner, 2), frame(release)(corner, 2));
  EXPECT_LT(session_->frames.back()(corner, 2), 0.01);
}

TEST_F(Export, SessionRecordsWherePlansWouldTakeTheHands) {
  // The first segment of each plan was executed, so the held vertices followed it.
  for (Index r = 0; r < session_->segments(); ++r) {
    const auto& round = session_->rounds[r];
    ASSERT_EQ(static_cast<Index>(round.targets.size()), round.controls.rows() * kFramesPerSegment);
    for (Index f = 0; f < kFramesPerSegment; ++f) {
      const Positions& shape = frame(static_cast<std::size_t>(session_->segment_frame(r) + f + 1));
      for (std::size_t hand = 0; hand < 2; ++hand) {
        const auto target = round.targets[f].row(hand);
        EXPECT_LT((shape.row(session_->grasp_vertices[hand]) - target).norm(), 1e-6) << r << " " << f;
      }
    }
  }
  EXPECT_THAT(session_->trajectory, HasSubstr("dtheta"));
}

/// Numbers of an accessor, [count, components].
Controls numbers_of(const tinygltf::Model& model, int accessor_index) {
  const auto& accessor = model.accessors.at(accessor_index);
  EXPECT_EQ(accessor.componentType, TINYGLTF_COMPONENT_TYPE_FLOAT);
  const auto& view = model.bufferViews.at(accessor.bufferView);
  const auto& buffer = model.buffers.at(view.buffer).data;
  const auto columns =
      static_cast<std::size_t>(tinygltf::GetNumComponentsInType(static_cast<std::uint32_t>(accessor.type)));
  std::vector<float> values(accessor.count * columns);
  EXPECT_EQ(view.byteLength, values.size() * sizeof(float));
  std::memcpy(values.data(), buffer.data() + view.byteOffset, view.byteLength);
  using Single = Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  return Eigen::Map<const Single>(values.data(), static_cast<Index>(accessor.count), static_cast<Index>(columns))
      .cast<double>();
}

void check_gltf(const tinygltf::Model& model, const SessionRecord& session) {
  ASSERT_EQ(model.meshes.size(), 2u);
  const auto& primitive = model.meshes[0].primitives.at(0);
  const Controls base = numbers_of(model, primitive.attributes.at("POSITION"));
  ASSERT_EQ(base.rows(), session.vertex_count());
  EXPECT_EQ(model.accessors.at(primitive.indices).count, static_cast<std::size_t>(session.faces.size()));
  ASSERT_EQ(model.animations.size(), 1u);
  const auto& sampler = model.animations[0].samplers.at(0);
  const Controls times = numbers_of(model, sampler.input);
  const Controls weights = numbers_of(model, sampler.output);
  const auto targets = static_cast<Index>(primitive.targets.size());
  ASSERT_EQ(weights.size(), times.rows() * targets);
  EXPECT_NEAR(times(times.rows() - 1, 0), static_cast<double>(session.frames.size() - 1) * kFrameSeconds, 1e-5);
  // Every key: base plus weighted targets is the recorded frame at that time.
  for (Index k = 0; k < times.rows(); ++k) {
    Controls shape = base;
    for (Index t = 0; t < targets; ++t) {
      const double weight = weights(k * targets + t, 0);
      if (weight != 0.0) shape += weight * numbers_of(model, primitive.targets[t].at("POSITION"));
    }
    const auto recorded = static_cast<std::size_t>(std::lround(times(k, 0) / kFrameSeconds));
    EXPECT_LT((shape - session.frames.at(recorded)).cwiseAbs().maxCoeff(), 1e-6) << "key " << k;
  }
  const Controls goal = numbers_of(model, model.meshes[1].primitives.at(0).attributes.at("POSITION"));
  EXPECT_LT((goal - session.goal).cwiseAbs().maxCoeff(), 1e-6);
  // z up becomes y up.
  const auto& root = model.nodes.at(model.scenes.at(0).nodes.at(0));
  const Eigen::Quaterniond turn(root.rotation.at(3), root.rotation.at(0), root.rotation.at(1), root.rotation.at(2));
  EXPECT_LT((turn * Eigen::Vector3d::UnitZ() - Eigen::Vector3d::UnitY()).norm(), 1e-12);
}

TEST_F(Export, AFileThatCannotBeWrittenWholeIsAnError) {
  // A limit on the size of files fails as a full disk does.
  const std::pair<const char*, const char*> outputs[] = {{"full.glb", "--to gltf"},
                                                         {"full.gltf", "--to gltf"},
                                                         {"full.csv", "--to csv"},
                                                         {"full.usda", "--to usd"},
                                                         {"full.html", "--to html"},
                                                         {"full.png", "--png last --size 800x600"},
                                                         {"full.webp", "--to webp --size 480x300 --every 24"}};
  for (const auto& [name, to] : outputs) {
    const Outcome limited =
        test::run_shell("unset WEFT_PLUGIN_PATH; ulimit -f 8; '" WEFT_PROGRAM "' export '" + run_folder().string() +
                        "' " + to + " --quiet --out '" + (*folder_ / name).string() + "'");
    EXPECT_EQ(limited.code, 1) << name << limited.output;
    EXPECT_THAT(limited.output, testing::AllOf(HasSubstr(name), HasSubstr("cannot be written: File too large")))
        << name;
    EXPECT_FALSE(fs::is_regular_file(*folder_ / name)) << name;
    for (const auto& entry : fs::recursive_directory_iterator(folder_->path()))
      EXPECT_EQ(entry.path().filename().string().find(".tmp"), std::string::npos) << entry.path();
  }
}

TEST_F(Export, ASessionThatMayOnlyBeReadIsExportedElsewhere) {
  const fs::path session = *folder_ / "shared", out = *folder_ / "mine";
  for (const auto& made : {session, out}) fs::create_directory(made);
  fs::copy_file(run_folder() / "session.h5", session / "session.h5");
  fs::permissions(folder_->path(), fs::perms(0755));
  fs::permissions(session, fs::perms(0555));
  fs::permissions(out, fs::perms(0777));
  // Root may write anywhere, so the command runs as somebody else, unless weft lies where only root may read.
  std::string user = geteuid() == 0 ? "setpriv --reuid=65534 --regid=65534 --clear-groups " : "";
  if (test::run_shell(user + "test -r '" WEFT_PROGRAM "'").code != 0) user = "";
  const auto exported = [&](const std::string& arguments) {
    return test::run_shell("unset WEFT_PLUGIN_PATH; cd /; " + user + "'" WEFT_PROGRAM "' export '" + session.string() +
                           "' --quiet --every 40 " + arguments);
  };
  for (const std::string& to :
       {"--to csv --out '" + (out / "csv").string() + "'", "--to gltf --out '" + (out / "fold.glb").string() + "'",
        "--to csv --to usd --out '" + (out / "both").string() + "'"}) {
    const Outcome outcome = exported(to);
    EXPECT_EQ(outcome.code, 0) << to << outcome.output;
  }
  EXPECT_TRUE(fs::exists(out / "csv") && fs::exists(out / "fold.glb") && fs::exists(out / "both"));
  if (!user.empty() || geteuid() != 0) {
    EXPECT_THAT(exported("--to csv").output, HasSubstr("shared: no file can be written in this folder: "));
  }
}

TEST_F(Export, GltfHoldsEveryExportedFrame) {
  const fs::path binary = *folder_ / "a.glb", text = *folder_ / "a.gltf";
  ASSERT_EQ(export_command("--to gltf --every 5 --quiet --out '" + binary.string() + "'").code, 0);
  ASSERT_EQ(export_command("--to gltf --every 40 --quiet --out '" + text.string() + "'").code, 0);
  tinygltf::TinyGLTF loader;
  std::string error, warning;
  tinygltf::Model one, other;
  ASSERT_TRUE(loader.LoadBinaryFromFile(&one, &error, &warning, binary.string())) << error;
  EXPECT_EQ(error + warning, "");
  check_gltf(one, *session_);
  ASSERT_TRUE(loader.LoadASCIIFromFile(&other, &error, &warning, text.string())) << error;
  EXPECT_EQ(error + warning, "");
  check_gltf(other, *session_);
  EXPECT_GT(one.meshes[0].primitives[0].targets.size(), other.meshes[0].primitives[0].targets.size());
}

TEST_F(Export, ObjHoldsTheFrameThatItsNameSays) {
  const fs::path out = *folder_ / "objects";
  ASSERT_EQ(export_command("--to obj --every 30 --quiet --out '" + out.string() + "'").code, 0);
  std::size_t found = 0;
  for (const auto& entry : fs::directory_iterator(out)) {
    const Mesh mesh = read_obj(entry.path());
    EXPECT_EQ(mesh.faces, session_->faces);
    EXPECT_LT((mesh.rest - session_->rest).cwiseAbs().maxCoeff(), 1e-8);
    const bool goal = entry.path().filename() == "goal.obj";
    const Positions& wanted = goal ? session_->goal : frame(std::stoul(entry.path().stem().string()));
    EXPECT_LT((mesh.positions - wanted).cwiseAbs().maxCoeff(), 1e-8) << entry.path();
    ++found;
  }
  // Every 30th, the release, the last one, the goal.
  const std::size_t last = session_->frames.size() - 1;
  const auto release = static_cast<std::size_t>(session_->segment_frame(session_->segments()));
  EXPECT_EQ(found, last / 30 + 1 + (release % 30 != 0) + (last % 30 != 0) + 1);
}

TEST_F(Export, CsvHoldsVerticesAndSegments) {
  const fs::path out = *folder_ / "tables";
  ASSERT_EQ(export_command("--to csv --every 60 --quiet --out '" + out.string() + "'").code, 0);
  const auto vertices = read_csv(out / "vertices.csv");
  EXPECT_EQ(vertices.at(0), (std::vector<std::string>{"frame", "time_s", "vertex", "x_m", "y_m", "z_m"}));
  std::size_t frames = 0;
  for (std::size_t i = 1; i < vertices.size(); ++i) {
    const auto& row = vertices[i];
    const std::size_t index = std::stoul(row.at(0));
    const Index vertex = std::stol(row.at(2));
    frames += vertex == 0;
    EXPECT_NEAR(std::stod(row.at(1)), static_cast<double>(index) * kFrameSeconds, 1e-4);
    for (Index axis = 0; axis < 3; ++axis) EXPECT_NEAR(std::stod(row.at(3 + axis)), frame(index)(vertex, axis), 1e-6);
  }
  EXPECT_GE(frames, 3u);
  EXPECT_EQ(vertices.size() - 1, frames * static_cast<std::size_t>(session_->vertex_count()));

  const auto segments = read_csv(out / "segments.csv");
  const auto summary = nlohmann::json::parse(session_->summary);
  ASSERT_EQ(static_cast<Index>(segments.size()), 1 + session_->segments());
  const auto column = [&](const std::string& name) {
    const auto at = std::find(segments[0].begin(), segments[0].end(), name);
    EXPECT_NE(at, segments[0].end()) << name;
    return static_cast<std::size_t>(at - segments[0].begin());
  };
  EXPECT_NEAR(std::stod(segments.back().at(column("error_mm"))), summary.at("error_mm").get<double>(), 1e-4);
  for (std::size_t r = 1; r < segments.size(); ++r) {
    EXPECT_NEAR(std::stod(segments[r].at(column("predicted_error_mm"))),
                summary.at("predicted_error_mm").at(r - 1).get<double>(), 1e-6);
    EXPECT_NEAR(std::stod(segments[r].at(column("dtheta"))), session_->rounds[r - 1].controls(0, 0), 1e-8);
    EXPECT_NEAR(std::stod(segments[r].at(column("thickness_width"))), session_->rounds[r - 1].knowledge.width(3), 1e-8);
  }
}

/// The points behind "KEY: [" or "KEY = [" in a USD text.
std::vector<Eigen::Vector3d> usd_points(const std::string& text, const std::string& key) {
  const auto at = text.find(key + "[(");
  EXPECT_NE(at, std::string::npos) << key;
  std::vector<Eigen::Vector3d> points;
  if (at == std::string::npos) return points;
  const char* place = text.c_str() + at + key.size() + 1;
  Eigen::Vector3d p;
  int read = 0;
  while (std::sscanf(place, "(%lf, %lf, %lf)%n", &p.x(), &p.y(), &p.z(), &read) == 3) {
    points.push_back(p);
    place += read;
    if (std::strncmp(place, ", ", 2) == 0) place += 2;
  }
  EXPECT_EQ(*place, ']');
  return points;
}

TEST_F(Export, UsdHoldsPointsOverTime) {
  const fs::path file = *folder_ / "session.usda";
  ASSERT_EQ(export_command("--to usd --every 48 --quiet --out '" + file.string() + "'").code, 0);
  const std::string text = read_text(file);
  EXPECT_THAT(text, testing::StartsWith("#usda 1.0\n"));
  EXPECT_THAT(text, HasSubstr("upAxis = \"Z\""));
  EXPECT_THAT(text, HasSubstr("endTimeCode = " + std::to_string(session_->frames.size() - 1) + "\n"));
  EXPECT_EQ(std::count(text.begin(), text.end(), '{'), std::count(text.begin(), text.end(), '}'));
  const auto compare = [](const std::vector<Eigen::Vector3d>& points, const Positions& wanted) {
    ASSERT_EQ(static_cast<Index>(points.size()), wanted.rows());
    for (Index v = 0; v < wanted.rows(); ++v) EXPECT_LT((points[v] - wanted.row(v).transpose()).norm(), 1e-6);
  };
  compare(usd_points(text, "48: "), frame(48));
  compare(usd_points(text, std::to_string(session_->frames.size() - 1) + ": "), session_->frames.back());
  // The cloth's default value, for programs that show no animation, and the goal.
  const auto goal = text.find("def Mesh \"goal\"");
  ASSERT_NE(goal, std::string::npos);
  compare(usd_points(text.substr(0, goal), "point3f[] points = "), frame(0));
  compare(usd_points(text.substr(goal), "point3f[] points = "), session_->goal);
}

struct Picture {
  Index width = 0, height = 0;
  std::vector<unsigned char> rgba;
  /// Pixels for which a rule holds.
  template <class Rule>
  Index count(Rule rule) const {
    Index sum = 0;
    for (std::size_t i = 0; i < rgba.size(); i += 4) sum += rule(rgba[i], rgba[i + 1], rgba[i + 2], rgba[i + 3]);
    return sum;
  }
  Index blue() const {
    return count([](int r, int g, int b, int) { return b > r + 50 && b > g + 20; });
  }
  Index orange() const {
    return count([](int r, int g, int b, int) { return r > b + 60 && r > g + 20; });
  }
};

Picture read_png(const fs::path& file) {
  Picture picture;
  png_image image{};
  image.version = PNG_IMAGE_VERSION;
  EXPECT_NE(png_image_begin_read_from_file(&image, file.c_str()), 0) << image.message;
  image.format = PNG_FORMAT_RGBA;
  picture.width = image.width;
  picture.height = image.height;
  picture.rgba.resize(PNG_IMAGE_SIZE(image));
  EXPECT_NE(png_image_finish_read(&image, nullptr, picture.rgba.data(), 0, nullptr), 0) << image.message;
  return picture;
}

TEST_F(Export, StillsShowTheCloth) {
  const fs::path out = *folder_ / "stills";
  ASSERT_EQ(
      export_command("--png 0,last --size 480x300 --no-goal --no-paths --quiet --out '" + out.string() + "'").code, 0);
  const std::size_t last = session_->frames.size() - 1;
  char name[32];
  std::snprintf(name, sizeof(name), "frame-%04zu.png", last);
  const Picture start = read_png(out / "frame-0000.png"), end = read_png(out / name);
  EXPECT_EQ(start.width, 480);
  EXPECT_EQ(start.height, 300);
  // The flat cloth shows its front. Folded in two, half of it shows its back.
  EXPECT_GT(start.blue(), 10000);
  EXPECT_LT(start.orange(), start.blue() / 50);
  EXPECT_GT(end.orange(), 3000);
  EXPECT_EQ(start.count([](int, int, int, int a) { return a < 255; }), 0);
  // The same session gives the same bytes.
  ASSERT_EQ(export_command("--png 0,last --size 480x300 --no-goal --no-paths --quiet --out '" +
                           (*folder_ / "again").string() + "'")
                .code,
            0);
  EXPECT_EQ(read_text(out / name), read_text(*folder_ / "again" / name));
}

TEST_F(Export, StillsShowWhereTheHandsWent) {
  const std::string options = "--png 40 --size 480x300 --no-goal --view side --quiet --out '";
  const fs::path with = *folder_ / "with.png", without = *folder_ / "without.png";
  ASSERT_EQ(export_command(options + with.string() + "'").code, 0);
  ASSERT_EQ(export_command("--no-paths " + options + without.string() + "'").code, 0);
  const auto red = [](const fs::path& file) {
    return read_png(file).count([](int r, int g, int b, int) { return r > 150 && g < 90 && b < 40; });
  };
  EXPECT_EQ(red(without), 0);
  EXPECT_GT(red(with), 100);
}

TEST_F(Export, StillsColourByDistanceAndLeaveOutTheBackground) {
  const fs::path file = *folder_ / "distance.png";
  const Outcome outcome = export_command(
      "--png 0 --size 300x200 --colour distance --range 400 --no-goal --no-paths --transparent --view top --out '" +
      file.string() + "'");
  ASSERT_EQ(outcome.code, 0) << outcome.output;
  EXPECT_THAT(outcome.output, HasSubstr("0 to 400 mm"));
  const Picture picture = read_png(file);
  EXPECT_GT(picture.count([](int, int, int, int a) { return a == 0; }), 10000);
  // The vertex that moves farthest has the last colour of viridis; resting ones are dark violet.
  EXPECT_GT(picture.count([](int r, int g, int b, int a) { return a == 255 && r > 120 && g > 180 && b < 120; }), 300);
  EXPECT_GT(picture.count([](int r, int g, int b, int a) { return a == 255 && g < 60 && b > r; }), 300);
}

struct Film {
  std::vector<Picture> frames;
  std::vector<int> ends_ms;  ///< when each frame gives way to the next one
  unsigned loops = 1;
};

/// As libwebp's own decoder shows it.
Film read_webp(const fs::path& file) {
  const std::string bytes = read_text(file);
  const WebPData data{reinterpret_cast<const std::uint8_t*>(bytes.data()), bytes.size()};
  Film film;
  const std::unique_ptr<WebPAnimDecoder, void (*)(WebPAnimDecoder*)> decoder(WebPAnimDecoderNew(&data, nullptr),
                                                                             WebPAnimDecoderDelete);
  WebPAnimInfo info{};
  if (decoder == nullptr || WebPAnimDecoderGetInfo(decoder.get(), &info) == 0) {
    ADD_FAILURE() << file << " is no animation";
    return film;
  }
  film.loops = info.loop_count;
  while (WebPAnimDecoderHasMoreFrames(decoder.get()) != 0) {
    std::uint8_t* pixels = nullptr;
    int end_ms = 0;
    if (WebPAnimDecoderGetNext(decoder.get(), &pixels, &end_ms) == 0) {
      ADD_FAILURE() << file << ": a frame cannot be decoded";
      break;
    }
    Picture& frame = film.frames.emplace_back();
    frame.width = info.canvas_width;
    frame.height = info.canvas_height;
    frame.rgba.assign(pixels, pixels + 4 * frame.width * frame.height);
    film.ends_ms.push_back(end_ms);
  }
  return film;
}

/// Largest difference of a colour where both pictures are opaque.
int largest_difference(const Picture& one, const Picture& other) {
  EXPECT_EQ(one.rgba.size(), other.rgba.size());
  int largest = 0;
  for (std::size_t i = 0; i < std::min(one.rgba.size(), other.rgba.size()); ++i)
    largest = std::max(largest, std::abs(one.rgba[i] - other.rgba[i]));
  return largest;
}

TEST_F(Export, AnAnimationHoldsTheStillsOfItsFrames) {
  const fs::path out = *folder_ / "film";
  const std::string look = " --every 24 --size 320x200 --quiet --out '" + out.string() + "'";
  ASSERT_EQ(export_command("--to webp --png all --fps 8 --pause 1.5" + look).code, 0);
  const Film film = read_webp(out / "session.webp");
  std::vector<fs::path> stills;
  for (const auto& entry : fs::directory_iterator(out))
    if (entry.path().extension() == ".png") stills.push_back(entry.path());
  std::sort(stills.begin(), stills.end());
  ASSERT_EQ(film.frames.size(), stills.size());
  ASSERT_GT(stills.size(), 5u);
  EXPECT_EQ(film.loops, 0u);  // without end
  for (std::size_t k = 0; k < stills.size(); ++k) {
    EXPECT_EQ(film.frames[k].width, 320);
    EXPECT_EQ(film.frames[k].height, 200);
    EXPECT_EQ(largest_difference(film.frames[k], read_png(stills[k])), 0) << stills[k];
    const bool last = k + 1 == stills.size();
    EXPECT_EQ(film.ends_ms[k], last ? 125 * static_cast<int>(k) + 1500 : 125 * static_cast<int>(k + 1));
  }
  // The same session gives the same bytes.
  ASSERT_EQ(export_command("--to webp --every 24 --size 320x200 --fps 8 --pause 1.5 --quiet --out '" +
                           (*folder_ / "again.webp").string() + "'")
                .code,
            0);
  EXPECT_EQ(read_text(out / "session.webp"), read_text(*folder_ / "again.webp"));
}

TEST_F(Export, AnAnimationTakesAsLongAsTheFoldUnlessToldOtherwise) {
  const fs::path file = *folder_ / "small.webp", exact = *folder_ / "exact.webp";
  const std::string look = "--to webp --every 20 --size 160x100 --no-goal --quiet --out '";
  ASSERT_EQ(export_command(look + exact.string() + "'").code, 0);
  ASSERT_EQ(export_command(look + file.string() + "' --quality 60").code, 0);
  const Film whole = read_webp(exact), small = read_webp(file);
  ASSERT_GT(whole.frames.size(), 5u);
  for (std::size_t k = 0; k + 1 < whole.frames.size(); ++k)
    EXPECT_EQ(whole.ends_ms[k], std::lround(static_cast<double>(k + 1) * 1000.0 / 3.0));
  EXPECT_EQ(whole.ends_ms.back() - whole.ends_ms[whole.ends_ms.size() - 2], 2000);
  EXPECT_EQ(small.ends_ms, whole.ends_ms);
  // Lossy: smaller, not the same, and still the same picture.
  EXPECT_LT(fs::file_size(file), fs::file_size(exact));
  EXPECT_GT(largest_difference(small.frames.back(), whole.frames.back()), 0);
  EXPECT_NEAR(static_cast<double>(small.frames.back().orange()), static_cast<double>(whole.frames.back().orange()),
              0.1 * static_cast<double>(whole.frames.back().orange()));
}

TEST_F(Export, AnAnimationCanHaveNoBackground) {
  const fs::path file = *folder_ / "clear.webp";
  ASSERT_EQ(export_command("--to webp --every 60 --size 160x100 --transparent --colour distance --range 400 --no-goal "
                           "--no-paths --view top --quiet --out '" +
                           file.string() + "'")
                .code,
            0);
  for (const Picture& frame : read_webp(file).frames) {
    EXPECT_GT(frame.count([](int, int, int, int a) { return a == 0; }), 2000);
    EXPECT_GT(frame.count([](int r, int g, int b, int a) { return a == 255 && g < 60 && b > r; }), 50);
  }
}

TEST_F(Export, AnAnimationThatIsStoppedLeavesNothing) {
  const fs::path out = *folder_ / "stopped";  // made once signals are caught
  const Outcome outcome = test::run_shell("unset WEFT_PLUGIN_PATH; '" WEFT_PROGRAM "' export '" +
                                          run_folder().string() + "' --to webp --every 1 --size 1200x750 --out '" +
                                          (out / "film.webp").string() + "' & weft=$!\nuntil test -d '" + out.string() +
                                          "' || ! kill -0 $weft; do sleep 0.02; done; kill -TERM $weft; wait $weft");
  EXPECT_EQ(outcome.code, 1) << outcome.output;
  EXPECT_THAT(outcome.output, HasSubstr("film.webp was not written"));
  EXPECT_TRUE(fs::is_empty(out));
}

TEST_F(Export, WrongUseAndDamagedFilesAreRefused) {
  const auto refused = [](const Outcome& outcome, const std::string& why) {
    EXPECT_EQ(outcome.code, 2) << outcome.output;
    EXPECT_THAT(outcome.output, HasSubstr(why));
  };
  refused(export_command(""), "nothing to do; give --to, --png or both");
  refused(export_command("--to step"), "step");
  refused(export_command("--png 100000"), "must be last, all, or a frame in [0, ");
  refused(export_command("--png 0 --size 5"), "must be WIDTHxHEIGHT");
  refused(export_command("--to webp --fps 0"), "--fps: 0, must be in [0.1, 60]");
  refused(export_command("--to webp --fps nan"), "--fps: nan, must be in [0.1, 60]");
  refused(export_command("--to webp --pause 61"), "--pause: 61, must be in [0, 60]");
  refused(export_command("--to webp --quality 101"), "--quality: 101, must be in [0, 100]");
  refused(export_command("--to csv --fps 10"), "--fps, --pause and --quality are of animations");
  EXPECT_FALSE(fs::exists(run_folder() / "session.webp"));
  const fs::path damaged = folder_->write("damaged.h5", read_text(run_folder() / "session.h5").substr(0, 3000));
  refused(weft_command("export '" + damaged.string() + "' --to obj"), "damaged.h5");
  auto other = Hdf5File::create(*folder_ / "other.h5");
  other.write("/schema", std::string("something else"));
  other.commit();
  refused(weft_command("export '" + (*folder_ / "other.h5").string() + "' --to obj"), "this is not a recorded session");
}

}  // namespace
}  // namespace weft
