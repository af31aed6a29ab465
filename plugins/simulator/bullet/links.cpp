#include "links.hpp"

#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <numbers>
#include <numeric>
#include <utility>

#include "weft/rest_shape.hpp"

namespace weft::bullet {
namespace {

// A quartic form of the direction is known from its values along six directions of the half circle.
constexpr int kDirections = 6;
using Form = std::array<double, kDirections>;

Vec2 direction(int j) {
  const double angle = std::numbers::pi * j / kDirections;
  return {std::cos(angle), std::sin(angle)};
}

/// An edge or hinge, whose energy is its coefficient times a form of the direction of the strain (or curvature).
struct Element {
  Form form{};         ///< energy per coefficient, times two
  double guess = 0.0;  ///< first guess of the coefficient
  std::array<int, 2> face{-1, -1};
};

/// The energy of an element lies in its faces, and so around their vertices.
struct Part {
  int vertex;
  double share;  ///< of the element's faces that lie around the vertex
};

struct Patches {
  std::vector<double> area;              ///< m^2, of the faces around each vertex
  std::vector<std::vector<Part>> parts;  ///< of each element

  Patches(const std::vector<Element>& elements, const Faces& faces, const std::vector<double>& areas, Index vertices)
      : area(vertices, 0.0), parts(elements.size()) {
    for (Index f = 0; f < faces.rows(); ++f)
      for (int k = 0; k < 3; ++k) area[faces(f, k)] += areas[f];
    for (std::size_t e = 0; e < elements.size(); ++e) {
      const int count = elements[e].face[1] < 0 ? 1 : 2;
      for (int side = 0; side < count; ++side)
        for (int k = 0; k < 3; ++k) {
          const int v = faces(elements[e].face[side], k);
          auto at = std::find_if(parts[e].begin(), parts[e].end(), [&](const Part& part) { return part.vertex == v; });
          if (at == parts[e].end()) at = parts[e].insert(at, Part{v, 0.0});
          at->share += 1.0 / count;
        }
    }
  }
};

/// Young's modulus times thickness along (c, s), from a compliance: 1 / (p p : S : p p).
double modulus(const Eigen::Matrix3d& compliance, const Vec2& p) {
  const Eigen::Vector3d load(p.x() * p.x(), p.y() * p.y(), p.x() * p.y());
  return 1.0 / load.dot(compliance * load);
}

/// Scales edges by a function of their direction alone, until the mean network has the target modulus along every edge.
/// The sides are free to contract and to shear. Iterates k <- k (target / current)^1/2. It is needed where a mesh has
/// few directions (a grid has three): there the closest form C(p) does not give the closest modulus.
void match_moduli(std::vector<double>& k, const std::vector<Vec2>& directions, const std::vector<double>& lengths,
                  const Eigen::Matrix3d& wanted, double area) {
  constexpr int sweeps = 40;
  for (int sweep = 0; sweep < sweeps; ++sweep) {
    Eigen::Matrix3d stiffness = Eigen::Matrix3d::Zero();
    for (std::size_t e = 0; e < k.size(); ++e) {
      const Vec2& n = directions[e];
      const Eigen::Vector3d strain(n.x() * n.x(), n.y() * n.y(), n.x() * n.y());
      stiffness += (k[e] * lengths[e] * lengths[e] / area) * strain * strain.transpose();
    }
    const Eigen::Matrix3d compliance = stiffness.inverse();
    for (std::size_t e = 0; e < k.size(); ++e)
      k[e] *= std::sqrt(modulus(wanted, directions[e]) / modulus(compliance, directions[e]));
  }
}

/// Coefficients c >= 0 whose energy per area around every vertex is closest to `target`, relative, in all directions:
///     min  sum_v sum_j A_v/A (sum_e c_e form_e[j] share_ev / (A_v target[j]) - 1)^2
///          + tie sum_e A_e/A (c_e/guess_e - 1)^2
/// by coordinate descent. @param misfit root mean square.
std::vector<double> fit_form(const std::vector<Element>& elements, const Form& target, const Patches& patches,
                             const std::vector<double>& areas, double& misfit) {
  constexpr double tie = 1.0;  // a smaller one fits better but less evenly; uneven networks are softer than their mean
  constexpr int sweeps = 60;
  const auto& parts = patches.parts;
  const auto& patch = patches.area;
  const Index vertices = patch.size();
  const std::size_t n = elements.size();
  double whole = 0.0;
  for (const double a : areas) whole += a;
  std::vector<double> area(n, 0.0);
  for (std::size_t e = 0; e < n; ++e)
    for (const int f : elements[e].face)
      if (f >= 0) area[e] += areas[f] / 3.0;

  // Relative energy per area of an element at its guess, then one scale for all guesses, then each on its own.
  const auto relative = [&](std::size_t e, const Part& part, int j) {
    return elements[e].guess * elements[e].form[j] * part.share / (patch[part.vertex] * target[j]);
  };
  std::vector<Form> residual(vertices, Form{});
  double top = 0.0, bottom = 0.0;
  for (std::size_t e = 0; e < n; ++e)
    for (const Part& part : parts[e])
      for (int j = 0; j < kDirections; ++j) residual[part.vertex][j] += relative(e, part, j);
  for (Index v = 0; v < vertices; ++v)
    for (const double r : residual[v]) {
      top += patch[v] * r;
      bottom += patch[v] * r * r;
    }
  const double scale = bottom > 0.0 ? top / bottom : 0.0;
  for (auto& form : residual)
    for (double& r : form) r = scale * r - 1.0;
  std::vector<double> factor(n, scale);
  for (int sweep = 0; sweep < sweeps; ++sweep)
    for (std::size_t e = 0; e < n; ++e) {
      double slope = tie * area[e] * (factor[e] / scale - 1.0) / scale, curve = tie * area[e] / (scale * scale);
      for (const Part& part : parts[e])
        for (int j = 0; j < kDirections; ++j) {
          const double a = relative(e, part, j), weight = patch[part.vertex] / (3.0 * kDirections);
          slope += weight * a * residual[part.vertex][j];
          curve += weight * a * a;
        }
      const double next = std::max(0.0, factor[e] - slope / curve), change = next - factor[e];
      factor[e] = next;
      for (const Part& part : parts[e])
        for (int j = 0; j < kDirections; ++j) residual[part.vertex][j] += change * relative(e, part, j);
    }
  double sum = 0.0;
  for (Index v = 0; v < vertices; ++v)
    for (const double r : residual[v]) sum += patch[v] * r * r / (3.0 * kDirections * whole);
  misfit = std::sqrt(sum);
  std::vector<double> coefficients(n);
  for (std::size_t e = 0; e < n; ++e) coefficients[e] = factor[e] * elements[e].guess;
  return coefficients;
}

struct Hinge {
  std::array<int, 4> node{};       ///< the edge's ends, then the two opposite corners
  std::array<Vec2, 4> place{};     ///< m, unfolded into the frame of the first face
  std::array<double, 4> weight{};  ///< m, 1/m
};

/// An edge: the faces beside it, and its corner opposite to it in each; the second face is -1 at the border.
struct Beside {
  std::array<int, 2> face{-1, -1};
  std::array<int, 2> corner{};
};

/// Faces, and the faces beside every edge.
struct Mesh {
  const Faces& faces;
  RestShape shape;
  std::vector<double> areas;                     ///< [f] m^2
  std::map<std::pair<int, int>, Beside> beside;  ///< of an edge

