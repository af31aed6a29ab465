#pragma once
#include <array>
#include <vector>

#include "weft/garment.hpp"

namespace weft {

/// The unstretched cloth of a garment, face by face. Without frames, corners are rows of Garment::rest, to the bit.
/// Corner k of a face has the edge k opposite to it.
class WEFT_API RestShape {
 public:
  explicit RestShape(const Garment& garment);

  Index face_count() const { return faces_.rows(); }
  /// One place in the plane for each vertex.
  bool is_chart() const { return frames_.rows() == 0; }
  /// m, in the frame of the face: x = warp, y = weft.
  Vec2 corner(Index face, int k) const {
    if (is_chart()) return rest_.row(faces_(face, k)).transpose();
    return k == 0 ? Vec2(0.0, 0.0) : Vec2(frames_(face, 2 * k - 2), frames_(face, 2 * k - 1));
  }
  double area(Index face) const;  ///< m^2
  /// The face across edge k, or -1 at a border.
  Index neighbour(Index face, int k) const { return across_[3 * face + k].face; }
  /// The vertex of that face that is not on the edge, or -1.
  int opposite(Index face, int k) const {
    const Side& side = across_[3 * face + k];
    return side.face < 0 ? -1 : faces_(side.face, side.corner);
  }
  /// Whether a bending moment crosses edge k: it is neither a border nor a seam.
  bool bends(Index face, int k) const { return across_[3 * face + k].bends; }
  /// Where opposite() lies in the frame of this face when the neighbour is unfolded into its plane, m.
  /// Where the two faces give their common edge different lengths, along it by parts, across it in metres.
  Vec2 place_across(Index face, int k) const;
  /// Rest length of edge k, m; the mean where two frames differ.
  double edge_length(Index face, int k) const;

  /// Distance within the surface between a vertex v[0] and the face v[1..3], or between the edges v[0..1] and v[2..3],
  /// which share no vertex, m. At least that of the unfolded faces between them; `most` if it is larger. With frames only.
  double distance(const std::array<int, 4>& v, bool edges, double most) const;

 private:
  struct Side {
    Index face = -1;
    int corner = 0;
    bool bends = false;
  };
  using Triangle = std::array<Vec2, 3>;
  struct Search;
  int corner_of(Index face, int vertex) const;
  Triangle unfolded(Index face, int k, const Triangle& place) const;
  void search(Search& search, Index face, const Triangle& place, Index from, int depth) const;

  Faces faces_;
  RestPositions rest_;
  RestFrames frames_;
  std::vector<Side> across_;                  // [3 F]
  std::vector<double> clear_;                 // [V] m: least height of the faces at the vertex; with frames
  std::vector<std::vector<Index>> faces_of_;  // [V]; with frames
};

/// A direction for the yarns of a garment whose frames come from a shape in space.
struct Grain {
  bool is_weft = false;  ///< the direction is that of the weft
  Vec3 direction{1.0, 0.0, 0.0};
};

/// The weft (the wales of a knit) runs up a garment that stands, and along y in one that lies.
WEFT_API Grain usual_grain(const Positions& positions);

/// Frames of a shape in space: every face with its own lengths times `scale`, its warp (or weft) along the direction as
/// the face sees it. A face that is square to the direction takes y, then x.
WEFT_API RestFrames frames_of_shape(const Positions& positions, const Faces& faces, const Grain& grain,
                                    double scale = 1.0);

/// The edges where a face that looks up, as drawn, meets one that looks down: the seams of a garment that lies flat.
WEFT_API Edges edges_between_sides(const Positions& positions, const Faces& faces);

/// |length / rest length - 1| of every edge in its faces' frames: the median.
WEFT_API double median_strain(const Garment& garment);

}  // namespace weft
