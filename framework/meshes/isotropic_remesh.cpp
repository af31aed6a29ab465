#include "meshes/isotropic_remesh.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>
#include <set>

#include "meshes/nearest_surface.hpp"

namespace weft {
namespace {

constexpr int kRounds = 10;
constexpr double kTooLong = 4.0 / 3.0, kTooShort = 4.0 / 5.0;
constexpr double kCornerTurn = 30.0 * std::numbers::pi / 180.0;
constexpr double kLineDeviation = 0.05;  // of the target length: how far a collapse may cut off a line's curve
constexpr double kLeastTurned = 0.3;     // cosine of the angle by which a step may turn a face's normal
constexpr double kSharpest = 0.2;        // cosine between the faces of an edge that may be flipped

using Line = std::pair<int, int>;
Line line_of(int a, int b) { return {std::min(a, b), std::max(a, b)}; }

/// How a vertex may move: in the surface, along a line, or not; a corner may still vanish where it is too small to see
/// at the target length.
enum class Freedom : unsigned char { surface, line, corner, none };

/// The surface while it changes: faces by vertex, dead ones kept until the end.
class Remesher {
 public:
  Remesher(const Surface& input, const std::function<double(const Vec3&)>& target)
      : target_(target), input_(input.positions, input.faces), p_(input.positions), f_(input.faces) {
    star_.resize(p_.size());
    for (std::size_t f = 0; f < f_.size(); ++f) {
      for (const int v : f_[f]) star_[static_cast<std::size_t>(v)].push_back(static_cast<int>(f));
    }
    std::map<Line, int> uses;
    for (const auto& t : f_) {
      for (std::size_t k = 0; k < 3; ++k) ++uses[line_of(t[k], t[(k + 1) % 3])];
    }
    for (const auto& [edge, count] : uses) {
      if (count == 1) lines_.insert(edge);
    }
    for (const auto& line : input.lines) lines_.insert(line_of(line[0], line[1]));
    find_corners(input.fixed);
    for (const Line& line : lines_) curves_.emplace_back(p_[at(line.first)], p_[at(line.second)]);
  }

  RemeshedSurface run() {
    const std::size_t before = p_.size();
    for (int round = 0; round < kRounds; ++round) {
      split_long_edges();
      collapse_short_edges();
      flip_edges();
      relax();
    }
    return result(before);
  }

 private:
  static std::size_t at(int i) { return static_cast<std::size_t>(i); }
  Freedom& freedom(int v) { return freedom_[at(v)]; }
  bool is_line(int a, int b) const { return lines_.count(line_of(a, b)) > 0; }
  double target(int a, int b) const { return target_((p_[at(a)] + p_[at(b)]) / 2.0); }
  double length(int a, int b) const { return (p_[at(a)] - p_[at(b)]).norm(); }
  Vec3 normal(const std::array<int, 3>& t) const {
    return (p_[at(t[1])] - p_[at(t[0])]).cross(p_[at(t[2])] - p_[at(t[0])]);
  }
  Vec3 vertex_normal(int v) const {
    Vec3 sum = Vec3::Zero();
    for (const int f : star_[at(v)]) sum += normal(f_[at(f)]);
    return sum.norm() > 0.0 ? Vec3(sum.normalized()) : Vec3(0.0, 0.0, 1.0);
  }

  void find_corners(const std::vector<int>& fixed) {
    std::vector<std::vector<int>> along(p_.size());
    for (const auto& [a, b] : lines_) {
      along[at(a)].push_back(b);
      along[at(b)].push_back(a);
    }
    freedom_.assign(p_.size(), Freedom::surface);
    for (std::size_t v = 0; v < p_.size(); ++v) {
      if (along[v].empty()) continue;
      freedom_[v] = Freedom::none;
      if (along[v].size() != 2) continue;
      const Vec3 in = p_[v] - p_[at(along[v][0])], out = p_[at(along[v][1])] - p_[v];
      const bool turns = std::atan2(in.cross(out).norm(), in.dot(out)) > kCornerTurn;
      freedom_[v] = turns ? Freedom::corner : Freedom::line;
    }
    for (const int v : fixed) freedom(v) = Freedom::none;
  }