  explicit Mesh(const Garment& garment) : faces(garment.faces), shape(garment), areas(garment.face_count()) {
    for (Index f = 0; f < faces.rows(); ++f) {
      const Vec2 u = shape.corner(f, 1) - shape.corner(f, 0), v = shape.corner(f, 2) - shape.corner(f, 0);
      areas[f] = 0.5 * std::abs(u.x() * v.y() - u.y() * v.x());
      for (int k = 0; k < 3; ++k) {
        const auto key = std::minmax(faces(f, k), faces(f, (k + 1) % 3));
        const auto [place, fresh] = beside.try_emplace(key);
        place->second.face[fresh ? 0 : 1] = static_cast<int>(f);
        place->second.corner[fresh ? 0 : 1] = (k + 2) % 3;
      }
    }
  }
  /// A vertex of a face, in the face's rest frame.
  Vec2 at(int face, int vertex) const {
    int k = 0;
    while (faces(face, k) != vertex) ++k;
    return shape.corner(face, k);
  }
};

struct Moduli {
  double warp, weft, shear;                ///< N/m
  double bend_warp, bend_weft, bend_bias;  ///< N m
};

/// Moduli from tables: C = 2 c and B = ke / 4 at zero strain and curvature (docs/file-formats.md). A row of the bending
/// table names the axis, so row 0 is bending along weft.
Moduli moduli_of(const Fabric& fabric) {
  if (!fabric.tables)
    return {fabric.stretch_warp_n_per_m, fabric.stretch_weft_n_per_m, fabric.stretch_shear_n_per_m,
            fabric.bend_warp_n_m,        fabric.bend_weft_n_m,        fabric.bend_bias_n_m};
  const auto& c = fabric.tables->stretching[0];
  const double m = fabric.stretch_multiplier;
  const double c11 = 2 * m * std::max(c[0], 0.0), c12 = 2 * m * std::max(c[1], 0.0), c22 = 2 * m * std::max(c[2], 0.0);
  const auto& ke = fabric.tables->bending;
  return {c11 - (c22 > 0.0 ? c12 * c12 / c22 : 0.0),
          c22 - (c11 > 0.0 ? c12 * c12 / c11 : 0.0),
          m * std::max(c[3], 0.0),
          fabric.bend_multiplier * ke[2][0] / 4,
          fabric.bend_multiplier * ke[0][0] / 4,
          fabric.bend_multiplier * ke[1][0] / 4};
}

/// Targets of the network's quartic forms.
struct Target {
  Moduli moduli;                 ///< shear as far as links can have it
  double c11, c22;               ///< N/m: C11 = K_warp + G^2 / C22 and C22 = K_weft + G^2 / C11 with C12 = C33 = G
  double poisson;                ///< nu12
  Form stretch_form, bend_form;  ///< along the directions

