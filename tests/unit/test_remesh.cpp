#include <Eigen/Geometry>
#include <cmath>
#include <map>
#include <numbers>

#include "meshes/import/import.hpp"
#include "meshes/import/pieces.hpp"
#include "meshes/import/remesh.hpp"
#include "meshes/intersections.hpp"
#include "meshes/isotropic_remesh.hpp"
#include "meshes/nearest_surface.hpp"
#include "test_support.hpp"

namespace weft {
namespace {

constexpr double kPi = std::numbers::pi;

/// n x m quads, two triangles each, at place(u, v) with u, v in [0, 1].
template <class Place>
Surface patch(int n, int m, Place&& place) {
  Surface surface;
  for (int j = 0; j <= m; ++j) {
    for (int i = 0; i <= n; ++i) surface.positions.push_back(place(double(i) / n, double(j) / m));
  }
  for (int j = 0; j < m; ++j) {
    for (int i = 0; i < n; ++i) {
      const int a = j * (n + 1) + i;
      surface.faces.push_back({a, a + 1, a + n + 2});
      surface.faces.push_back({a, a + n + 2, a + n + 1});
    }
  }
  return surface;
}
/// A dome: part of a sphere of 0.5 m, with sides of about 0.8 m.
Vec3 dome(double u, double v) {
  const double x = 0.6 * (u - 0.5), y = 0.6 * (v - 0.5);
  return Vec3(x, y, std::sqrt(0.25 - x * x - y * y));
}

struct Measured {
  int boundary_edges = 0, crowded_edges = 0, same_way = 0, euler = 0;
  double in_band = 0.0, shortest = 1e9, longest = 0.0;  // of the target
  double boundary_length = 0.0;
};
Measured measure(const std::vector<Vec3>& positions, const std::vector<std::array<int, 3>>& faces,
                 const std::function<double(const Vec3&)>& target) {
  Measured m;
  int edges = 0;
  for_each_edge(mesh_sides(faces), [&](const MeshSide* begin, const MeshSide* end) {
    const Vec3 &a = positions[static_cast<std::size_t>(begin->first)],
               &b = positions[static_cast<std::size_t>(begin->second)];
    const double length = (a - b).norm() / target((a + b) / 2.0);
    ++edges;
    m.in_band += length >= 0.8 && length <= 4.0 / 3.0;
    m.shortest = std::min(m.shortest, length);
    m.longest = std::max(m.longest, length);
    if (end - begin == 1) {
      ++m.boundary_edges;
      m.boundary_length += (a - b).norm();
    }
    m.crowded_edges += end - begin > 2;
    m.same_way += end - begin == 2 && begin[0].upwards == begin[1].upwards;
  });
  m.in_band /= edges;
  m.euler = static_cast<int>(positions.size()) - edges + static_cast<int>(faces.size());
  return m;
}

/// The laws of every result: a manifold of the same topology, near the surface, with edges in the method's band.
void expect_sound(const Surface& before, const RemeshedSurface& after, double target, double hausdorff) {
  const auto uniform = [target](const Vec3&) { return target; };
  const Measured was = measure(before.positions, before.faces, uniform),
                 is = measure(after.positions, after.faces, uniform);
  EXPECT_EQ(is.crowded_edges, 0);
  EXPECT_EQ(is.same_way, 0);
  EXPECT_EQ(is.euler, was.euler);
  EXPECT_GT(is.in_band, 0.95);
  EXPECT_GT(is.shortest, 0.4);
  EXPECT_LT(is.longest, 1.6);
  EXPECT_NEAR(is.boundary_length, was.boundary_length, 0.01 * was.boundary_length);
  EXPECT_LT(distance_from_surface(after.positions, after.faces, NearestSurface(before.positions, before.faces)),
            hausdorff);
  EXPECT_LT(distance_from_surface(before.positions, before.faces, NearestSurface(after.positions, after.faces)),
            hausdorff);
  for (const auto& t : after.faces) {
    const Vec3 a = after.positions[static_cast<std::size_t>(t[0])];
    const Vec3 u = after.positions[static_cast<std::size_t>(t[1])] - a,
               v = after.positions[static_cast<std::size_t>(t[2])] - a;
    EXPECT_GT(u.cross(v).norm(), 0.1 * target * target);
  }
}

TEST(NearestSurface, AgreesWithASearchOverAllFaces) {
  const Surface surface = patch(9, 7, dome);
  const NearestSurface tree(surface.positions, surface.faces);
  for (int i = 0; i < 200; ++i) {
    const Vec3 p(std::sin(1.3 * i), std::cos(2.1 * i), std::sin(0.7 * i + 1.0));
    double best = 1e9;
    for (std::size_t f = 0; f < surface.faces.size(); ++f) {
      best = std::min(best, NearestSurface(surface.positions, {surface.faces[f]}).nearest(p).distance);
    }
    const auto hit = tree.nearest(p);
    EXPECT_NEAR(hit.distance, best, 1e-12);
    Vec3 point = Vec3::Zero();
    for (Index k = 0; k < 3; ++k)
      point += hit.weights(k) *
               surface.positions[static_cast<std::size_t>(tree.face(hit.face)[static_cast<std::size_t>(k)])];
    EXPECT_NEAR((point - hit.point).norm(), 0.0, 1e-12);
  }
}

TEST(NearestSurface, KeepsTheLayersOfAThinGarmentApart) {
  Surface two = patch(4, 4, [](double u, double v) { return Vec3(u, v, 0.0); });
  const Surface back = patch(4, 4, [](double u, double v) { return Vec3(u, v, -0.001); });
  const int first = static_cast<int>(two.positions.size());
  two.positions.insert(two.positions.end(), back.positions.begin(), back.positions.end());
  for (const auto& t : back.faces) two.faces.push_back({t[0] + first, t[2] + first, t[1] + first});
  const NearestSurface tree(two.positions, two.faces);
  EXPECT_EQ(tree.nearest(Vec3(0.3, 0.3, 0.1), Vec3(0, 0, 1)).point.z(), 0.0);
  EXPECT_EQ(tree.nearest(Vec3(0.3, 0.3, 0.1), Vec3(0, 0, -1)).point.z(), -0.001);
}

TEST(IsotropicRemesh, RefinesAndCoarsensADome) {
  const Surface surface = patch(30, 30, dome);
  for (const double target : {0.012, 0.05}) {
    SCOPED_TRACE(target);
    // A triangle of edges of 1.6 targets lies up to (1.6 t / sqrt 3)^2 / 2 R = 0.85 t^2 from the sphere of R = 0.5 m,
    // and the patch itself up to 0.2 mm.
    expect_sound(surface, remesh_isotropic(surface, [target](const Vec3&) { return target; }), target,
                 0.85 * target * target + 2e-4);
  }
}

TEST(IsotropicRemesh, EvensEdgesThatDifferByFifty) {
  // Columns from 3.5 mm to 175 mm, as one mesh of issue reports had.
  const Surface surface =
      patch(24, 12, [](double u, double v) { return Vec3(0.9 * u * u * u, 0.6 * v, 0.05 * std::sin(4 * v)); });
  expect_sound(surface, remesh_isotropic(surface, [](const Vec3&) { return 0.03; }), 0.03, 0.003);
}

TEST(IsotropicRemesh, KeepsFixedVerticesCornersAndSeams) {
  Surface surface = patch(20, 20, dome);
  const int n = 21;
  const int inside = 7 * n + 8;
  surface.fixed = {inside, 5};
  for (int j = 0; j < 20; ++j) surface.lines.push_back({j * n + 10, (j + 1) * n + 10});  // a seam along x = 0
  const auto after = remesh_isotropic(surface, [](const Vec3&) { return 0.05; });
  for (const int v : {inside, 5, 0, 20, 20 * n, 20 * n + 20}) {
    ASSERT_GE(after.kept[static_cast<std::size_t>(v)], 0) << v;
    EXPECT_EQ(after.positions[static_cast<std::size_t>(after.kept[static_cast<std::size_t>(v)])],
              surface.positions[static_cast<std::size_t>(v)]);
  }
  // The seam is still a chain of edges from rim to rim, at its place.
  double seam = 0.0, was = 0.0;
  for (const auto& line : surface.lines)
    was += (surface.positions[static_cast<std::size_t>(line[0])] - surface.positions[static_cast<std::size_t>(line[1])])
               .norm();
  for (const auto& line : after.lines) {
    const Vec3 a = after.positions[static_cast<std::size_t>(line[0])],
               b = after.positions[static_cast<std::size_t>(line[1])];
    if (std::abs(a.x()) < 1e-12 && std::abs(b.x()) < 1e-12) seam += (a - b).norm();
  }
  EXPECT_NEAR(seam, was, 0.01 * was);
}

TEST(IsotropicRemesh, GradesToABand) {
  const Surface surface = patch(16, 16, [](double u, double v) { return Vec3(u - 0.5, v, 0.02 * std::sin(6 * v)); });
  const MeshSize size{0.06, 0.02, 0.05, 0.15, {{Vec2(0, -10), Vec2(0, 10)}}};
  const auto target = [&](const Vec3& p) { return size.at(p.head<2>()); };
  const auto after = remesh_isotropic(surface, target);
  const Measured m = measure(after.positions, after.faces, target);
  EXPECT_GT(m.in_band, 0.9);
  EXPECT_EQ(m.crowded_edges, 0);
}

TEST(IsotropicRemesh, KeepsATubeATube) {
  Surface surface = patch(24, 10, [](double u, double v) {
    return Vec3(0.2 * std::cos(2 * kPi * u), 0.2 * std::sin(2 * kPi * u), 0.5 * v);
  });
  for (auto& t : surface.faces) {
    for (int& v : t) v = v % 25 == 24 ? v - 24 : v;  // close it
  }
  // The 25th column is unused now, so its vertices go.
  Surface closed;
  std::map<int, int> to;
  for (auto& t : surface.faces) {
    for (int& v : t) {
      const auto [entry, fresh] = to.emplace(v, static_cast<int>(closed.positions.size()));
      if (fresh) closed.positions.push_back(surface.positions[static_cast<std::size_t>(v)]);
      v = entry->second;
    }
    closed.faces.push_back(t);
  }
  expect_sound(closed, remesh_isotropic(closed, [](const Vec3&) { return 0.03; }), 0.03, 0.003);
}

TEST(IsotropicRemesh, GivesTheSameBitsAgain) {
  const Surface surface = patch(12, 12, dome);
  const auto target = [](const Vec3&) { return 0.03; };
  const auto a = remesh_isotropic(surface, target), b = remesh_isotropic(surface, target);
  EXPECT_EQ(a.positions, b.positions);
  EXPECT_EQ(a.faces, b.faces);
}

/// A disc of radius 0.35 m with an outline of 90 edges, as OBJ text; `hole` leaves out the middle.
std::string disc(bool hole) {
  std::string vertices, faces;
  const int around = 90, rings = 9, first = hole ? 3 : 1;
  int count = 0;
  for (int r = first; r <= rings; ++r) {
    for (int i = 0; i < around; ++i, ++count) {
      const double angle = 2 * kPi * i / around, radius = 0.35 * r / rings;
      vertices +=
          "v " + std::to_string(radius * std::cos(angle)) + ' ' + std::to_string(radius * std::sin(angle)) + " 0\n";
    }
  }
  const auto face = [&](int a, int b, int c) {
    faces += "f " + std::to_string(a + 1) + ' ' + std::to_string(b + 1) + ' ' + std::to_string(c + 1) + '\n';
  };
  for (int r = 0; r < rings - first; ++r) {
    for (int i = 0; i < around; ++i) {
      const int a = r * around + i, b = r * around + (i + 1) % around;
      face(a, a + around, b + around);
      face(a, b + around, b);
    }
  }
  if (!hole) {
    vertices += "v 0 0 0\n";
    for (int i = 0; i < around; ++i) face(count, i, (i + 1) % around);
  }
  return vertices + faces;
}

TEST(ImportRemesh, FlatPanelsKeepOutlineAndNamedVertices) {
  const test::Folder folder;
  const auto file = folder.write("disc.obj", disc(false));
  ImportOptions options;
  const auto before = import_garment(file, options);
  options.remesh = MeshSize{0.03};
  const auto after = import_garment(file, options);
  EXPECT_THAT(after.findings.end()[-2].text, ::testing::HasSubstr("weft's mesher of flat panels"));
  ASSERT_TRUE(after.is_flat());
  EXPECT_EQ(count_intersections(after.mesh.positions, after.mesh.faces), 0);
  for (const auto& [name, v] : before.vertices) {
    // The mesher writes whole micrometres.
    EXPECT_LT((before.mesh.positions.row(v) - after.mesh.positions.row(after.vertices.at(name))).norm(), 1e-6) << name;
  }
  // The area of a disc whose outline is cut into edges of 3 cm.
  double area = 0.0;
  for (Index f = 0; f < after.mesh.faces.rows(); ++f) {
    const Vec2 a = after.mesh.rest.row(after.mesh.faces(f, 0)), b = after.mesh.rest.row(after.mesh.faces(f, 1)),
               c = after.mesh.rest.row(after.mesh.faces(f, 2));
    area += ((b - a).x() * (c - a).y() - (b - a).y() * (c - a).x()) / 2.0;
  }
  EXPECT_NEAR(area, kPi * 0.35 * 0.35, 0.005 * kPi * 0.35 * 0.35);
  // The outline stays within 0.02 edges.
  for (Index v = 0; v < after.mesh.positions.rows(); ++v) {
    const double r = after.mesh.positions.row(v).norm();
    EXPECT_LT(r, 0.35 + 1e-5);
  }
}

TEST(ImportRemesh, HolesAndNamesInsideTakeTheIsotropicWay) {
  const test::Folder folder;
  ImportOptions options;
  options.remesh = MeshSize{0.03};
  const auto ring = import_garment(folder.write("ring.obj", disc(true)), options);
  EXPECT_THAT(ring.findings.end()[-2].text, ::testing::HasSubstr("isotropic remeshing"));
  EXPECT_TRUE(ring.is_flat());
  options.names = {parse_vertex_name("--name", "middle=nearest(0,0)")};
  const auto named = import_garment(folder.write("disc.obj", disc(false)), options);
  EXPECT_THAT(named.findings.end()[-2].text, ::testing::HasSubstr("isotropic remeshing"));
  EXPECT_EQ(named.mesh.positions.row(named.vertices.at("middle")).norm(), 0.0);
  EXPECT_EQ(named.mesh.rest, named.mesh.positions.leftCols<2>());
  EXPECT_TRUE(named.is_flat());
}

}  // namespace
}  // namespace weft