  std::vector<int> neighbours(int v) const {
    std::vector<int> result;
    for (const int f : star_[at(v)]) {
      for (const int w : f_[at(f)]) {
        if (w != v) result.push_back(w);
      }
    }
    std::sort(result.begin(), result.end());
    result.erase(std::unique(result.begin(), result.end()), result.end());
    return result;
  }
  std::vector<int> faces_at(int a, int b) const {
    std::vector<int> result;
    for (const int f : star_[at(a)]) {
      const auto& t = f_[at(f)];
      if (t[0] == b || t[1] == b || t[2] == b) result.push_back(f);
    }
    return result;
  }
  std::vector<Line> edges() const {
    std::vector<Line> result;
    for (std::size_t v = 0; v < p_.size(); ++v) {
      for (const int w : neighbours(static_cast<int>(v))) {
        if (w > static_cast<int>(v)) result.emplace_back(static_cast<int>(v), w);
      }
    }
    return result;
  }
  bool is_edge(int a, int b) const { return !faces_at(a, b).empty(); }

  /// The nearest point of the lines as they were.
  Vec3 on_curves(const Vec3& p) const {
    Vec3 best = p;
    double distance = std::numeric_limits<double>::infinity();
    for (const auto& [a, b] : curves_) {
      const Vec3 d = b - a;
      const double t = std::clamp((p - a).dot(d) / std::max(d.squaredNorm(), 1e-300), 0.0, 1.0);
      const Vec3 q = a + t * d;
      if ((p - q).squaredNorm() < distance) {
        distance = (p - q).squaredNorm();
        best = q;
      }
    }
    return best;
  }

  void split_long_edges() {
    for (int pass = 0; pass < 12; ++pass) {
      bool any = false;
      for (const auto& [a, b] : edges()) {
        if (length(a, b) <= kTooLong * target(a, b)) continue;
        split(a, b);
        any = true;
      }
      if (!any) return;
    }
  }

  void split(int a, int b) {
    const bool line = is_line(a, b);
    const int m = static_cast<int>(p_.size());
    const Vec3 middle = (p_[at(a)] + p_[at(b)]) / 2.0;
    Vec3 n = Vec3::Zero();
    for (const int f : faces_at(a, b)) n += normal(f_[at(f)]);
    p_.push_back(line ? on_curves(middle) : input_.nearest(middle, n).point);
    freedom_.push_back(line ? Freedom::line : Freedom::surface);
    star_.emplace_back();
    for (const int f : faces_at(a, b)) {
      auto second = f_[at(f)];
      for (int& v : f_[at(f)]) v = v == b ? m : v;  // keeps a
      for (int& v : second) v = v == a ? m : v;     // keeps b
      const int g = static_cast<int>(f_.size());
      f_.push_back(second);
      auto& of_b = star_[at(b)];
      std::replace(of_b.begin(), of_b.end(), f, g);
      for (const int v : second) {
        if (v != b && v != m) star_[at(v)].push_back(g);
      }
      star_[at(m)].push_back(f);
      star_[at(m)].push_back(g);
    }
    if (line) {
      lines_.erase(line_of(a, b));
      lines_.insert(line_of(a, m));
      lines_.insert(line_of(m, b));
    }
  }

  void collapse_short_edges() {
    for (const auto& [a, b] : edges()) {
      if (star_[at(a)].empty() || star_[at(b)].empty() || !is_edge(a, b)) continue;
      if (length(a, b) >= kTooShort * target(a, b)) continue;
      // The freer of the two goes.
      if (freedom(a) < freedom(b) || (freedom(a) == freedom(b) && star_[at(a)].size() <= star_[at(b)].size())) {
        if (!collapse(a, b)) collapse(b, a);
      } else if (!collapse(b, a)) {
        collapse(a, b);
      }
    }
  }

