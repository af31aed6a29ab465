#include <Eigen/LU>
#include <cmath>
#include <fstream>
#include <limits>
#include <random>

#include "meshes/intersections.hpp"
#include "test_support.hpp"
#include "weft/garment.hpp"

namespace weft {
namespace {

using test::message_of;

using ::testing::AllOf;
using ::testing::HasSubstr;

/// In a folder of this process: ctest runs the cases side by side.
std::filesystem::path write_file(const std::string& name, const std::string& text) {
  static const test::Folder folder;
  return folder.write(name, text);
}

Mesh read_text(const std::string& text) { return read_obj(write_file("mesh.obj", text)); }
Garment garment_of(const std::string& text) { return make_garment(read_text(text), "test"); }

const std::string kSquare = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n";
const std::string kFaces = "f 1 2 3\nf 1 3 4\n";

TEST(ReadObj, ReadsVerticesAndFaces) {
  const Mesh mesh = read_text(kSquare + kFaces);
  EXPECT_EQ(mesh.positions.rows(), 4);
  EXPECT_EQ(mesh.faces.rows(), 2);
  EXPECT_EQ(mesh.rest.rows(), 0);
  EXPECT_EQ(mesh.faces(1, 2), 3);
  EXPECT_EQ(mesh.positions(2, 1), 1.0);
}

TEST(ReadObj, AcceptsWhatOtherProgramsWrite) {
  const Mesh mesh = read_text(
      "# comment\r\nmtllib a.mtl\r\no cloth\r\ng front back\r\ns off\r\nusemtl cotton\r\n"
      "v 0 0 0 # origin\r\nv +1e0 0 0 1.0\r\nv 1 1 0 0.5 0.5 0.5\r\n  v\t0 1 \\\r\n 0\r\n\r\n"
      "vt 0 0\r\nvt 2 0 0\r\nvt 2 2\r\nvt 0 2\r\nvn 0 0 1\r\n"
      "f 1/1/1 2/2/1 3/3/1\r\nf -4/-4/-1 -2/-2/-1 -1/-1/-1");
  EXPECT_EQ(mesh.positions.rows(), 4);
  ASSERT_EQ(mesh.rest.rows(), 4);
  EXPECT_EQ(mesh.rest(2, 1), 2.0);
  EXPECT_EQ(mesh.positions(3, 1), 1.0);
  EXPECT_EQ(mesh.faces(1, 0), 0);
}

TEST(ReadObj, AcceptsOneRestPositionUnderSeveralIndices) {
  const Mesh mesh = read_text(kSquare + "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nvt 0 0\nf 1/1 2/2 3/3\nf 1/5 3/3 4/4\n");
  EXPECT_EQ(mesh.rest(0, 0), 0.0);
}

struct BadFile {
  std::string name, text, message;
};
void PrintTo(const BadFile& bad, std::ostream* out) { *out << bad.name; }
class ReadObjRefuses : public ::testing::TestWithParam<BadFile> {};

TEST_P(ReadObjRefuses, WithLineAndReason) {
  EXPECT_THAT(message_of<ConfigError>([] { read_text(GetParam().text); }), HasSubstr(GetParam().message));
}

const std::vector<BadFile>& bad_files() {
  static const std::vector<BadFile> files = {
      {"quad", kSquare + "f 1 2 3 4\n", "mesh.obj:5: face 1 is a quad, must be a triangle"},
      {"pentagon", kSquare + "f 1 2 3 4 1\n", ":5: face 1 has 5 vertices"},
      {"edge_face", kSquare + "f 1 2\n", ":5: face 1 has 2 vertices"},
      {"zero_index", kSquare + "f 0 1 2\n", ":5: face 1: index 0 in '0', OBJ indices start at 1"},
      {"index_out_of_range", kSquare + kFaces + "f 2 3 5\n", ":7: face 3 names vertex 5, but the file has only 4"},
      {"negative_out_of_range", kSquare + "f -1 -2 -5\n", ":5: face 1: relative index -5 in '-5', but only 4"},
      {"giant_index", kSquare + "f 1 2 99999999999999999999\n", "is out of range"},
      {"large_index", kSquare + "f 1 2 4294967297\n", "index 4294967297 in '4294967297' is out of range"},
      {"index_text", kSquare + "f 1 2 x\n", ":5: face 1: 'x' must be v, v/vt, v//vn or v/vt/vn"},
      {"index_number", kSquare + "f 1 2 3.5\n", ":5: face 1: '3.5' must be v"},
      {"nan", "v 0 0 nan\n", ":1: vertex 1 has 'nan', must be finite"},
      {"inf", "v 0 0 0\nv 1 inf 0\n", ":2: vertex 2 has 'inf', must be finite"},
      {"overflow", "v 0 0 1e999\n", ":1: vertex 1 has '1e999', which is out of the range of double"},
      {"text_coordinate", "v 0 zero 0\n", ":1: vertex 1 has 'zero', must be a number"},
      {"missing_coordinate", "v 0 0\n", ":1: vertex 1 has 2 coordinates, must have 3"},
      {"weight", "v 0 0 0 2\n", ":1: vertex 1 has a weight other than 1"},
      {"vt_one_number", "v 0 0 0\nvt 1\n", ":2: vt 1 has 1 coordinates, must have 2"},
      {"several_vt", kSquare + "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nvt 5 5\nf 1/1 2/2 3/3\nf 1/5 3/3 4/4\n",
       ":11: face 2 gives vertex 1 vt 5, but an earlier face gave it vt 1"},
      {"some_vt", kSquare + "vt 0 0\nvt 1 0\nvt 1 1\nf 1/1 2/2 3/3\nf 1 3 4\n",
       ":9: face 2 has no vt, unlike the faces"},
      {"vt_out_of_range", kSquare + "vt 0 0\nvt 1 0\nf 1/1 2/2 3/3\n",
       ":7: face 1 names vt 3, but the file has only 2"},
      {"vt_unused", kSquare + "vt 0 0\n" + kFaces, "1 vt, but no face uses them"},
      {"vertex_twice", kSquare + kFaces + "f 2 3 3\n", ":7: face 3 is degenerate: it names vertex 3 twice"},
      {"no_vertices", "f 1 2 3\n", "no vertices"},
      {"empty", "", "no vertices"},
      {"no_faces", kSquare, "no faces"},
      {"line_element", kSquare + kFaces + "l 1 2\n", ":7: a line element"},
      {"unknown_statement", kSquare + kFaces + "curv 0 1 1 2\n", ":7: 'curv' is not a statement of a triangle mesh"},
      {"binary",
       std::string("\x7f"
                   "ELF\0\x01\x02",
                   7) +
           "\n",
       "is not a statement of a triangle mesh"},
      {"many_numbers", "v 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18\n", "has more than 16 numbers"},
  };
  return files;
}
INSTANTIATE_TEST_SUITE_P(Samples, ReadObjRefuses, ::testing::ValuesIn(bad_files()),
                         [](const auto& sample) { return sample.param.name; });

TEST(ReadObj, RefusesMissingFilesAndFolders) {
  EXPECT_THAT(message_of<ConfigError>([] { read_obj("/nowhere/there.obj"); }), HasSubstr("there.obj: no such file"));
  EXPECT_THAT(message_of<ConfigError>([] { read_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\n"); }),
              HasSubstr("mesh.obj: is a Git LFS pointer, not the file itself; run `git lfs pull`"));
  EXPECT_THAT(message_of<ConfigError>([] { read_obj(std::filesystem::temp_directory_path()); }),
              HasSubstr(": is a folder, must be a file"));
}

TEST(ReadObj, SurvivesRandomDamage) {
  std::string good = kSquare + "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nf 1/1 2/2 3/3\nf 1/1 3/3 4/4\n";
  std::mt19937 random(7);
  int refused = 0;
  for (int round = 0; round < 2000; ++round) {
    std::string text = good;
    for (int k = 0; k < 3; ++k) text[random() % text.size()] = static_cast<char>(random() % 256);
    if (round % 5 == 0) text.resize(random() % text.size());
    try {
      garment_of(text);
    } catch (const ConfigError&) {
      ++refused;  // anything but a ConfigError fails the test
    }
  }
  EXPECT_GT(refused, 1000);
}

TEST(WriteObj, ExactTextReadsBackToTheSameBits) {
  Mesh mesh = read_text(kSquare + kFaces);
  mesh.positions(2, 0) = 0.1 + 0.2;
  mesh.positions(3, 2) = -1.0 / 3.0;
  mesh.rest = mesh.positions.leftCols<2>();
  const auto file = write_file("exact.obj", "");
  write_obj(file, mesh, true);
  const Mesh read = read_obj(file);
  EXPECT_EQ(read.positions, mesh.positions);
  EXPECT_EQ(read.rest, mesh.rest);
  EXPECT_EQ(read.faces, mesh.faces);
}

TEST(WriteObj, KeepsNineDigits) {
  Mesh mesh = read_text(kSquare + kFaces);
  mesh.positions(1, 0) = 1.23456789012;
  const auto file = write_file("nine.obj", "");
  write_obj(file, mesh);
  EXPECT_NEAR(read_obj(file).positions(1, 0), 1.23456789012, 1e-8);
}

TEST(WriteObj, RefusesNonFinitePositions) {
  Mesh mesh = read_text(kSquare + kFaces);
  mesh.positions(0, 0) = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THROW(write_obj(write_file("nan.obj", ""), mesh), Error);
}

TEST(MakeGarment, TakesTheRestShapeFromAFlatMesh) {
  const Garment garment = garment_of(kSquare + kFaces);
  EXPECT_EQ(garment.rest(2, 0), 1.0);
  EXPECT_EQ(garment.vertex_count(), 4);
}

TEST(MakeGarment, TakesTheRestShapeFromVt) {
  const Garment garment = garment_of("v 0 0 0\nv 1 0 1\nv 1 1 2\nvt 0 0\nvt 3 0\nvt 3 3\nf 1/1 2/2 3/3\n");
  EXPECT_EQ(garment.rest(1, 0), 3.0);
}

TEST(MakeGarment, AcceptsSeveralComponentsOnTopOfEachOther) {
  const Garment garment = garment_of(kSquare + "v 0 0 1\nv 1 0 1\nv 1 1 1\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n" +
                                     "f 1/1 2/2 3/3\nf 1/1 3/3 4/4\nf 5/1 6/2 7/3\n");
  EXPECT_EQ(garment.face_count(), 3);
}

class MakeGarmentRefuses : public ::testing::TestWithParam<BadFile> {};
TEST_P(MakeGarmentRefuses, NamingFaceOrVertex) {
  EXPECT_THAT(message_of<ConfigError>([] { garment_of(GetParam().text); }),
              AllOf(HasSubstr("mesh.obj: "), HasSubstr(GetParam().message)));
}
INSTANTIATE_TEST_SUITE_P(
    Samples, MakeGarmentRefuses,
    ::testing::Values(
        BadFile{"not_flat", "v 0 0 0\nv 1 0 0\nv 1 1 0.5\nf 1 2 3\n", "the mesh is not flat (z from"},
        BadFile{"collinear", "v 0 0 0\nv 1 0 0\nv 2 0 0\nv 0 1 0\nf 1 2 4\nf 2 3 1\n", "oriented inconsistently"},
        BadFile{"degenerate", "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n",
                "face 0 (OBJ 1) is degenerate: its vertices 0, 1, 2 lie on a line in the rest shape"},
        BadFile{"coincident", "v 0 0 0\nv 1 0 0\nv 1 0 0\nf 1 2 3\n", "face 0 (OBJ 1) is degenerate"},
        BadFile{"crumpled_start", "v 0 0 0\nv 0 0 0\nv 1 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nf 1/1 2/2 3/3\n",
                "lie on a line in the given positions"},
        BadFile{"inverted",
                kSquare + "v 0.5 2 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nvt 0.5 0.5\n" +
                    "f 1/1 2/2 3/3\nf 1/1 3/3 4/4\nf 4/4 3/3 5/5\n",
                "face 2 (OBJ 3) is inverted: its vertices run clockwise in the rest shape (1 of 3 faces do)"},
        BadFile{"all_inverted", kSquare + "f 1 3 2\nf 1 4 3\n", "(2 of 2 faces do; reverse the faces)"},
        BadFile{
            "orientation", kSquare + "f 1 2 3\nf 1 4 3\n",
            "face 0 (OBJ 1) and face 1 (OBJ 2) are oriented inconsistently: both run their common edge 0-2 (OBJ 1-3)"},
        BadFile{"fin", kSquare + "v 2 2 0\n" + kFaces + "f 1 3 5\n",
                "edge 0-2 (OBJ 1-3) is non-manifold: it belongs to 3 faces"},
        BadFile{"bow_tie", "v 0 0 0\nv 1 0 0\nv 1 1 0\nv -1 0 0\nv -1 -1 0\nf 1 2 3\nf 1 4 5\n",
                "vertex 0 (OBJ 1) is non-manifold: face 0 (OBJ 1) and face 1 (OBJ 2) meet only there"},
        BadFile{"unused_vertex", kSquare + "f 1 2 3\n", "vertex 3 (OBJ 4) is in no face"},
        BadFile{"far_away", "v 0 0 0\nv 1e300 0 0\nv 0 1 0\nf 1 2 3\n",
                "vertex 1 (OBJ 2) lies more than 1e6 m from the origin"},
        BadFile{"same_face_twice", kSquare + kFaces + "f 2 3 1\n", "face 2 (OBJ 3) repeats face 0 (OBJ 1)"}),
    [](const auto& sample) { return sample.param.name; });

TEST(MakeGarment, RefusesWhatOnlyAProgramCanMake) {
  Mesh mesh = read_text(kSquare + kFaces);
  mesh.faces(0, 1) = -1;
  EXPECT_THAT(message_of<ConfigError>([&] { make_garment(mesh, "m"); }), HasSubstr("face 0 (OBJ 1) names vertex -1"));
  mesh.faces(0, 1) = 1;
  mesh.positions(1, 2) = std::numeric_limits<double>::infinity();
  EXPECT_THAT(message_of<ConfigError>([&] { make_garment(mesh, "m"); }),
              HasSubstr("vertex 1 (OBJ 2) has a position that is not finite"));
  mesh.positions(1, 2) = 0.0;
  EXPECT_THAT(message_of<ConfigError>([&] {
                make_garment(mesh, "m", {{"corner", 4}});
              }),
              HasSubstr("vertices.corner = 4, must be in [0, 3]"));
  mesh.rest.resize(3, 2);
  EXPECT_THROW(make_garment(mesh, "m"), ShapeError);
}

TEST(MakeGarment, HashFollowsRestShapeAndFacesOnly) {
  Mesh mesh = read_text(kSquare + kFaces);
  mesh.rest = mesh.positions.leftCols<2>();
  const auto hash = make_garment(mesh, "a").hash;
  mesh.positions.col(2).setConstant(3.0);
  EXPECT_EQ(make_garment(mesh, "b", {{"corner", 0}}).hash, hash);
  mesh.rest(1, 0) = 1.5;
  EXPECT_NE(make_garment(mesh, "a").hash, hash);
  mesh.rest(1, 0) = 1.0;
  mesh.rest(0, 0) = -0.0;
  EXPECT_EQ(make_garment(mesh, "a").hash, hash);
  mesh.faces.row(0) << 1, 2, 0;
  EXPECT_NE(make_garment(mesh, "a").hash, hash);
}

TEST(Garment, NamesVerticesAndTheNearestWhenWrong) {
  const Garment garment = make_garment(read_text(kSquare + kFaces), "square", {{"left_bottom", 0}, {"right_top", 2}});
  EXPECT_EQ(garment.vertex("right_top"), 2);
  EXPECT_THAT(message_of<ConfigError>([&] { garment.vertex("left_botom"); }),
              HasSubstr("garment square: no vertex is named 'left_botom', must be one of left_bottom, right_top; "
                        "nearest: left_bottom"));
}

TEST(ReadGarment, ReadsTheThreeForms) {
  write_file("square.obj", kSquare + kFaces);
  const auto yaml = write_file("square.yaml", "name: napkin\nmesh: square.obj\nvertices: {corner: 2}\n");
  const auto folder = yaml.parent_path();
  const auto at = [&](const std::string& text) {
    return read_garment(ConfigNode::parse(text, "task.yaml", folder).at("garment"));
  };
  EXPECT_EQ(at("garment: square.obj").name, "square");
  EXPECT_EQ(at("garment: square.yaml").vertex("corner"), 2);
  EXPECT_EQ(at("garment: {mesh: square.obj, vertices: {a: 1}}").vertex("a"), 1);
  EXPECT_THAT(message_of<ConfigError>([&] { at("garment: {mesh: square.obj, vertices: {a: 9}}"); }),
              AllOf(HasSubstr("task.yaml:1"), HasSubstr("= 9, must be in [0, 3]")));
  EXPECT_THAT(message_of<ConfigError>([&] { at("garment: {mesh: square.obj, vertex: {a: 9}}"); }),
              HasSubstr("vertices"));
  EXPECT_THAT(message_of<ConfigError>([&] { at("garment: square.stl"); }),
              HasSubstr("must be an .obj mesh or a .yaml garment"));
  EXPECT_THAT(message_of<ConfigError>([&] { at("garment: [1]"); }), HasSubstr("must be the path of an OBJ"));
  EXPECT_THAT(message_of<ConfigError>([&] { at("garment: missing.obj"); }),
              AllOf(HasSubstr("task.yaml:1: garment = missing.obj: "), HasSubstr("missing.obj: no such file")));
}

TEST(MeanDistance, IsInMillimetres) {
  Positions a = Positions::Zero(2, 3);
  Positions b = a;
  b.row(1) << 0.003, 0.004, 0.0;
  EXPECT_DOUBLE_EQ(mean_distance_mm(a, b), 2.5);
  EXPECT_THROW(mean_distance_mm(a, Positions::Zero(3, 3)), ShapeError);
}

TEST(EdgesOf, ListsEachOnceInOrder) {
  Faces faces(2, 3);
  faces << 0, 1, 2, 0, 2, 3;
  const auto edges = edges_of(faces);
  ASSERT_EQ(edges.rows(), 5);
  EXPECT_EQ(edges(0, 0), 0);
  EXPECT_EQ(edges(0, 1), 1);
  EXPECT_EQ(edges(4, 0), 2);
  EXPECT_EQ(edges(4, 1), 3);
}

/// Counts by checking every pair in floating point: slow, and wrong only in degenerate cases.
Index count_by_brute_force(const Positions& x, const Faces& faces) {
  const auto edges = edges_of(faces);
  Index count = 0;
  for (Index e = 0; e < edges.rows(); ++e) {
    for (Index f = 0; f < faces.rows(); ++f) {
      bool shares = false;
      for (Index k = 0; k < 3; ++k) shares = shares || faces(f, k) == edges(e, 0) || faces(f, k) == edges(e, 1);
      if (shares) continue;
      Eigen::Matrix3d m;
      m.col(0) = x.row(faces(f, 1)) - x.row(faces(f, 0));
      m.col(1) = x.row(faces(f, 2)) - x.row(faces(f, 0));
      m.col(2) = x.row(edges(e, 0)) - x.row(edges(e, 1));
      const Eigen::Vector3d s = m.partialPivLu().solve(Eigen::Vector3d(x.row(edges(e, 0)) - x.row(faces(f, 0))));
      if (s.x() >= 0 && s.y() >= 0 && s.x() + s.y() <= 1 && s.z() > 0 && s.z() < 1) ++count;
    }
  }
  return count;
}

TEST(CountIntersections, AgreesWithBruteForceOnCrumpledMeshes) {
  std::mt19937 random(3);
  std::uniform_real_distribution<double> uniform(-1.0, 1.0);
  for (int round = 0; round < 5; ++round) {
    const int n = 12;
    Positions x(n * n, 3);
    Faces faces(2 * (n - 1) * (n - 1), 3);
    for (int i = 0; i < n; ++i) {
      for (int j = 0; j < n; ++j) {
        x.row(i * n + j) << 0.1 * i + 0.1 * uniform(random), 0.1 * j + 0.1 * uniform(random), 0.1 * uniform(random);
      }
    }
    Index f = 0;
    for (int i = 0; i + 1 < n; ++i) {
      for (int j = 0; j + 1 < n; ++j) {
        faces.row(f++) << i * n + j, (i + 1) * n + j, (i + 1) * n + j + 1;
        faces.row(f++) << i * n + j, (i + 1) * n + j + 1, i * n + j + 1;
      }
    }
    const Index expected = count_by_brute_force(x, faces);
    EXPECT_GT(expected, 10);
    EXPECT_EQ(count_intersections(x, faces), expected);
  }
}

TEST(CountIntersections, FindsAnEdgeThroughATriangle) {
  Positions x(6, 3);
  x << 0, 0, 0, 1, 0, 0, 0, 1, 0,  // triangle
      0.2, 0.2, -1, 0.2, 0.2, 1, 5, 5, 0;
  Faces faces(2, 3);
  faces << 0, 1, 2, 3, 4, 5;
  EXPECT_EQ(count_intersections(x, faces), 2);  // the edge 3-4, and 1-2 through the second triangle
  const auto found = find_intersections(x, faces, 10);
  ASSERT_EQ(found.size(), 2u);
  EXPECT_EQ(found[0].edge, (std::array{1, 2}));
  EXPECT_EQ(found[0].face, 1);
  EXPECT_EQ(found[1].edge, (std::array{3, 4}));
  EXPECT_EQ(found[1].face, 0);
  EXPECT_EQ(find_intersections(x, faces, 1).size(), 1u);
  x.row(3) << 2, 2, -1;
  x.row(4) << 2, 2, 1;
  EXPECT_EQ(count_intersections(x, faces), 0);
}

TEST(CountIntersections, IsZeroForFlatAndForParallelLayers) {
  const Garment shirt = read_garment(ConfigNode::scalar(WEFT_SOURCE_DIR "/configs/garments/tshirt.yaml"));
  EXPECT_EQ(count_intersections(shirt.positions, shirt.faces), 0);
  // Tilted so that the coordinates of the plane are not round numbers.
  Positions tilted = shirt.positions;
  for (Index v = 0; v < tilted.rows(); ++v) tilted(v, 2) = 0.37 * tilted(v, 0) - 0.21 * tilted(v, 1);
  EXPECT_EQ(count_intersections(tilted, shirt.faces), 0);
}

TEST(CountIntersections, SeesAFoldPushedThroughItself) {
  const Garment shirt = read_garment(ConfigNode::scalar(WEFT_SOURCE_DIR "/configs/garments/tshirt.yaml"));
  Positions folded = shirt.positions;
  for (Index v = 0; v < folded.rows(); ++v) {
    if (folded(v, 0) < 0.0) {
      // Mirrored to the other side, dipping below the lower layer towards the sleeve.
      folded(v, 2) = folded(v, 0) < -0.15 ? -0.01 : 0.02;
      folded(v, 0) = -folded(v, 0) + 0.001;
    }
  }
  EXPECT_GT(count_intersections(folded, shirt.faces), 0);
}

TEST(CountIntersections, RefusesNonFiniteAndWrongIndices) {
  Positions x = Positions::Zero(3, 3);
  x(1, 0) = x(2, 1) = 1.0;
  Faces faces(1, 3);
  faces << 0, 1, 3;
  EXPECT_THROW(count_intersections(x, faces), ShapeError);
  faces << 0, 1, 2;
  x(0, 0) = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THROW(count_intersections(x, faces), Error);
}

}  // namespace
}  // namespace weft