  explicit Target(const Moduli& wanted) : moduli(wanted) {
    const double mean = std::sqrt(moduli.warp * moduli.weft);
    const double shear = moduli.shear =
        std::min(moduli.shear, kLargestCoupling / (1.0 - kLargestCoupling * kLargestCoupling) * mean);
    const double root = 0.5 * (mean + std::sqrt(mean * mean + 4.0 * shear * shear));
    c11 = moduli.warp * root / mean, c22 = moduli.weft * root / mean;
    poisson = shear / c22;
    for (int j = 0; j < kDirections; ++j) {
      stretch_form[j] = stretch(direction(j));
      bend_form[j] = std::max(0.0, bend(direction(j)));
    }
  }
  double stretch(const Vec2& p) const { return quartic(p, c11, c22, 6.0 * moduli.shear); }
  double bend(const Vec2& p) const {
    return quartic(p, moduli.bend_warp, moduli.bend_weft, 4.0 * moduli.bend_bias - moduli.bend_warp - moduli.bend_weft);
  }
  Eigen::Matrix3d compliance() const {
    Eigen::Matrix3d s;
    s << 1.0 / moduli.warp, -poisson / moduli.warp, 0.0, -poisson / moduli.warp, 1.0 / moduli.weft, 0.0, 0.0, 0.0,
        1.0 / moduli.shear;
    return s;
  }