  /// Removes vertex `gone` into `stays`. @return whether it may.
  bool collapse(int gone, int stays) {
    if (freedom(gone) > freedom(stays) || freedom(gone) == Freedom::none) return false;
    const bool along_line = is_line(gone, stays);
    if (freedom(gone) != Freedom::surface && !along_line) return false;
    const std::vector<int> shared = faces_at(gone, stays);
    const std::vector<int> around = neighbours(gone), others = neighbours(stays);
    std::vector<int> common;
    std::set_intersection(around.begin(), around.end(), others.begin(), others.end(), std::back_inserter(common));
    if (common.size() != shared.size()) return false;  // the link condition: the surface stays a manifold
    const bool both_free = freedom(stays) == Freedom::surface;
    const Vec3 to = both_free ? Vec3((p_[at(gone)] + p_[at(stays)]) / 2.0) : p_[at(stays)];
    int line_end = -1;
    if (along_line) {
      for (const int w : around) {
        if (w != stays && is_line(gone, w)) line_end = w;
      }
      if (line_end < 0 || is_line(stays, line_end)) return false;
      const Vec3 d = p_[at(line_end)] - to, off = p_[at(gone)] - to;
      if (off.cross(d).norm() > kLineDeviation * target(gone, stays) * d.norm()) return false;
    }
    const auto new_length_fits = [&](int v, int w) {
      return w == gone || w == stays || (to - p_[at(w)]).norm() <= kTooLong * target(v, w);
    };
    for (const int w : around) {
      if (!new_length_fits(gone, w)) return false;
    }
    for (const int w : others) {
      if (both_free && !new_length_fits(stays, w)) return false;
    }
    if (turns_over(gone, to, shared) || (both_free && turns_over(stays, to, shared))) return false;

    p_[at(stays)] = to;
    for (const int f : shared) {
      for (const int v : f_[at(f)]) {
        if (v == gone) continue;
        auto& star = star_[at(v)];
        star.erase(std::remove(star.begin(), star.end(), f), star.end());
      }
    }
    for (const int f : star_[at(gone)]) {
      if (std::find(shared.begin(), shared.end(), f) != shared.end()) {
        f_[at(f)] = {-1, -1, -1};
        continue;
      }
      for (int& v : f_[at(f)]) v = v == gone ? stays : v;
      star_[at(stays)].push_back(f);
    }
    star_[at(gone)].clear();
    if (along_line) {
      lines_.erase(line_of(gone, stays));
      lines_.erase(line_of(gone, line_end));
      lines_.insert(line_of(stays, line_end));
    }
    return true;
  }

  /// Whether moving v turns a face over, or makes it a sliver that it was not.
  bool turns_over(int v, const Vec3& to, const std::vector<int>& without = {}) {
    const Vec3 old = p_[at(v)];
    for (const int f : star_[at(v)]) {
      if (std::find(without.begin(), without.end(), f) != without.end()) continue;
      const Vec3 before = normal(f_[at(f)]);
      p_[at(v)] = to;
      const Vec3 after = normal(f_[at(f)]);
      const double narrow = height_ratio(f_[at(f)]);
      p_[at(v)] = old;
      if (before.dot(after) <= kLeastTurned * before.norm() * after.norm()) return true;
      if (narrow < 0.1 && narrow < height_ratio(f_[at(f)])) return true;
    }
    return false;
  }
  /// Smallest height over longest side.
  double height_ratio(const std::array<int, 3>& t) const {
    const double longest = std::max({length(t[0], t[1]), length(t[1], t[2]), length(t[2], t[0])});
    return longest > 0.0 ? normal(t).norm() / (longest * longest) : 0.0;
  }

