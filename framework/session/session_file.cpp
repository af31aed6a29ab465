#include "session/session_file.hpp"

#include <cmath>

#include "weft/hdf5_file.hpp"

namespace weft {
namespace {

/// Reads with the file's name in every refusal.
class Reader {
 public:
  explicit Reader(const std::filesystem::path& path) : name_(path.string()), file_(Hdf5File::open(path)) {}

  [[noreturn]] void fail(const std::string& path, const std::string& message) const {
    throw ConfigError(name_ + ": " + path + " " + message);
  }
  bool has(const std::string& path) const { return file_.has(path); }
  std::vector<std::string> list(const std::string& group) const { return file_.list(group); }
  std::string text(const std::string& path) const { return file_.read_text(path); }
  std::string optional_text(const std::string& path) const { return has(path) ? text(path) : std::string(); }
  std::vector<std::int64_t> integers(const std::string& path) const { return file_.read_int(path); }

  Vector vector(const std::string& path, Index wanted = -1) const {
    const auto values = file_.read(path);
    const auto size = static_cast<Index>(values.size());
    if (wanted >= 0 && size != wanted) {
      fail(path, "has " + std::to_string(size) + " numbers, must have " + std::to_string(wanted));
    }
    return Eigen::Map<const Vector>(values.data(), size);
  }
  Controls matrix(const std::string& path, Index columns = -1) const {
    const auto dims = file_.shape(path);
    if (dims.size() != 2 || (columns >= 0 && dims[1] != columns)) {
      fail(path, "must have the shape [n, " + (columns < 0 ? std::string("m") : std::to_string(columns)) + "]");
    }
    const auto values = file_.read(path);
    return Eigen::Map<const Controls>(values.data(), dims[0], dims[1]);
  }
  Positions positions(const std::string& path, Index vertices) const {
    Positions result = file_.read_positions(path);
    if (result.rows() != vertices) {
      fail(path, "has " + std::to_string(result.rows()) + " vertices, must have " + std::to_string(vertices));
    }
    return result;
  }
  /// [n, vertices, 3].
  std::vector<Positions> shapes(const std::string& path, Index vertices) const {
    const auto dims = file_.shape(path);
    if (dims.size() != 3 || dims[2] != 3 || (dims[0] > 0 && dims[1] != vertices)) {
      fail(path, "must have the shape [n, " + std::to_string(vertices) + ", 3]");
    }
    const auto values = file_.read_float(path);
    for (const float value : values) {
      if (!std::isfinite(value)) fail(path, "holds a number that is not finite");
    }
    using SingleMatrix = Eigen::Matrix<float, Eigen::Dynamic, 3, Eigen::RowMajor>;
    std::vector<Positions> result;
    for (Index i = 0; i < dims[0]; ++i) {
      result.push_back(Eigen::Map<const SingleMatrix>(values.data() + i * vertices * 3, vertices, 3).cast<double>());
    }
    return result;
  }

 private:
  std::string name_;
  Hdf5File file_;
};

RoundRecord read_round(const Reader& in, const std::string& group, Index vertices, Index hands) {
  RoundRecord round;
  round.controls = in.matrix(group + "/controls");
  round.state = in.vector(group + "/state");
  round.knowledge.centre = in.vector(group + "/knowledge_centre", 4);
  round.knowledge.width = in.vector(group + "/knowledge_width", 4);
  round.observed = in.positions(group + "/observed", vertices);
  round.losses = in.vector(group + "/losses");
  if (in.has(group + "/loss_curves")) round.curves = in.matrix(group + "/loss_curves", round.losses.size());
  round.mean = in.shapes(group + "/predicted_mean", vertices);
  const std::string sigma = group + "/predicted_sigma";
  round.sigma = in.shapes(sigma, vertices);
  if (!round.sigma.empty() && round.sigma.size() != round.mean.size())
    in.fail(sigma, "must be as long as predicted_mean");
  if (in.has(group + "/planned_targets")) round.targets = in.shapes(group + "/planned_targets", hands);
  return round;
}

}  // namespace

SessionRecord read_session(const std::filesystem::path& path) {
  const Reader in(path);
  if (!in.has("/schema") || in.text("/schema") != "weft session 1")
    in.fail("/schema", "must be 'weft session 1': this is no recorded session");
  SessionRecord record;
  record.config = in.text("/config");
  record.provenance = in.text("/provenance");
  record.summary = in.text("/summary");
  record.trajectory = in.optional_text("/trajectory");
  record.garment_name = in.text("/garment/name");
  const Index vertices = in.matrix("/start", 3).rows();
  record.rest = in.matrix("/garment/rest", 2);
  if (record.rest.rows() != vertices) in.fail("/garment/rest", "must have one row per vertex");
  const auto checked = [&](const std::string& name, const std::vector<std::int64_t>& indices) {
    for (const auto index : indices) {
      if (index < 0 || index >= vertices)
        in.fail(name, "names vertex " + std::to_string(index) + " of " + std::to_string(vertices));
    }
    return indices;
  };
  const auto corners = checked("/garment/faces", in.integers("/garment/faces"));
  if (corners.size() % 3 != 0) in.fail("/garment/faces", "must have the shape [n, 3]");
  using WideFaces = Eigen::Matrix<std::int64_t, Eigen::Dynamic, 3, Eigen::RowMajor>;
  record.faces = Eigen::Map<const WideFaces>(corners.data(), static_cast<Index>(corners.size() / 3), 3).cast<int>();
  const auto held = checked("/garment/grasp_vertices", in.integers("/garment/grasp_vertices"));
  record.grasp_vertices.assign(held.begin(), held.end());
  record.start = in.positions("/start", vertices);
  record.goal = in.positions("/goal", vertices);
  record.default_shape = in.positions("/default_shape", vertices);
  record.final_shape = in.positions("/final_shape", vertices);
  record.true_material = in.vector("/true_material", 4);
  record.frames = in.shapes("/frames", vertices);
  if (record.frames.empty()) in.fail("/frames", "holds no frame");
  if (in.has("/rounds")) {
    for (const auto& name : in.list("/rounds")) {
      record.rounds.push_back(read_round(in, "/rounds/" + name, vertices, static_cast<Index>(held.size())));
    }
  }
  if (in.has("/estimates")) {
    const Controls centre = in.matrix("/estimates/centre", 4), width = in.matrix("/estimates/width", 4);
    if (centre.rows() != record.segments() || width.rows() != centre.rows())
      in.fail("/estimates", "must have one row per segment");
    for (Index j = 0; j < centre.rows(); ++j)
      record.estimates.push_back({centre.row(j).transpose(), width.row(j).transpose()});
  }
  if (record.settle_frames() < 0) {
    in.fail("/frames", "has " + std::to_string(record.frames.size()) + " frames for " +
                           std::to_string(record.segments()) + " segments, must have " +
                           std::to_string(record.segment_frame(record.segments()) + 1) + " or more");
  }
  return record;
}

}  // namespace weft
