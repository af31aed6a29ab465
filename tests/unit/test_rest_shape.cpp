#include <Eigen/Geometry>
#include <cmath>
#include <numbers>

#include "meshes/garment_writer.hpp"
#include "meshes/intersections.hpp"
#include "meshes/sewing.hpp"
#include "simulation/lay.hpp"
#include "test_support.hpp"
#include "weft/config.hpp"
#include "weft/rest_shape.hpp"

namespace weft {
namespace {

using test::message_of;

using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

/// A grid of n x n squares, `size` m wide, drawn flat.
Mesh grid(int n, double size) {
  Mesh mesh;
  mesh.source = "grid";
  mesh.positions = Positions::Zero((n + 1) * (n + 1), 3);
  for (int v = 0; v < mesh.positions.rows(); ++v)
    mesh.positions.row(v) << size * (v % (n + 1)) / n, size * (v / (n + 1)) / n, 0.0;
  mesh.faces.resize(2 * n * n, 3);
  for (int j = 0, f = 0; j < n; ++j)
    for (int i = 0; i < n; ++i) {
      const int a = j * (n + 1) + i, b = a + 1, c = a + n + 1, d = c + 1;
      mesh.faces.row(f++) << a, b, d;
      mesh.faces.row(f++) << a, d, c;
    }
  return mesh;
}

/// The chart of a grid as frames, each turned by another angle.
GarmentForm turned_frames(const Mesh& mesh) {
  GarmentForm form;
  form.frames.resize(mesh.faces.rows(), 4);
  for (Index f = 0; f < mesh.faces.rows(); ++f) {
    const Eigen::Rotation2Dd turn(0.7 * static_cast<double>(f));
    const Eigen::Vector2d p = mesh.positions.row(mesh.faces(f, 0)).head<2>();
    const Eigen::Vector2d u = turn * (Eigen::Vector2d(mesh.positions.row(mesh.faces(f, 1)).head<2>()) - p);
    const Eigen::Vector2d v = turn * (Eigen::Vector2d(mesh.positions.row(mesh.faces(f, 2)).head<2>()) - p);
    form.frames.row(f) << u.x(), u.y(), v.x(), v.y();
  }
  return form;
}

TEST(RestShape, FramesUnfoldToTheChart) {
  const Mesh mesh = grid(4, 0.2);
  const Garment chart = make_garment(mesh, "chart"), framed = make_garment(mesh, "framed", {}, turned_frames(mesh));
  const RestShape one(chart), other(framed);
  ASSERT_TRUE(one.is_chart());
  ASSERT_FALSE(other.is_chart());
  for (Index f = 0; f < mesh.faces.rows(); ++f) {
    EXPECT_NEAR(other.area(f), one.area(f), 1e-15);
    for (int k = 0; k < 3; ++k) {
      EXPECT_NEAR(other.edge_length(f, k), one.edge_length(f, k), 1e-15);
      EXPECT_EQ(other.opposite(f, k), one.opposite(f, k));
      EXPECT_EQ(other.bends(f, k), one.neighbour(f, k) >= 0);
      if (one.neighbour(f, k) < 0) continue;
      // Distances from the vertex across the edge to the face's own corners do not depend on the frame.
      for (int j = 0; j < 3; ++j)
        EXPECT_NEAR((other.place_across(f, k) - other.corner(f, j)).norm(),
                    (one.place_across(f, k) - one.corner(f, j)).norm(), 1e-14);
    }
  }
  EXPECT_EQ(one.corner(3, 1), Vec2(chart.rest.row(chart.faces(3, 1)).transpose())) << "to the bit";
}

TEST(RestShape, DistancesRunThroughTheSurface) {
  // A grid of 10 mm, folded along its diagonal as drawn: distances are those of the flat sheet.
  Mesh mesh = grid(6, 0.06);
  GarmentForm form = turned_frames(mesh);
  const Positions flat = mesh.positions;
  for (Index v = 0; v < flat.rows(); ++v)
    if (flat(v, 0) > 0.03) mesh.positions.row(v) << 0.06 - flat(v, 0), flat(v, 1), 0.002;
  const RestShape shape(make_garment(mesh, "folded", {}, form));
  const auto at = [](int i, int j) { return 7 * j + i; };
  const auto place = [&](int v) { return Eigen::Vector2d(flat.row(v).head<2>()); };
  // A vertex and a face two squares beyond: (5, 3) and the face (2, 3) (3, 3) (3, 4).
  EXPECT_NEAR(shape.distance({at(5, 3), at(2, 3), at(3, 3), at(3, 4)}, false, 0.1), 0.02, 1e-12);
  // Edges: (2, 2)-(2, 3) and (3, 2)-(3, 3) are 10 mm apart.
  EXPECT_NEAR(shape.distance({at(2, 2), at(2, 3), at(3, 2), at(3, 3)}, true, 0.1), 0.01, 1e-12);
  // Beyond `most` it says `most`. The drawing has these two over each other, 2 mm apart.
  EXPECT_NEAR((place(at(2, 3)) - place(at(4, 3))).norm(), 0.02, 1e-12);
  EXPECT_EQ(shape.distance({at(4, 3), at(1, 2), at(2, 2), at(2, 3)}, false, 0.004), 0.004);
}

TEST(RestShape, FramesOfAShapeKeepLengthsAndFollowTheGrain) {
  const Mesh mesh = tube(24, 6, 0.1, 0.3);
  EXPECT_TRUE(usual_grain(mesh.positions).is_weft);
  EXPECT_EQ(usual_grain(mesh.positions).direction.z(), 1.0) << "it stands";
  const RestFrames frames = frames_of_shape(mesh.positions, mesh.faces, usual_grain(mesh.positions), 2.0);
  for (Index f = 0; f < frames.rows(); ++f) {
    const double drawn = (mesh.positions.row(mesh.faces(f, 1)) - mesh.positions.row(mesh.faces(f, 0))).norm();
    EXPECT_NEAR(frames.row(f).head<2>().norm(), 2.0 * drawn, 1e-12);
    EXPECT_GT(frames(f, 0) * frames(f, 3) - frames(f, 1) * frames(f, 2), 0.0) << "counter-clockwise";
    // The first edge of every second face runs around the tube, which is along the warp.
    EXPECT_NEAR(f % 2 == 0 ? frames(f, 1) : 0.0, 0.0, 1e-12);
  }
  // A face that is square to the grain takes y.
  const Mesh flat = grid(1, 1.0);
  EXPECT_EQ(frames_of_shape(flat.positions, flat.faces, {true, Vec3(0, 0, 1)}).row(0), Eigen::RowVector4d(1, 0, 1, 1));
}

TEST(Sewing, FrontAndBackShareTheSeamsAndDoNotCross) {
  // A pillowcase of a grid, open on the right. The corner triangle with three vertices at seams is cut.
  const SewnMesh sewn =
      sew_front_and_back(grid(4, 0.2), [](const Vec2& a, const Vec2& b) { return a.x() < 0.199 || b.x() < 0.199; });
  const Garment garment = make_garment(sewn.mesh, "pillowcase", {}, sewn.form);
  EXPECT_TRUE(garment_warnings(garment).empty());
  EXPECT_GT(garment.face_count(), 2 * 32) << "cut at the corners";
  double area = 0.0;
  const RestShape shape(garment);
  for (Index f = 0; f < shape.face_count(); ++f) area += shape.area(f);
  EXPECT_NEAR(area, 2 * 0.04, 1e-12);
  // 12 edges of the border are seams; none of them bends.
  EXPECT_EQ(garment.form.seams.rows(), 12);
  Index free_sides = 0;
  for (Index f = 0; f < shape.face_count(); ++f)
    for (int k = 0; k < 3; ++k) free_sides += shape.neighbour(f, k) >= 0 && !shape.bends(f, k);
  EXPECT_EQ(free_sides, 24);
  const Positions start = positions_on_ground(garment, 0.1, 0.002);
  EXPECT_EQ(count_intersections(start, garment.faces), 0);
  for (Index v = 0; v < start.rows(); ++v) EXPECT_NEAR(start(v, 2), garment.layer(v) > 0 ? 0.104 : 0.102, 1e-15);
  const LowestLayer lowest = lowest_layer(garment, start);
  EXPECT_NEAR(lowest.height, 0.102, 1e-12);
  EXPECT_LT(lowest.vertices, garment.vertex_count());
  EXPECT_THROW(sew_front_and_back(grid(2, 0.2), [](const Vec2&, const Vec2&) { return false; }), Error);
}

TEST(Sewing, TheBackMayHaveOtherVerticesInside) {
  const auto left = [](const Vec2& a, const Vec2& b) { return a.x() < 0.199 || b.x() < 0.199; };
  const Mesh front = grid(4, 0.2);
  Mesh back = front;
  for (Index v = 0; v < back.positions.rows(); ++v)
    if (back.positions.row(v).head<2>().minCoeff() > 1e-9 && back.positions.row(v).head<2>().maxCoeff() < 0.2 - 1e-9)
      back.positions(v, 0) += 0.01;
  const SewnMesh sewn = sew_front_and_back(front, back, left), copied = sew_front_and_back(front, left);
  EXPECT_EQ(sewn.form.seams, copied.form.seams);
  EXPECT_EQ(sewn.mesh.faces, copied.mesh.faces) << "the same faces, at other places";
  EXPECT_EQ(std::count(sewn.back.begin(), sewn.back.end(), -1), 9) << "the inner vertices";
  EXPECT_EQ(std::count(copied.back.begin(), copied.back.end(), -1), 0);
  back.positions(0, 0) -= 0.01;  // a corner
  EXPECT_THROW(sew_front_and_back(front, back, left), Error);
}

TEST(LyingPose, AThinSheetWithAHoleLiesAsASheet) {
  Mesh mesh = grid(6, 0.6);
  Faces rest(mesh.faces.rows(), 3);
  Index kept = 0;
  for (Index f = 0; f < mesh.faces.rows(); ++f) {
    Eigen::RowVector3d centre = Eigen::RowVector3d::Zero();
    for (int k = 0; k < 3; ++k) centre += mesh.positions.row(mesh.faces(f, k)) / 3.0;
    if ((centre.head<2>().array() - 0.3).abs().maxCoeff() > 0.1) rest.row(kept++) = mesh.faces.row(f);
  }
  mesh.faces = rest.topRows(kept);
  mesh.positions.row(24) = mesh.positions.row(0);  // the middle vertex is in no face
  for (Index v = 0; v < mesh.positions.rows(); ++v) mesh.positions(v, 2) = 0.02 * std::sin(12.0 * mesh.positions(v, 0));
  Garment garment;
  garment.positions = mesh.positions;
  garment.faces = mesh.faces;
  const Positions lying = lying_pose(garment);
  EXPECT_LT(lying.col(2).maxCoeff() - lying.col(2).minCoeff(), 0.1) << "two boundaries, as a tube has";
}

TEST(Garment, WithoutLayersTheStartIsLiftedAsEver) {
  Mesh mesh = grid(2, 0.2);
  mesh.rest = mesh.positions.leftCols<2>();
  mesh.positions(4, 2) = 0.05;
  const Positions start = positions_on_ground(make_garment(mesh, "sheet"), 0.01, 0.001);
  EXPECT_EQ(start(0, 2), 0.01 + 0.001);
  EXPECT_EQ(start(4, 2), 0.05);
}

TEST(Garment, TheHashFollowsTheForm) {
  const Mesh mesh = grid(3, 0.2);
  const auto plain = make_garment(mesh, "a").hash;
  GarmentForm form = turned_frames(mesh);
  const auto framed = make_garment(mesh, "a", {}, form).hash;
  EXPECT_NE(framed, plain);
  form.frames(2, 1) += 1e-4;
  EXPECT_NE(make_garment(mesh, "a", {}, form).hash, framed);
  GarmentForm layered;
  layered.layers.assign(16, 0.0);
  EXPECT_NE(make_garment(mesh, "a", {}, layered).hash, plain);
  GarmentForm seam;
  seam.seams.resize(1, 2);
  seam.seams << 5, 6;
  EXPECT_NE(make_garment(mesh, "a", {}, seam).hash, plain);
}

TEST(Garment, RefusesAFormThatDoesNotFit) {
  const Mesh mesh = grid(2, 0.2);
  const auto refused = [&](const GarmentForm& form) {
    return message_of<Error>([&] { make_garment(mesh, "a", {}, form); });
  };
  GarmentForm form = turned_frames(mesh);
  form.frames.row(1).swap(form.frames.row(1));
  form.frames.row(1) << 0.0, 0.1, 0.1, 0.0;
  EXPECT_THAT(refused(form), HasSubstr("face 1 (OBJ 2) is inverted"));
  form.frames.row(1) << 0.1, 0.0, 0.2, 0.0;
  EXPECT_THAT(refused(form), HasSubstr("face 1 (OBJ 2) is degenerate"));
  form.frames(1, 0) = std::nan("");
  EXPECT_THAT(refused(form), HasSubstr("face 1 (OBJ 2) has a frame that is not finite"));
  form.frames.conservativeResize(3, 4);
  EXPECT_THAT(refused(form), HasSubstr("rows of frames"));
  GarmentForm layered;
  layered.layers.assign(9, 1.0);
  EXPECT_THAT(refused(layered), HasSubstr("no vertex has the layer 0"));
  layered.layers[3] = -1.0;
  EXPECT_THAT(refused(layered), HasSubstr("vertex 3 (OBJ 4) has the layer -1"));
  layered.layers.resize(4);
  EXPECT_THAT(refused(layered), HasSubstr("layers"));
  GarmentForm seam;
  seam.seams.resize(1, 2);
  seam.seams << 3, 1;
  EXPECT_THAT(refused(seam), HasSubstr("seams: edge 0"));
}

// ---------------------------------------------------------------------------------------------------------------------

class GarmentYaml : public ::testing::Test {
 protected:
  Garment read(const std::string& yaml) const {
    return read_garment(ConfigNode::parse("garment: " + yaml, "g.yaml", folder_.path()).at("garment"));
  }
  std::string refused(const std::string& yaml) const {
    return message_of<ConfigError>([&] { read(yaml); });
  }
  test::Folder folder_;
};

// A square of 2 m with texture coordinates in 0..1, as drawing programs write it.
const char* const kUnitTexture =
    "v 0 0 0\nv 2 0 0\nv 2 2 0\nv 0 2 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nf 1/1 2/2 3/3\nf 1/1 3/3 4/4\n";
// Two squares of 0.5 m, hinged at x = 0.5 and folded upwards there; each has a part of the texture, the second mirrored.
const char* const kSeamTexture =
    "v 0 0 0\nv 0.5 0 0\nv 0.5 0.5 0\nv 0 0.5 0\nv 0.5 0 0.5\nv 0.5 0.5 0.5\n"
    "vt 0 0\nvt 0.25 0\nvt 0.25 0.25\nvt 0 0.25\nvt 0.9 0\nvt 0.65 0\nvt 0.65 0.25\nvt 0.9 0.25\n"
    "f 1/1 2/2 3/3\nf 1/1 3/3 4/4\nf 2/5 5/6 6/7\nf 2/5 6/7 3/8\n";

TEST_F(GarmentYaml, ATextureInZeroToOneIsNoRestShapeInMetres) {
  folder_.write("cloth.obj", kUnitTexture);
  const std::string text = refused("cloth.obj");
  EXPECT_THAT(text, AllOf(HasSubstr("cloth.obj: the mesh is strained by 100 % (median edge) against its rest shape"),
                          HasSubstr("texture coordinates (vt) lie in 0..1, so they are hardly metres"),
                          HasSubstr("rest: {from: mesh}"), HasSubstr("scale: 2}"), HasSubstr("weft garment import")));
  EXPECT_EQ(refused("{mesh: cloth.obj}").substr(refused("{mesh: cloth.obj}").find("cloth.obj: the")),
            text.substr(text.find("cloth.obj: the")));
  // The three remedies.
  EXPECT_EQ(read("{mesh: cloth.obj, rest: {from: mesh}}").rest(2, 0), 2.0);
  const Garment scaled = read("{mesh: cloth.obj, rest: {from: texture, scale: 2}}");
  EXPECT_EQ(scaled.rest(2, 0), 2.0);
  EXPECT_FALSE(scaled.has_frames()) << "one place for each vertex: a chart, with the hash of always";
  EXPECT_EQ(scaled.hash, read("{mesh: cloth.obj, rest: {from: mesh}}").hash);
  EXPECT_EQ(read("{mesh: cloth.obj, rest: {from: texture, strained: a stretched drum}}").rest(2, 0), 1.0);
  EXPECT_THAT(refused("{mesh: cloth.obj, rest: {from: mesh, scale: 0.9}}"),
              AllOf(HasSubstr("strained by 11 %"), HasSubstr("rest.strained gives the reason")));
  EXPECT_EQ(read("{mesh: cloth.obj, rest: {from: mesh, scale: 0.99}}").rest(2, 0), 1.98) << "1 % is no error";
}

TEST_F(GarmentYaml, ReadsTexturesWithSeamsFaceByFace) {
  folder_.write("seam.obj", kSeamTexture);
  EXPECT_THAT(refused("seam.obj"), HasSubstr("a vertex has one rest position"));
  const Garment garment = read("{mesh: seam.obj, rest: {from: texture, scale: 2}}");
  ASSERT_TRUE(garment.has_frames());
  EXPECT_EQ(garment.form.frames.row(0), Eigen::RowVector4d(0.5, 0, 0.5, 0.5));
  // The second part is mirrored in the texture; its frame runs counter-clockwise, its warp along the texture's x.
  EXPECT_EQ(garment.form.frames.row(2), Eigen::RowVector4d(0.5, 0, 0.5, 0.5));
  EXPECT_THAT(refused("{mesh: seam.obj, rest: {from: texture}}"), HasSubstr("strained by 100 %"));
  EXPECT_THAT(refused("{mesh: seam.obj, rest: {from: texture, scale: 2, warp: x}}"), HasSubstr("is not needed"));
}

TEST_F(GarmentYaml, TheWarpIsADirectionOrTheTextures) {
  folder_.write("seam.obj", kSeamTexture);
  // The standing square has its edges along y and z.
  EXPECT_EQ(read("{mesh: seam.obj, rest: {from: mesh, warp: y}}").form.frames.row(0),
            Eigen::RowVector4d(0, -0.5, 0.5, -0.5));
  EXPECT_EQ(read("{mesh: seam.obj, rest: {from: mesh, warp: [0, 2, 0]}}").form.frames.row(0),
            Eigen::RowVector4d(0, -0.5, 0.5, -0.5));
  EXPECT_EQ(read("{mesh: seam.obj, rest: {from: mesh, weft: y}}").form.frames.row(0),
            Eigen::RowVector4d(0.5, 0, 0.5, 0.5));
  const Garment textured = read("{mesh: seam.obj, rest: {from: mesh, warp: texture}}");
  // Along the texture's x, which grows to the left in the second part.
  EXPECT_TRUE(textured.form.frames.row(0).isApprox(Eigen::RowVector4d(0.5, 0, 0.5, 0.5)));
  EXPECT_TRUE(textured.form.frames.row(2).isApprox(Eigen::RowVector4d(-0.5, 0, -0.5, -0.5)));
  EXPECT_THAT(refused("{mesh: seam.obj, rest: {from: mesh, warp: x, weft: y}}"), HasSubstr("one of them is enough"));
  EXPECT_THAT(refused("{mesh: seam.obj, rest: {from: mesh, warp: up}}"), HasSubstr("must be x, y, z or three numbers"));
  EXPECT_THAT(refused("{mesh: seam.obj, rest: {from: mesh, warp: [0, 0, 0]}}"), HasSubstr("not all zero"));
  folder_.write("bare.obj", "v 0 0 0\nv 1 0 0\nv 1 1 0\nf 1 2 3\n");
  EXPECT_THAT(refused("{mesh: bare.obj, rest: {from: texture}}"), HasSubstr("face 0 (OBJ 1) has none"));
  EXPECT_THAT(refused("{mesh: bare.obj, rest: {from: mesh, warp: texture}}"), HasSubstr("face 0 (OBJ 1) has none"));
}

TEST_F(GarmentYaml, TakesTheRestShapeFromAnotherFile) {
  folder_.write("worn.obj", "v 0 0 0\nv 0.5 0 0\nv 0.5 0.5 0\nv 0 0.5 0.02\nf 1 2 3\nf 1 3 4\n");
  // A pattern of two pieces, one triangle each.
  folder_.write("pattern.obj", "v 0 0 0\nv 0.5 0 0\nv 0.5 0.5 0\nv 2 0 0\nv 2.5 0.5 0\nv 2 0.5 0\nf 1 2 3\nf 4 5 6\n");
  const Garment garment = read("{mesh: worn.obj, rest: {from: file, file: pattern.obj}}");
  EXPECT_EQ(garment.form.frames.row(1), Eigen::RowVector4d(0.5, 0.5, 0, 0.5));
  EXPECT_EQ(garment.positions(3, 2), 0.02);
  folder_.write("short.obj", "v 0 0 0\nv 0.5 0 0\nv 0.5 0.5 0\nf 1 2 3\n");
  EXPECT_THAT(refused("{mesh: worn.obj, rest: {from: file, file: short.obj}}"),
              HasSubstr("has 1 faces, must have one for each of the 2 faces"));
  EXPECT_THAT(refused("{mesh: worn.obj, rest: {from: file}}"), HasSubstr("file"));
  EXPECT_THAT(refused("{mesh: worn.obj, rest: {from: mesh, file: pattern.obj}}"), HasSubstr("needs rest.from: file"));
  EXPECT_THAT(refused("{mesh: worn.obj, rest: {from: vt}}"), HasSubstr("must be mesh, texture or file"));
  EXPECT_THAT(refused("{mesh: worn.obj, rest: {from: mesh, scale: 0}}"), HasSubstr("must be above 0"));
  EXPECT_THAT(refused("worn.obj"), AllOf(HasSubstr("not flat"), HasSubstr("rest: {from: mesh}")));
}

TEST_F(GarmentYaml, ReadsLayersAndSeams) {
  const SewnMesh sewn =
      sew_front_and_back(grid(4, 0.4), [](const Vec2& a, const Vec2& b) { return a.x() < 0.399 || b.x() < 0.399; });
  write_obj(folder_ / "case.obj", sewn.mesh);
  const Garment garment = read("{mesh: case.obj, rest: {from: mesh}, layers: sides}");
  EXPECT_EQ(garment.form.layers, sewn.form.layers);
  EXPECT_EQ(garment.form.seams, sewn.form.seams);
  EXPECT_TRUE(garment.form.frames.isApprox(sewn.form.frames));
  EXPECT_EQ(read("{mesh: case.obj, rest: {from: mesh}, layers: sides, seams: {bend: true}}").form.seams.rows(), 0);
  EXPECT_THAT(refused("{mesh: case.obj, rest: {from: mesh}, layers: [0, 1]}"), HasSubstr("has 2 numbers"));
  EXPECT_THAT(refused("{mesh: case.obj, rest: {from: mesh}, layers: front}"), HasSubstr("must be sides, or a list"));
  EXPECT_THAT(refused("{mesh: case.obj, layers: sides}"), HasSubstr("is inverted")) << "it needs frames";
  write_obj(folder_ / "sheet.obj", grid(2, 0.4));
  EXPECT_THAT(refused("{mesh: sheet.obj, layers: sides}"), HasSubstr("no face of"));
  EXPECT_THAT(read("{mesh: sheet.obj, layers: [0, 0, 0, 0, 1.5, 1, 1, 1, 1]}").form.layers,
              ElementsAre(0, 0, 0, 0, 1.5, 1, 1, 1, 1));
}

TEST_F(GarmentYaml, WhatIsSavedReadsBackToTheSameNumbers) {
  const SewnMesh sewn =
      sew_front_and_back(grid(3, 0.4), [](const Vec2& a, const Vec2& b) { return a.y() < 0.399 || b.y() < 0.399; });
  folder_.write("cloth.obj", kUnitTexture);
  const Garment garments[] = {make_garment(sewn.mesh, "case", {{"corner", 0}}, sewn.form),
                              make_garment(grid(3, 0.4), "sheet", {{"corner", 3}}),
                              read("{mesh: cloth.obj, rest: {from: texture, strained: why not}}")};
  for (const Garment& garment : garments) {
    write_garment_meshes(folder_ / "saved.obj", garment);
    const ConfigNode node =
        ConfigNode::parse(garment_node("saved.obj", garment).to_yaml(), "saved.yaml", folder_.path());
    const Garment again = read_garment(node);
    EXPECT_EQ(again.hash, garment.hash) << garment.name;
    EXPECT_EQ(again.positions, garment.positions);
    EXPECT_EQ(again.rest, garment.rest);
    EXPECT_EQ(again.vertices, garment.vertices);
    EXPECT_EQ(again.form.layers, garment.form.layers);
    EXPECT_EQ(again.form.seams, garment.form.seams);
  }
  EXPECT_THAT(garment_node("saved.obj", garments[1]).keys(), ElementsAre("mesh", "name", "vertices"));
}

TEST(GarmentWarnings, SizesPiecesAndOpenSeams) {
  EXPECT_THAT(garment_warnings(make_garment(grid(3, 0.6), "a")), IsEmpty());
  EXPECT_THAT(garment_warnings(make_garment(grid(3, 60.0), "a")),
              ElementsAre(AllOf(HasSubstr("60 m long"), HasSubstr("--units cm"))));
  EXPECT_THAT(garment_warnings(make_garment(grid(3, 0.006), "a")), ElementsAre(HasSubstr("0.006 m long")));
  // Two sheets side by side that touch along an edge and share no vertex.
  const Mesh one = grid(2, 0.4);
  Mesh two;
  two.positions.resize(18, 3);
  two.positions << one.positions, one.positions;
  two.positions.bottomRows(9).col(0).array() += 0.4;
  two.faces.resize(16, 3);
  two.faces << one.faces, (one.faces.array() + 9).matrix();
  EXPECT_THAT(
      garment_warnings(make_garment(two, "a")),
      ElementsAre(HasSubstr("2 pieces that share no vertex"),
                  AllOf(HasSubstr("3 border vertices lie where another one does"), HasSubstr("vertex 2 (OBJ 3)"))));
}

}  // namespace
}  // namespace weft