  void flip_edges() {
    for (const auto& [a, b] : edges()) {
      if (is_line(a, b)) continue;
      const auto faces = faces_at(a, b);
      if (faces.size() != 2) continue;
      const auto opposite = [&, one = a, other = b](int f) {
        for (const int v : f_[at(f)]) {
          if (v != one && v != other) return v;
        }
        return -1;
      };
      const int c = opposite(faces[0]), d = opposite(faces[1]);
      if (c == d || is_edge(c, d)) continue;
      if (length(c, d) > std::max(kTooLong * target(c, d), length(a, b))) continue;
      const auto excess = [this](int v, int change) {
        const int wanted = freedom_[at(v)] == Freedom::surface || !open(v) ? 6 : 4;
        const int valence = static_cast<int>(neighbours(v).size()) + change;
        return (valence - wanted) * (valence - wanted);
      };
      const int before = excess(a, 0) + excess(b, 0) + excess(c, 0) + excess(d, 0);
      const int after = excess(a, -1) + excess(b, -1) + excess(c, 1) + excess(d, 1);
      if (after >= before) continue;
      const Vec3 n0 = normal(f_[at(faces[0])]), n1 = normal(f_[at(faces[1])]);
      if (n0.dot(n1) < kSharpest * n0.norm() * n1.norm()) continue;
      // The face with a -> b becomes c, d over a; the other one over b.
      auto first = f_[at(faces[0])], second = f_[at(faces[1])];
      for (int& v : first) v = v == b ? d : v;
      for (int& v : second) v = v == a ? c : v;
      const Vec3 mean = n0 + n1, m0 = normal(first), m1 = normal(second);
      if (m0.dot(mean) <= kLeastTurned * m0.norm() * mean.norm() ||
          m1.dot(mean) <= kLeastTurned * m1.norm() * mean.norm()) {
        continue;
      }
      if (std::min(height_ratio(first), height_ratio(second)) <
          std::min(0.1, std::min(height_ratio(f_[at(faces[0])]), height_ratio(f_[at(faces[1])])))) {
        continue;
      }
      f_[at(faces[0])] = first;
      f_[at(faces[1])] = second;
      const auto leave = [this](int v, int f) {
        auto& star = star_[at(v)];
        star.erase(std::remove(star.begin(), star.end(), f), star.end());
      };
      leave(b, faces[0]);
      leave(a, faces[1]);
      star_[at(d)].push_back(faces[0]);
      star_[at(c)].push_back(faces[1]);
    }
  }

  bool open(int v) const { return neighbours(v).size() != star_[at(v)].size(); }

  void relax() {
    for (int v = 0; v < static_cast<int>(p_.size()); ++v) {
      if (star_[at(v)].empty() || freedom(v) >= Freedom::corner) continue;
      const auto around = neighbours(v);
      const Vec3 old = p_[at(v)];
      Vec3 to = Vec3::Zero();
      if (freedom(v) == Freedom::line) {
        int count = 0;
        for (const int w : around) {
          if (!is_line(v, w)) continue;
          to += p_[at(w)];
          ++count;
        }
        if (count != 2) continue;
        to = on_curves((old + to / 2.0) / 2.0);
      } else {
        // Weights of 1 / target: where the target falls, the centre would otherwise lie too far from the fine side.
        double sum = 0.0;
        for (const int w : around) {
          const double weight = 1.0 / target_(p_[at(w)]);
          to += weight * p_[at(w)];
          sum += weight;
        }
        to /= sum;
        const Vec3 n = vertex_normal(v);
        to += n * n.dot(old - to);
        to = input_.nearest(to, n).point;
      }
      if (!turns_over(v, to)) p_[at(v)] = to;
    }
  }

  RemeshedSurface result(std::size_t before) const {
    RemeshedSurface out;
    std::vector<int> to(p_.size(), -1);
    for (std::size_t v = 0; v < p_.size(); ++v) {
      if (star_[v].empty()) continue;
      to[v] = static_cast<int>(out.positions.size());
      out.positions.push_back(p_[v]);
    }
    for (const auto& t : f_) {
      if (t[0] >= 0) out.faces.push_back({to[at(t[0])], to[at(t[1])], to[at(t[2])]});
    }
    for (const auto& [a, b] : lines_) out.lines.push_back({to[at(a)], to[at(b)]});
    for (std::size_t v = 0; v < before; ++v) out.kept.push_back(freedom_[v] >= Freedom::corner ? to[v] : -1);
    return out;
  }

  const std::function<double(const Vec3&)>& target_;
  NearestSurface input_;
  std::vector<Vec3> p_;
  std::vector<std::array<int, 3>> f_;
  std::vector<std::vector<int>> star_;
  std::vector<Freedom> freedom_;
  std::set<Line> lines_;
  std::vector<std::pair<Vec3, Vec3>> curves_;
};

}  // namespace

RemeshedSurface remesh_isotropic(const Surface& surface, const std::function<double(const Vec3&)>& edge_length) {
  return Remesher(surface, edge_length).run();
}

}  // namespace weft
