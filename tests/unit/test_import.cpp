#include <Eigen/Geometry>
#include <cmath>
#include <numbers>
#include <sstream>

#include "gltf_sheet.hpp"
#include "meshes/import/garment_files.hpp"
#include "meshes/import/import.hpp"
#include "meshes/import/pieces.hpp"
#include "meshes/intersections.hpp"
#include "meshes/mesher.hpp"
#include "meshes/sewing.hpp"
#include "test_support.hpp"

namespace weft {
namespace {

using test::message_of;

using ::testing::AllOf;
using ::testing::HasSubstr;

/// A mesh as OBJ text: vertices, and faces by index from 0.
struct Text {
  std::string vertices, faces;
  int count = 0;
  int v(double x, double y, double z) {
    vertices += "v " + std::to_string(x) + ' ' + std::to_string(y) + ' ' + std::to_string(z) + '\n';
    return count++;
  }
  void f(const std::vector<int>& corners) {
    faces += 'f';
    for (const int c : corners) faces += ' ' + std::to_string(c + 1);
    faces += '\n';
  }
  std::string text() const { return vertices + faces; }
};

/// A grid of n x n quads over [0, size]^2, two triangles each, in the plane that `place` chooses.
template <class Place>
Text grid(int n, double size, Place&& place) {
  Text mesh;
  for (int j = 0; j <= n; ++j) {
    for (int i = 0; i <= n; ++i) {
      const Vec3 p = place(size * i / n, size * j / n);
      mesh.v(p.x(), p.y(), p.z());
    }
  }
  for (int j = 0; j < n; ++j) {
    for (int i = 0; i < n; ++i) {
      const int a = j * (n + 1) + i;
      mesh.f({a, a + 1, a + n + 2});
      mesh.f({a, a + n + 2, a + n + 1});
    }
  }
  return mesh;
}
Vec3 flat(double x, double y) { return Vec3(x, y, 0.0); }

/// A tube of n x n quads, radius and height in metres, its axis along z. @param textured with vt of the unrolled tube.
std::string tube(int n, double radius, double height) {
  Text mesh;
  for (int j = 0; j <= n; ++j) {
    for (int i = 0; i < n; ++i) {
      const double angle = 2.0 * std::numbers::pi * i / n;
      mesh.v(radius * std::cos(angle), radius * std::sin(angle), height * j / n);
    }
  }
  for (int j = 0; j < n; ++j) {
    for (int i = 0; i < n; ++i) {
      const int a = j * n + i, b = j * n + (i + 1) % n;
      mesh.f({a, a + n, b + n});  // looks inwards
      mesh.f({a, b + n, b});
    }
  }
  return mesh.text();
}

ImportedGarment import_text(const std::string& text, const ImportOptions& options = {},
                            const std::string& name = "mesh.obj") {
  const test::Folder folder;
  return import_garment(folder.write(name, text), options);
}

/// The findings of a pass as one text, each with its kind and count.
std::string found(const ImportedGarment& garment, const std::string& pass) {
  std::string text;
  for (const Finding& finding : garment.findings) {
    if (finding.pass != pass) continue;
    const char* const kinds[] = {"fact", "mended", "warning", "limit"};
    text += std::string(kinds[static_cast<int>(finding.kind)]) + ' ' + std::to_string(finding.count) + ": " +
            finding.text + '\n';
  }
  return text;
}
double area_of(const ImportedGarment& garment) {
  double area = 0.0;
  for (Index f = 0; f < garment.mesh.faces.rows(); ++f) {
    const Vec3 a = garment.mesh.positions.row(garment.mesh.faces(f, 0)).transpose();
    const Vec3 u = garment.mesh.positions.row(garment.mesh.faces(f, 1)).transpose() - a;
    const Vec3 v = garment.mesh.positions.row(garment.mesh.faces(f, 2)).transpose() - a;
    area += u.cross(v).norm() / 2.0;
  }
  return area;
}

TEST(Import, ASoundFlatMeshIsLeftAsItIs) {
  const auto garment = import_text(grid(4, 0.6, flat).text());
  EXPECT_TRUE(garment.is_flat());
  for (const Finding& finding : garment.findings) EXPECT_NE(finding.kind, FindingKind::mended) << finding.text;
  ASSERT_EQ(garment.mesh.positions.rows(), 25);
  EXPECT_EQ(garment.mesh.rest, garment.mesh.positions.leftCols<2>());
  EXPECT_EQ(garment.vertices.at("left_bottom"), 0);
  EXPECT_EQ(garment.vertices.at("right_top"), 24);
  EXPECT_EQ(garment.grasp, (std::vector<std::string>{"left_top", "left_bottom"}));
}

TEST(Import, CutsPolygonsIntoTriangles) {
  Text mesh;
  // An L of one concave hexagon, and a quad beside it.
  for (const auto& [x, y] : {std::pair{0.0, 0.0}, {0.6, 0.0}, {0.6, 0.3}, {0.3, 0.3}, {0.3, 0.6}, {0.0, 0.6}})
    mesh.v(x, y, 0.0);
  mesh.f({0, 1, 2, 3, 4, 5});
  const int a = mesh.v(0.6, 0.6, 0.0);
  mesh.f({3, 2, a, 4});
  const auto garment = import_text(mesh.text());
  EXPECT_THAT(found(garment, "triangulate"), HasSubstr("mended 2: 1 quad and 1 larger polygon"));
  EXPECT_EQ(garment.mesh.faces.rows(), 6);
  EXPECT_NEAR(area_of(garment), 0.36, 1e-9);
  EXPECT_TRUE(garment.is_flat());
  EXPECT_THAT(message_of<ConfigError>([] { import_text("v 0 0 0\nv 1 1 0\nv 1 0 0\nv 0 1 0\nf 1 2 3 4\n"); }),
              AllOf(HasSubstr("mesh.obj:5: face 1 crosses itself"), HasSubstr("cut it up")));
}

TEST(Import, GuessesUnitsAndUpAxisAndSaysWhy) {
  const auto standing = grid(4, 65.0, [](double x, double y) { return Vec3(x, 97.5, y); }).text();
  const auto garment = import_text(standing);
  EXPECT_THAT(found(garment, "units"), HasSubstr("guessed centimetres: the largest extent of 65 is then 0.65 m"));
  EXPECT_THAT(found(garment, "up"), HasSubstr("guessed up axis y: the mesh is flat across it"));
  EXPECT_NEAR(area_of(garment), 0.65 * 0.65, 1e-9);
  EXPECT_EQ(garment.mesh.positions.col(2).cwiseAbs().maxCoeff(), 0.0);

  ImportOptions options;
  options.units = "in";
  options.up = "y";
  const auto given = import_text(standing, options);
  EXPECT_THAT(found(given, "units"), HasSubstr("inches (as given): the largest extent is 1.65 m"));
  EXPECT_NEAR(area_of(given), std::pow(65 * 0.0254, 2), 1e-6);
  options.units = "m";
  EXPECT_THAT(found(import_text(standing, options), "units"), HasSubstr("warning 1: metres (as given): the largest "
                                                                        "extent is 65 m, a strange size"));
  options.units = "ell";
  EXPECT_THAT(message_of<ConfigError>([&] { import_text(standing, options); }),
              HasSubstr("--units = ell, must be one of m, cm, mm, in"));
  EXPECT_THAT(message_of<ConfigError>([] { import_text(grid(2, 0.002, flat).text()); }),
              AllOf(HasSubstr("0.002 units large"), HasSubstr("give --units")));
  // 36 is 0.36 m in centimetres and 0.91 m in inches.
  EXPECT_THAT(
      found(import_text(grid(2, 36, flat).text()), "units"),
      HasSubstr("warning 1: guessed centimetres: the largest extent of 36 is then 0.36 m; it may also be inches "
                "(0.914 m): give --units"));
}

TEST(Import, WeldsASoupOfTriangles) {
  Text soup;
  const int n = 4;
  for (int j = 0; j < n; ++j) {
    for (int i = 0; i < n; ++i) {
      const auto at = [&](int di, int dj) { return soup.v(0.15 * (i + di), 0.15 * (j + dj), 0.0); };
      const int a = at(0, 0), b = at(1, 0), c = at(1, 1);
      soup.f({a, b, c});
      const int d = at(0, 0), e = at(1, 1), f = at(0, 1);
      soup.f({d, e, f});
    }
  }
  const auto garment = import_text(soup.text());
  EXPECT_EQ(garment.mesh.positions.rows(), 25);
  EXPECT_THAT(found(garment, "weld"), HasSubstr("mended 71: 71 vertices within"));
  EXPECT_THAT(found(garment, "pieces"), HasSubstr("fact 1: one piece"));
  // Every vertex of the file is still known.
  ASSERT_EQ(garment.vertex_of.size(), 96u);
  EXPECT_EQ(*std::min_element(garment.vertex_of.begin(), garment.vertex_of.end()), 0);
}

TEST(Import, DoesNotSewTouchingLayersTogether) {
  Text mesh = grid(3, 0.6, flat);
  const int first = mesh.count;
  const Text second = grid(3, 0.6, flat);
  mesh.vertices += second.vertices;
  mesh.count += second.count;
  mesh.f({first, first + 1, first + 5});
  mesh.f({first, first + 5, first + 4});
  for (int j = 0; j < 3; ++j) {
    for (int i = j == 0 ? 1 : 0; i < 3; ++i) {
      const int a = first + 4 * j + i;
      mesh.f({a, a + 1, a + 5});
      mesh.f({a, a + 5, a + 4});
    }
  }
  const auto garment = import_text(mesh.text());
  EXPECT_EQ(garment.mesh.positions.rows(), 32);
  EXPECT_THAT(found(garment, "weld"), HasSubstr("warning 4: 4 vertices inside the cloth coincide with others"));
  EXPECT_THAT(found(garment, "pieces"), HasSubstr("warning 2: 2 pieces"));
  // The second lies two layers above the first.
  EXPECT_THAT(found(garment, "layers"), HasSubstr("the cloth lies in layers 0 to 2"));
  EXPECT_EQ(garment.layers.front(), 0.0);
  EXPECT_EQ(garment.layers.back(), 2.0);
  EXPECT_EQ(garment.garment("two").form.seams.rows(), 0);
}

TEST(Import, KeepsFrontAndBackApartAtOpenings) {
  // The back has vertices of its own inside, so at the openings alone vertices of front and back coincide.
  const Outline outline = towel_outline({});
  MeshSize size{0.05};
  const Mesh front = generate_mesh(outline, size).mesh;
  size.lattice_shift = {0.5, 0.3};
  const Mesh back = generate_mesh(outline, size).mesh;
  const SewnMesh sewn =
      sew_front_and_back(front, back, [&](const Vec2& a, const Vec2& b) { return !is_open_at(outline, a, b); });
  Text mesh;
  for (Index v = 0; v < sewn.mesh.positions.rows(); ++v)
    mesh.v(sewn.mesh.positions(v, 0), sewn.mesh.positions(v, 1), 0.0);
  for (Index f = 0; f < sewn.mesh.faces.rows(); ++f)
    mesh.f({sewn.mesh.faces(f, 0), sewn.mesh.faces(f, 1), sewn.mesh.faces(f, 2)});
  const auto garment = import_text(mesh.text());
  EXPECT_EQ(garment.mesh.faces, sewn.mesh.faces) << "nothing is joined, and front and back keep their sides";
  EXPECT_THAT(found(garment, "weld"), HasSubstr("as front and back do at an opening: not joined"));
  EXPECT_EQ(garment.layers, sewn.form.layers);
}

TEST(Import, AVertexInNoFaceDecidesNothing) {
  Text mesh = grid(4, 0.4, flat);
  mesh.v(1000.0, 1000.0, 9.0);
  const auto garment = import_text(mesh.text());
  EXPECT_THAT(found(garment, "units"), HasSubstr("guessed metres: the largest extent of 0.4"));
  EXPECT_THAT(found(garment, "up"), HasSubstr("guessed up axis z"));
  EXPECT_THAT(found(garment, "faces"), HasSubstr("1 vertex in no face removed"));
}

TEST(Import, SaysWhereASeamIsAlmostClosed) {
  Text mesh = grid(4, 0.3, flat);
  const int first = mesh.count;
  const Text right = grid(4, 0.3, [](double x, double y) { return Vec3(0.3005 + x, y, 0.0); });
  mesh.vertices += right.vertices;
  for (int j = 0; j < 4; ++j) {
    for (int i = 0; i < 4; ++i) {
      const int a = first + 5 * j + i;
      mesh.f({a, a + 1, a + 6});
      mesh.f({a, a + 6, a + 5});
    }
  }
  EXPECT_THAT(
      found(import_text(mesh.text()), "weld"),
      AllOf(HasSubstr("warning 5: 5 pairs of boundary vertices are at most 0.5 mm apart"), HasSubstr("--weld")));
  ImportOptions options;
  options.weld_m = 0.001;
  const auto welded = import_text(mesh.text(), options);
  EXPECT_THAT(found(welded, "weld"), HasSubstr("mended 5"));
  EXPECT_EQ(welded.mesh.positions.rows(), 45);
  EXPECT_THAT(found(welded, "pieces"), HasSubstr("one piece"));
}

TEST(Import, RemovesRepeatedAndDegenerateFaces) {
  Text mesh = grid(3, 0.6, flat);
  mesh.f({0, 1, 5});  // a face again
  mesh.f({5, 1, 0});  // and from the back
  mesh.f({2, 2, 3});
  mesh.v(9, 9, 9);  // in no face
  const auto garment = import_text(mesh.text());
  EXPECT_THAT(found(garment, "faces"), AllOf(HasSubstr("mended 2: 2 faces that repeat another one (1 of them seen"),
                                             HasSubstr("face 19"), HasSubstr("1 vertex in no face removed")));
  EXPECT_THAT(found(garment, "triangulate"), HasSubstr("1 face with fewer than three different corners"));
  EXPECT_EQ(garment.mesh.faces.rows(), 18);
  EXPECT_EQ(garment.vertex_of.back(), -1);
  // The far vertex does not spoil the guess of units by itself; here it does, and is worth a warning.
  EXPECT_THAT(found(garment, "units"), HasSubstr("guessed"));
}

TEST(Import, AFaceOnALineLeavesNoGap) {
  // A triangle of no area between two faces: a T-junction that was closed with it.
  Text mesh;
  for (const auto& [x, y] : {std::pair{0.0, 0.0}, {0.6, 0.0}, {0.6, 0.6}, {0.0, 0.6}, {0.3, 0.3}}) mesh.v(x, y, 0.0);
  mesh.f({0, 1, 2});
  mesh.f({0, 2, 4});  // 0, 4, 2 lie on the diagonal
  mesh.f({0, 4, 3});
  mesh.f({4, 2, 3});
  const auto garment = import_text(mesh.text());
  EXPECT_THAT(found(garment, "faces"), HasSubstr("mended 1: 1 face whose vertices lie on a line removed: face 2"));
  EXPECT_EQ(garment.mesh.faces.rows(), 4);
  EXPECT_NEAR(area_of(garment), 0.36, 1e-9);
  EXPECT_THAT(found(garment, "holes"), HasSubstr("no holes"));
  EXPECT_THAT(found(garment, "pieces"), HasSubstr("one piece"));
}

TEST(Import, SplitsBowTiesAndCutsEdgesOfThreeFaces) {
  Text bow;
  for (const auto& [x, y] : {std::pair{0.0, 0.0}, {0.3, 0.0}, {0.3, 0.3}, {0.6, 0.3}, {0.6, 0.6}}) bow.v(x, y, 0.0);
  bow.f({0, 1, 2});
  bow.f({2, 3, 4});
  const auto split = import_text(bow.text());
  EXPECT_THAT(found(split, "bow-ties"),
              HasSubstr("mended 1: 1 vertex where faces meet at a point only, split: vertex 3"));
  EXPECT_EQ(split.mesh.positions.rows(), 6);

  Text fin = grid(4, 0.6, flat);
  const int a = fin.v(0.3, 0.3, 0.15), b = fin.v(0.3, 0.45, 0.15);
  fin.f({12, 17, b});
  fin.f({12, b, a});
  const auto cut = import_text(fin.text());
  EXPECT_THAT(found(cut, "non-manifold edges"), HasSubstr("warning 1: 1 edge of more than two faces: edge 13-18 of 3"));
  EXPECT_EQ(cut.mesh.positions.rows(), 25 + 2 + 2);
  EXPECT_THAT(found(cut, "pieces"), HasSubstr("2 pieces"));
  ImportOptions options;
  options.piece = 1;
  const auto sheet = import_text(fin.text(), options);
  EXPECT_TRUE(sheet.is_flat());
  EXPECT_EQ(sheet.mesh.positions.rows(), 25);
  options.piece = 3;
  EXPECT_THAT(message_of<ConfigError>([&] { import_text(fin.text(), options); }),
              AllOf(HasSubstr("--piece = 3"), HasSubstr("has 2 pieces")));
}

TEST(Import, TurnsFacesToOneSideAndRefusesAMoebiusStrip) {
  Text mesh = grid(3, 0.6, flat);
  mesh.faces = "f 1 6 2\n" + mesh.faces.substr(mesh.faces.find('\n') + 1);
  const auto garment = import_text(mesh.text());
  EXPECT_THAT(found(garment, "orientation"), HasSubstr("mended 1: 1 face turned"));
  EXPECT_TRUE(garment.is_flat());
  // Seen from below.
  const auto below = import_text(grid(3, 0.6, [](double x, double y) { return Vec3(-x, y, 0.0); }).text());
  EXPECT_THAT(found(below, "orientation"), HasSubstr("mended 18: 18 faces turned to be counter-clockwise"));
  EXPECT_TRUE(below.is_flat());

  Text strip;
  const int n = 12;
  for (int i = 0; i < n; ++i) {
    const double t = 2.0 * std::numbers::pi * i / n;
    for (const double s : {-0.1, 0.1}) {
      const double r = 0.3 + s * std::cos(t / 2.0);
      strip.v(r * std::cos(t), r * std::sin(t), s * std::sin(t / 2.0));
    }
  }
  for (int i = 0; i < n; ++i) {
    const int a = 2 * i, b = 2 * i + 1;
    const int c = i + 1 < n ? a + 2 : 1, d = i + 1 < n ? b + 2 : 0;
    strip.f({a, c, d});
    strip.f({a, d, b});
  }
  EXPECT_THAT(message_of<ConfigError>([&] { import_text(strip.text()); }),
              AllOf(HasSubstr("Moebius strip"), HasSubstr("edge vertex "), HasSubstr("cut it open")));
}

TEST(Import, FillsSmallHolesAndListsOpenings) {
  Text mesh = grid(5, 0.6, flat);
  const std::size_t at = mesh.faces.find("f 15 16 22\n");
  ASSERT_NE(at, std::string::npos);
  mesh.faces.erase(at, std::string("f 15 16 22\n").size());
  const auto garment = import_text(mesh.text());
  EXPECT_THAT(found(garment, "holes"), HasSubstr("mended 1: 1 hole of at most 6 edges filled (--fill 0 keeps them)"));
  EXPECT_EQ(garment.mesh.faces.rows(), 50);
  EXPECT_NEAR(area_of(garment), 0.36, 1e-9);
  ImportOptions options;
  options.fill_edges = 0;
  const auto kept = import_text(mesh.text(), options);
  EXPECT_EQ(kept.mesh.faces.rows(), 49);
  EXPECT_THAT(found(kept, "holes"), HasSubstr("fact 1: 1 opening besides the longest boundary: 3 edges"));
}

TEST(Import, ReadsWhatEditorsAddToText) {
  const std::string text = grid(2, 0.6, flat).text();
  std::string wide = "\xff\xfe";
  for (const char c : text) wide += std::string{c, '\0'};
  const std::pair<std::string, std::string> files[] = {
      {"\xef\xbb\xbf" + text, "skipped a byte-order mark"},
      {text + "\x1a", "skipped a Ctrl-Z at the end"},
      {wide, "UTF-16"},
      {text + "l 1 2\n", "1 line or point skipped"},
  };
  for (const auto& [file, message] : files) {
    const auto garment = import_text(file);
    EXPECT_THAT(found(garment, "file"), HasSubstr(message));
    EXPECT_EQ(garment.mesh.positions.rows(), 9) << message;
    if (message.find("line") == std::string::npos) {
      const test::Folder folder;
      EXPECT_EQ(read_obj(folder.write("m.obj", file)).positions.rows(), 9) << message;
    }
  }
}

TEST(Import, LaysNoisyAndTiltedSheetsFlat) {
  const auto noisy = import_text(
      grid(4, 0.6, [](double x, double y) { return Vec3(x, y, 0.7 + 1e-5 * std::sin(40 * x * y)); }).text());
  EXPECT_TRUE(noisy.is_flat());
  EXPECT_THAT(found(noisy, "flat"), HasSubstr("mended 1: flat within"));
  EXPECT_EQ(noisy.mesh.positions.col(2).cwiseAbs().maxCoeff(), 0.0);
  const auto tilted =
      import_text(grid(4, 0.6, [](double x, double y) { return Vec3(x, 0.8 * y, 0.6 * y); }).text(), [] {
        ImportOptions options;
        options.up = "z";
        return options;
      }());
  EXPECT_TRUE(tilted.is_flat());
  EXPECT_THAT(found(tilted, "flat"), HasSubstr("turned by 37 degrees"));
  EXPECT_NEAR(area_of(tilted), 0.36, 1e-6);
  // Beyond the bound of 1e-4 it is a shape.
  EXPECT_FALSE(
      import_text(grid(4, 0.6, [](double x, double y) { return Vec3(x, y, 3e-4 * std::sin(40 * x * y)); }).text())
          .is_flat());
}

/// A sheet bent to a quarter of a tube, with vt.
std::string bent(double texture_scale, double stretch) {
  Text mesh = grid(8, 0.6, [](double x, double y) {
    const double radius = 1.2 / std::numbers::pi;
    return Vec3(radius * std::sin(x / radius), y, radius * std::cos(x / radius));
  });
  std::string text = mesh.vertices;
  for (int j = 0; j <= 8; ++j) {
    for (int i = 0; i <= 8; ++i) {
      text +=
          "vt " + std::to_string(texture_scale * stretch * i / 8) + ' ' + std::to_string(texture_scale * j / 8) + '\n';
    }
  }
  std::string faces;
  for (std::size_t i = 0; i < mesh.faces.size(); ++i) {
    if (mesh.faces[i] != ' ') {
      faces += mesh.faces[i];
      continue;
    }
    const std::size_t end = mesh.faces.find_first_of(" \n", i + 1);
    const std::string number = mesh.faces.substr(i + 1, end - i - 1);
    faces += ' ' + number + '/' + number;
    i = end - 1;
  }
  return text + faces;
}

TEST(Import, LaysABentSheetFlatByATextureOfItsSize) {
  const auto garment = import_text(bent(1.0, 1.0));
  EXPECT_TRUE(garment.is_flat());
  EXPECT_THAT(found(garment, "rest shape"),
              AllOf(HasSubstr("mended 1: from the texture, at 0."), HasSubstr("laid flat")));
  EXPECT_EQ(garment.mesh.positions.col(2).cwiseAbs().maxCoeff(), 0.0);
  EXPECT_NEAR(area_of(garment), 0.36, 0.36 * 0.01);  // chords of the arc
  // A texture that is stretched one way says nothing of size.
  const auto other = import_text(bent(1.0, 1.5));
  EXPECT_FALSE(other.is_flat());
  EXPECT_THAT(found(other, "texture"), HasSubstr("has nothing to do with size and is ignored"));
  EXPECT_THAT(found(other, "rest shape"), AllOf(HasSubstr("fact 1: not flat"), HasSubstr("an open sheet"),
                                                HasSubstr("laid on the table by simulation")));
}

TEST(Import, TexturesOfFlatMeshesAreTakenOnlyInMetres) {
  const std::string plain = grid(2, 2.0, flat).text();
  const auto with_texture = [&](double scale, double turn) {
    Text mesh = grid(2, 2.0, flat);
    std::string text = mesh.vertices;
    for (int j = 0; j <= 2; ++j) {
      for (int i = 0; i <= 2; ++i) {
        const double x = scale * i, y = scale * j;
        text += "vt " + std::to_string(std::cos(turn) * x - std::sin(turn) * y) + ' ' +
                std::to_string(std::sin(turn) * x + std::cos(turn) * y) + '\n';
      }
    }
    for (const auto& t :
         {std::array{1, 2, 5}, {1, 5, 4}, {2, 3, 6}, {2, 6, 5}, {4, 5, 8}, {4, 8, 7}, {5, 6, 9}, {5, 9, 8}}) {
      text += "f";
      for (const int v : t) text += ' ' + std::to_string(v) + '/' + std::to_string(v);
      text += '\n';
    }
    return text;
  };
  // 0..1 on a sheet of 2 m: as metres it would burst.
  const auto unit = import_text(with_texture(0.5, 0.0));
  EXPECT_THAT(found(unit, "rest shape"), HasSubstr("the texture repeats the mesh at another scale (2 m per unit)"));
  EXPECT_EQ(unit.mesh.rest, unit.mesh.positions.leftCols<2>());
  // Metres in another direction: the warp is meant.
  const auto turned = import_text(with_texture(1.0, 0.5));
  EXPECT_THAT(found(turned, "rest shape"), HasSubstr("a rest shape in metres: kept"));
  EXPECT_NEAR(turned.mesh.rest(8, 1), std::sin(0.5) * 2 + std::cos(0.5) * 2, 1e-6);
  const std::string one_point = plain.substr(0, plain.find('f')) + "vt 0 0\nf 1/1 2/1 5/1\nf 1/1 5/1 4/1\n";
  EXPECT_THAT(found(import_text(one_point), "rest shape"), HasSubstr("one point: ignored"));
}

TEST(Import, SmoothsAWornGarmentWhereItPassesThroughItself) {
  constexpr int n = 16;
  constexpr double kRadius = 0.1, kHeight = 0.5;
  std::istringstream lines(tube(n, kRadius, kHeight));
  std::string text, line;
  for (int row = 0; std::getline(lines, line); ++row) {
    if (row == 8 * n + 4) {  // pushed past its neighbour, through the faces there
      const double angle = 2.0 * std::numbers::pi * 5.6 / n, radius = kRadius + 0.003;
      line = "v " + std::to_string(radius * std::cos(angle)) + ' ' + std::to_string(radius * std::sin(angle)) + ' ' +
             std::to_string(kHeight * 8.3 / n);
    }
    text += line + '\n';
  }
  ImportOptions options;
  options.units = "m";
  options.up = "z";
  const ImportedGarment mended = import_text(text, options);
  EXPECT_THAT(found(mended, "crossings"), AllOf(HasSubstr("mended 6: 6 edges through a face"),
                                                HasSubstr("moved by at most"), HasSubstr("vertex 1")));
  EXPECT_EQ(count_intersections(mended.mesh.positions, mended.mesh.faces), 0);
  // Nothing else moved.
  const ImportedGarment sound = import_text(tube(n, kRadius, kHeight), options);
  EXPECT_EQ(found(sound, "crossings"), "");
  int moved = 0;
  for (Index v = 0; v < sound.mesh.positions.rows(); ++v)
    moved += (mended.mesh.positions.row(v) - sound.mesh.positions.row(v)).norm() > 1e-9;
  EXPECT_LT(moved, 20);
}

TEST(Import, KeepsTheLengthsOfAClosedGarmentAndSaysThatItMustBeLaid) {
  const auto garment = import_text(tube(12, 0.2, 0.5));
  EXPECT_FALSE(garment.is_flat());
  EXPECT_THAT(found(garment, "up"), HasSubstr("guessed up axis z: its 2 openings look along it (100 %"));
  EXPECT_THAT(found(garment, "rest shape"),
              AllOf(HasSubstr("fact 1: not flat (0.5 m high, a surface with 2 open boundaries"),
                    HasSubstr("laid on the table by simulation")));
  EXPECT_THAT(found(garment, "orientation"), HasSubstr("all faces turned to look outwards"));
  EXPECT_TRUE(garment.grasp.empty());
  EXPECT_EQ(garment.garment("tube").form.frames.rows(), garment.mesh.faces.rows());
  // Front and back of a flat pattern, joined at one side.
  Text folded = grid(3, 0.6, flat);
  const int first = folded.count;
  for (int j = 0; j <= 3; ++j) {
    for (int i = 0; i < 3; ++i) folded.v(0.2 * i, 0.2 * j + 0.01, 0.0);
  }
  for (int j = 0; j < 3; ++j) {
    for (int i = 0; i < 3; ++i) {
      const auto at = [&](int k, int l) { return k == 3 ? 4 * l + 3 : first + 3 * l + k; };
      folded.f({at(i, j), at(i + 1, j + 1), at(i + 1, j)});
      folded.f({at(i, j), at(i, j + 1), at(i + 1, j + 1)});
    }
  }
  const auto two = import_text(folded.text());
  EXPECT_THAT(found(two, "rest shape"), HasSubstr("18 faces of the flat mesh look down"));
  EXPECT_THAT(found(two, "layers"), HasSubstr("layers 0 to 1"));
  EXPECT_TRUE(two.is_flat());
  EXPECT_EQ(two.garment("two").form.seams.rows(), 3);
  EXPECT_EQ(two.layers.at(0), 1.0) << "the front";
  EXPECT_EQ(two.layers.at(3), 0.0) << "the seam";
}

TEST(Import, AGarmentThatEndsInAPointIsHeldAtAnotherSide) {
  // Pointed on the left, straight on the right.
  const auto garment = import_text("v 0 0 0\nv 0.6 -0.3 0\nv 0.6 0.3 0\nv 0.5 0 0\nf 1 2 4\nf 4 2 3\nf 1 4 3\n");
  EXPECT_EQ(garment.grasp, (std::vector<std::string>{"right_top", "right_bottom"}));
}

TEST(Import, NamesSurviveAndAreCheckedAgainstTheFile) {
  Text mesh = grid(4, 0.6, flat);
  mesh.v(0.7, 0.7, 0.0);  // in no face
  ImportOptions options;
  options.names = {parse_vertex_name("--name", "neck=nearest(0.31, 0.58)"), parse_vertex_name("--name", "hem=3")};
  options.grasp = {parse_vertex_spec("--grasp", "5"), {"hem", -1}};
  const auto garment = import_text(mesh.text(), options);
  EXPECT_EQ(garment.vertices.at("neck"), 22);
  EXPECT_EQ(garment.vertices.at("hem"), 2);
  EXPECT_EQ(garment.grasp, (std::vector<std::string>{"right_bottom", "hem"}));
  const auto refused = [&](const std::string& name) {
    return message_of<ConfigError>([&] {
      ImportOptions wrong;
      wrong.names = {parse_vertex_name("--name", name)};
      import_text(mesh.text(), wrong);
    });
  };
  EXPECT_THAT(refused("a=99"), AllOf(HasSubstr("--name a = 99, but "), HasSubstr("has only 26 vertices")));
  EXPECT_THAT(refused("a=26"), HasSubstr("is not in the imported garment"));
  EXPECT_THAT(refused("a=0"), HasSubstr("must be a vertex number from 1, nearest(x,y)"));
  EXPECT_THAT(refused("a=nearest(1)"), HasSubstr("must be a vertex number from 1, nearest(x,y)"));
  EXPECT_THAT(refused("a=nearest(1,nan)"), HasSubstr("must be a vertex number"));
  EXPECT_THAT(refused("4=1"), HasSubstr("must be NAME=VERTEX"));
  EXPECT_THAT(message_of<ConfigError>([&] {
                ImportOptions wrong;
                wrong.grasp = {{"left_tp", -1}, {"left_bottom", -1}};
                import_text(mesh.text(), wrong);
              }),
              AllOf(HasSubstr("--grasp = left_tp, which names no vertex"), HasSubstr("nearest: left_top")));
}

TEST(Import, OtherFormatsNeedAssimp) {
  EXPECT_THAT(message_of<ConfigError>([] { import_text("", {}, "mesh.fbx"); }),
              HasSubstr("must be an .obj, .ply, .stl, .gltf or .glb mesh"));
  const std::string stl =
      "solid s\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 0.6 0 0\nvertex 0.6 0.6 0\n"
      "endloop\nendfacet\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 0.6 0.6 0\n"
      "vertex 0 0.6 0\nendloop\nendfacet\nendsolid s\n";
  const std::string ply =
      "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
      "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
      "0 0 0\n60 0 0\n60 60 0\n0 60 0\n4 0 1 2 3\n";
  try {
    const auto loose = import_text(stl, {}, "mesh.stl");
    EXPECT_EQ(loose.mesh.positions.rows(), 4);  // STL has no shared vertices
    EXPECT_THAT(found(loose, "weld"), HasSubstr("mended 2"));
    const auto quad = import_text(ply, {}, "mesh.ply");
    EXPECT_EQ(quad.mesh.faces.rows(), 2);
    EXPECT_NEAR(area_of(quad), 0.36, 1e-6);
    const auto scene = import_text(test::kGltfSheet, {}, "mesh.gltf");
    EXPECT_THAT(found(scene, "units"), HasSubstr("metres (as glTF is defined)"));
    EXPECT_THAT(found(scene, "pieces"), HasSubstr("around (0.30, 0.30, 1.00)"));
    EXPECT_NEAR(area_of(scene), 0.36, 1e-6);
    EXPECT_THAT(message_of<ConfigError>([] { import_text("no mesh", {}, "mesh.ply"); }), HasSubstr("cannot be read"));
    EXPECT_THAT(message_of<ConfigError>(
                    [] { import_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\n", {}, "mesh.ply"); }),
                HasSubstr("mesh.ply: is a Git LFS pointer"));
  } catch (const ConfigError& error) {
    EXPECT_THAT(error.what(), AllOf(HasSubstr("this build of weft reads OBJ only"), HasSubstr("libassimp-dev")));
  }
}

TEST(Import, ImportingTheResultChangesNothing) {
  Text faulty = grid(6, 63.0, [](double x, double y) { return Vec3(x, 12.0, y); });
  faulty.f({0, 1, 8});
  faulty.v(5, 5, 5);
  ImportOptions remeshed;
  remeshed.remesh = MeshSize{0.07};
  const std::pair<std::string, ImportOptions> inputs[] = {
      {faulty.text(), {}}, {faulty.text(), remeshed}, {bent(1.0, 1.0), {}}, {tube(12, 20.0, 50.0), {}}};
  const auto text_of = [](const std::filesystem::path& file) {
    std::ifstream stream(file, std::ios::binary);
    return std::string{std::istreambuf_iterator<char>(stream), {}};
  };
  for (const auto& [text, options] : inputs) {
    const test::Folder folder;
    const auto first = import_garment(folder.write("in.obj", text), options);
    std::filesystem::create_directories(folder / "one");
    write_garment_files(folder / "one", "cloth", first, "test");
    for (const char* again : {"one/cloth.obj", "one/cloth.yaml"}) {
      const auto second = import_garment(folder / again, {});
      for (const Finding& finding : second.findings) {
        EXPECT_NE(finding.kind, FindingKind::mended) << finding.pass << ": " << finding.text;
      }
      EXPECT_EQ(second.vertices, first.vertices);
      EXPECT_EQ(second.grasp, first.grasp);
      EXPECT_EQ(second.mesh.faces, first.mesh.faces);
      std::filesystem::create_directories(folder / "two");
      write_garment_files(folder / "two", "cloth", second, "test");
      EXPECT_EQ(text_of(folder / "two/cloth.obj"), text_of(folder / "one/cloth.obj"));
      EXPECT_EQ(text_of(folder / "two/cloth.yaml"), text_of(folder / "one/cloth.yaml"));
    }
  }
}

TEST(Import, TheTaskFoldsAlongXOrAcrossTheHands) {
  const auto garment = import_text(grid(4, 0.6, flat).text());
  const auto at = [&](const char* name) { return garment.vertices.at(name); };
  EXPECT_NEAR((fold_in_two(garment.mesh, at("left_top"), at("left_bottom"), true) - Vec2(0.6, 0.0)).norm(), 0.0, 1e-12);
  EXPECT_NEAR((fold_in_two(garment.mesh, at("left_top"), at("right_top"), false) - Vec2(0.0, -0.6)).norm(), 0.0, 1e-12);
  const Vec2 diagonal = fold_in_two(garment.mesh, at("left_bottom"), 1 * 5 + 0, false);
  EXPECT_GT(diagonal.x(), 0.0);
  EXPECT_THAT(message_of<ConfigError>([&] { fold_in_two(garment.mesh, 2, 22, false); }),
              HasSubstr("the hands lie at the middle of the garment"));
}

}  // namespace
}  // namespace weft