 private:
  static double quartic(const Vec2& p, double a, double b, double both) {
    const double c = p.x() * p.x(), s = p.y() * p.y();
    return a * c * c + b * s * s + both * c * s;
  }
};

/// The hinge of an edge from a along n (a unit vector), `length` long, between two faces, in the frame of the first.
Hinge make_hinge(const Mesh& mesh, int a, int b, const Beside& beside, const Vec2& n, double length) {
  Hinge hinge;
  const int first = beside.face[0];
  hinge.node = {a, b, mesh.faces(first, beside.corner[0]), mesh.faces(beside.face[1], beside.corner[1])};
  hinge.place = {mesh.at(first, a), mesh.at(first, b), mesh.shape.corner(first, beside.corner[0]),
                 mesh.shape.place_across(first, beside.corner[0])};
  // Weights of the opposite corners: 1 / height. Those of the ends annul affine functions.
  for (int side = 0; side < 2; ++side) {
    const Vec2 off = hinge.place[2 + side] - hinge.place[0];
    const double height = std::abs(n.x() * off.y() - n.y() * off.x()), part = n.dot(off) / length;
    hinge.weight[2 + side] = 1.0 / height;
    hinge.weight[0] -= (1.0 - part) / height;
    hinge.weight[1] -= part / height;
  }
  return hinge;
}

/// The hinge's squared angle in a surface of unit curvature along each direction.
Form squared_angles(const Hinge& hinge) {
  // The angle of the surface z = (xx x^2 + 2 xy x y + yy y^2) / 2.
  double xx = 0.0, yy = 0.0, xy = 0.0;
  for (int k = 0; k < 4; ++k) {
    const Vec2 p = hinge.place[k] - hinge.place[0];
    xx += 0.5 * hinge.weight[k] * p.x() * p.x();
    yy += 0.5 * hinge.weight[k] * p.y() * p.y();
    xy += hinge.weight[k] * p.x() * p.y();
  }
  Form form{};
  for (int j = 0; j < kDirections; ++j) {
    const Vec2 p = direction(j);
    const double angle = xx * p.x() * p.x() + yy * p.y() * p.y() + xy * p.x() * p.y();
    form[j] = angle * angle;
  }
  return form;
}

/// Turns the hinges' bending stiffness into pre-stress of the edges and of struts. Adds the struts.
void add_pre_stress(const std::vector<Hinge>& hinges, const std::vector<double>& stiffness,
                    std::vector<Spring>& springs) {
  std::map<std::pair<int, int>, std::size_t> spring_of;
  for (std::size_t e = 0; e < springs.size(); ++e) spring_of[{springs[e].a, springs[e].b}] = e;
  for (std::size_t h = 0; h < hinges.size(); ++h)
    for (int i = 0; i < 4; ++i)
      for (int j = i + 1; j < 4; ++j) {
        const auto ends = std::minmax(hinges[h].node[i], hinges[h].node[j]);
        const auto [place, fresh] = spring_of.try_emplace(ends, springs.size());
        if (fresh) {
          const Vec2 along = hinges[h].place[i] - hinges[h].place[j];
          springs.push_back({ends.first, ends.second, along.norm(), 0, 0});
        }
        springs[place->second].pre_stress -= stiffness[h] * hinges[h].weight[i] * hinges[h].weight[j];
      }
}

/// Stiffens the edges that could not carry their pre-stress. @return their share.
double raise_stiffness(std::vector<Spring>& springs, std::size_t edges) {
  double share = 0.0;
  for (std::size_t e = 0; e < edges; ++e) {
    Spring& spring = springs[e];
    const double least = kStiffnessPerPreStress * std::abs(spring.pre_stress);
    if (spring.stiffness >= least) continue;
    share += 1.0 / static_cast<double>(edges);
    spring.stiffness = least;
  }
  return share;
}

}  // namespace

SpringNetwork spring_network(const Garment& garment, const Fabric& fabric) {
  const Mesh mesh(garment);
  const Target target(moduli_of(fabric));
  SpringNetwork network;
  network.shear_n_per_m = target.moduli.shear;
  network.poisson = target.poisson;
  network.vertex_masses.assign(garment.vertex_count(), 0.0);
  for (Index f = 0; f < mesh.faces.rows(); ++f)
    for (int k = 0; k < 3; ++k)
      network.vertex_masses[mesh.faces(f, k)] += fabric.density_kg_per_m2 * mesh.areas[f] / 3.0;

  std::vector<Element> edges, hinge_elements;
  std::vector<Hinge> hinges;
  std::vector<Vec2> directions;
  std::vector<double> lengths;
  for (const auto& [ends, beside] : mesh.beside) {
    const auto [a, b] = ends;
    const int first = beside.face[0], second = beside.face[1];
    const Vec2 along = mesh.at(first, b) - mesh.at(first, a);
    const double drawn = along.norm(),
                 length = mesh.shape.is_chart() ? drawn : mesh.shape.edge_length(first, beside.corner[0]);
    const Vec2 n = along / drawn;
    const double area = mesh.areas[first] + (second < 0 ? 0.0 : mesh.areas[second]);
    network.springs.push_back({a, b, length, 0.0, 0.0});
    // Where the frames of two faces differ, the edge has half of its stiffness along each direction.
    const Vec2 other =
        mesh.shape.is_chart() || second < 0 ? n : Vec2((mesh.at(second, b) - mesh.at(second, a)).normalized());
    Form form{};
    for (int j = 0; j < kDirections; ++j) {
      form[j] = length * length * std::pow(n.dot(direction(j)), 4);
      if (!mesh.shape.is_chart()) form[j] = 0.5 * (form[j] + length * length * std::pow(other.dot(direction(j)), 4));
    }
    double stretch = target.stretch(n);
    if (!mesh.shape.is_chart()) stretch = 0.5 * (stretch + target.stretch(other));
    edges.push_back({form, stretch * area / (length * length), beside.face});
    directions.push_back(n);
    lengths.push_back(length);
    if (!mesh.shape.bends(first, beside.corner[0])) continue;
    const Hinge hinge = make_hinge(mesh, a, b, beside, n, drawn);
    const double guess = std::max(0.0, target.bend(Vec2(-n.y(), n.x()))) * length * length / area;
    hinge_elements.push_back({squared_angles(hinge), guess, beside.face});
    hinges.push_back(hinge);
  }

  const auto fit = [&](const std::vector<Element>& elements, const Form& form, double& misfit) {
    return fit_form(elements, form, Patches(elements, mesh.faces, mesh.areas, garment.vertex_count()), mesh.areas,
                    misfit);
  };
  auto stiffness = fit(edges, target.stretch_form, network.stretch_misfit);
  match_moduli(stiffness, directions, lengths, target.compliance(),
               std::accumulate(mesh.areas.begin(), mesh.areas.end(), 0.0));
  for (std::size_t e = 0; e < stiffness.size(); ++e) network.springs[e].stiffness = stiffness[e];
  if (*std::min_element(target.bend_form.begin(), target.bend_form.end()) <= 0.0) return network;  // no bending

  add_pre_stress(hinges, fit(hinge_elements, target.bend_form, network.bend_misfit), network.springs);
  network.raised_share = raise_stiffness(network.springs, edges.size());
  return network;
}

}  // namespace weft::bullet
