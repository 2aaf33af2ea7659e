"""Functions of the local shape: curvature, and the thickness of the body (shape diameter)."""

from dataclasses import dataclass

import igl
import numpy as np

from abfm.calculus.channels import extend
from abfm.calculus.operators import cotangent_laplacian, face_areas, face_normals
from abfm.errors import FunctionError
from abfm.functions.family import Family, choice, parameter
from abfm.mesh import TriangleMesh, per_mesh
from abfm.mesh.face_sizes import side_lengths
from abfm.types import FloatArray, IntArray

_EPSILON = float(np.finfo(np.float64).eps)
# number of rounding errors in a curvature: of the text of a file, of a motion, and of sums
_NOISE = 4.0

_RAYS = 30
_HALF_ANGLE = np.pi / 3
# igl misses triangles below a fixed size, so rays are cast on the mesh scaled to an area of SIDE^2
_SIDE = 1e4
# tolerance of a cosine, so that rounding does not decide about faces orthogonal to the normal
_COSINE_ROUNDING = 1e-6
_LENGTH_ROUNDING = 1e-6  # relative difference of lengths up to which edges are equally long
_START = 1e-6 * _SIDE  # offset of rays, so that they do not hit the faces at their vertex
_CHUNK = 512  # vertices in one call of igl, which holds the GIL for about 20 ms


@dataclass(frozen=True, kw_only=True)
class Curvature(Family):
    """Gaussian curvature (1/length^2) or mean curvature (1/length) of the surface.

    Mean curvature is positive where the surface is convex. The formulas [Meyer, Desbrun, Schröder,
    Barr: Discrete Differential-Geometry Operators for Triangulated 2-Manifolds, 2003] are only
    valid for inner vertices. Boundary vertices get the mean of their neighbours. The curvature is 0
    where the surface is flat up to rounding of its coordinates.
    """

    family = "curvature"
    positional = "kind"
    example = "curvature:mean"
    kind: str = parameter(choice("gaussian", "mean"), "kind of curvature")

    def evaluate(self, mesh: TriangleMesh) -> FloatArray:
        inner = ~mesh.is_boundary_vertex
        if not inner.any():
            raise FunctionError(
                "curvature: all vertices lie on the boundary of the mesh, where it is not "
                "defined. Use a mesh with inner vertices"
            )
        curvature = gaussian_curvature if self.kind == "gaussian" else mean_curvature
        return extend(mesh, curvature(mesh), inner)


def gaussian_curvature(mesh: TriangleMesh) -> FloatArray:
    """Return the Gaussian curvature at the vertices, (V,), in 1/length^2.

    It is the angle defect over the mixed area (equation 9 of the paper cited by `Curvature`), which
    is not valid on a boundary. A rounding error ``r`` of the coordinates turns an edge of length
    ``a`` by an angle ``r / a``. Angle defects up to the sum of these angles are set to 0.
    """
    inverse = 1 / side_lengths(mesh.vertices, mesh.faces)
    around = np.roll(inverse, 1, axis=1) + np.roll(inverse, -1, axis=1)
    turned = _rounding(mesh) * around + _EPSILON
    defect = 2 * np.pi - _at_vertices(mesh, igl.internal_angles(mesh.vertices, mesh.faces))
    return _without_noise(defect, _at_vertices(mesh, turned)) / mixed_areas(mesh)


def mean_curvature(mesh: TriangleMesh) -> FloatArray:
    """Return the mean curvature at the vertices, (V,), in 1/length.

    It is half the Laplacian of the coordinates along the vertex normal (equation 8 of the paper
    cited by `Curvature`). It is positive on a sphere with outward normals, and not valid on a
    boundary. A face adds half the edge opposite to the vertex, rotated by a right angle. A rounding
    error ``r`` of the coordinates moves the edge by ``r``, and rotates the face by ``r`` over its
    smallest height. Values up to the sum of these errors are set to 0.
    """
    sizes = side_lengths(mesh.vertices, mesh.faces)
    heights = 2 * face_areas(mesh) / sizes.max(axis=1)
    moved = _rounding(mesh) * (1 + sizes / heights[:, None])
    bend = np.einsum("vx,vx->v", cotangent_laplacian(mesh) @ mesh.vertices, vertex_normals(mesh))
    return _without_noise(bend, _at_vertices(mesh, moved)) / (2 * mixed_areas(mesh))


def _at_vertices(mesh: TriangleMesh, of_corners: FloatArray) -> FloatArray:
    sums = np.bincount(mesh.faces.ravel(), of_corners.ravel(), len(mesh.vertices))
    return np.asarray(sums, dtype=np.float64)


def _rounding(mesh: TriangleMesh) -> float:
    return _EPSILON * float(np.abs(mesh.vertices).max())


def _without_noise(values: FloatArray, noise: FloatArray) -> FloatArray:
    return np.where(np.abs(values) <= _NOISE * noise, 0.0, values)


def mixed_areas(mesh: TriangleMesh) -> FloatArray:
    """Return the mixed area of each vertex, (V,) (section 3.3 of the paper cited by `Curvature`).

    The mixed area is the Voronoi area, except in obtuse faces. Of these, a vertex gets a half or a
    quarter. With a third of the adjacent faces instead, curvature would be wrong by 15% at
    irregular vertices of an icosphere.
    """
    voronoi = igl.massmatrix(mesh.vertices, mesh.faces, igl.MASSMATRIX_TYPE_VORONOI)
    return np.asarray(voronoi.diagonal())


def vertex_normals(mesh: TriangleMesh) -> FloatArray:
    """Return unit normals at the vertices, (V, 3), weighted by face areas; 0 if undefined."""
    weighted = face_areas(mesh)[:, None] * face_normals(mesh)
    sums = np.stack([_at_vertices(mesh, np.repeat(w, 3)) for w in weighted.T], axis=1)
    return _unit(sums)


def _unit(vectors: FloatArray) -> FloatArray:
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.asarray(vectors / np.maximum(lengths, np.finfo(float).tiny))


@dataclass(frozen=True, kw_only=True)
class ShapeDiameter(Family):
    """Thickness of the body under each vertex (shape diameter function), in units of length.

    The thickness is the mean length of rays sent inward, without smoothing and without logarithm.
    The surface must enclose a body, with faces oriented outward. Reference: section 3 of Shapira,
    Shamir, Cohen-Or: Consistent Mesh Partitioning and Skeletonisation Using the Shape Diameter
    Function, 2008.

    - 30 rays lie in a cone of 120 degrees about the inward normal.
    - Hits of a face whose normal is within 90 degrees of that of the vertex are ignored.
    - Lengths within one standard deviation of their median are averaged, with weights inverse to
      the angle from the axis.
    - Vertices without a valid ray get the mean of their neighbours.

    The rays are a fixed spiral, even in solid angle. It is oriented along the longest edge at the
    vertex, or along each of several equally long ones. The result is thus reproducible, and
    invariant to motions of the mesh. On a sphere of radius R the diameter is 1.72 R.
    """

    family = "shape-diameter"

    def evaluate(self, mesh: TriangleMesh) -> FloatArray:
        return _shape_diameter(mesh)


@per_mesh
def _shape_diameter(mesh: TriangleMesh) -> FloatArray:
    normals, unit = vertex_normals(mesh), mesh.length_scale / _SIDE
    origins, frames = _frames(mesh, normals)
    angles, cone = _cone()
    vertices = mesh.vertices / unit
    tree = igl.AABB()
    tree.init(vertices, mesh.faces)
    lengths = np.empty((len(origins), _RAYS))
    for start in range(0, len(origins), _CHUNK):
        part = slice(start, start + _CHUNK)
        rays = np.einsum("rk,nkx->nrx", cone, frames[part])
        starts = vertices[origins[part], None] + _START * rays
        hit, length, _ = tree.intersect_ray_first(
            vertices, mesh.faces, starts.reshape(-1, 3), rays.reshape(-1, 3)
        )
        hit, length = hit.reshape(-1, _RAYS), length.reshape(-1, _RAYS) + _START
        sides = np.einsum("nrx,nx->nr", face_normals(mesh)[hit], normals[origins[part]])
        lengths[part] = np.where((hit < 0) | (sides > _COSINE_ROUNDING), np.nan, length)
    diameter, turns = np.empty(len(normals)), np.bincount(origins)
    for count in np.unique(turns):
        rows = lengths[turns[origins] == count].reshape(-1, count * _RAYS)
        diameter[turns == count] = _robust_mean(rows, np.tile(1 / angles, count))
    is_valid = np.isfinite(diameter)
    if not is_valid.any():
        raise FunctionError(
            "shape-diameter: no ray hits an opposite side of the surface; expected a closed "
            "surface with faces oriented outward"
        )
    return extend(mesh, diameter * unit, is_valid)


def _cone() -> tuple[FloatArray, FloatArray]:
    """Return the rays in a cone about the last axis: their angles (r,), and unit vectors (r, 3)."""
    # the offset of a half avoids rays in the plane of the longest edge, where edges may be aligned
    i = np.arange(_RAYS) + 0.5
    cosine = 1 - (1 - np.cos(_HALF_ANGLE)) * i / _RAYS
    sine, turn = np.sqrt(1 - cosine**2), np.pi * (3 - np.sqrt(5)) * i
    return np.arccos(cosine), np.stack([sine * np.cos(turn), sine * np.sin(turn), cosine], axis=1)


def _frames(mesh: TriangleMesh, normals: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return the vertices (n,) of the longest edges, and orthonormal axes (n, 3, 3) at each.

    A vertex occurs once for each of its longest edges, in ascending order. The first axis is along
    the edge, and the last one points inward.
    """
    one, other = mesh.edges.T
    owners, ends = np.r_[one, other], np.r_[other, one]
    along = mesh.vertices[ends] - mesh.vertices[owners]
    lengths, longest = np.linalg.norm(along, axis=1), np.zeros(len(normals))
    np.maximum.at(longest, owners, lengths)
    chosen = np.flatnonzero(lengths >= (1 - _LENGTH_ROUNDING) * longest[owners])
    chosen = chosen[np.argsort(owners[chosen], kind="stable")]
    owners, along = owners[chosen], along[chosen]
    inward = -normals[owners]
    second = _unit(np.cross(inward, along))
    return owners, np.stack([np.cross(second, inward), second, inward], axis=1)


def _robust_mean(lengths: FloatArray, weights: FloatArray) -> FloatArray:
    """Return the weighted mean of each row of (n, r), (n,), without NaN and outliers.

    Outliers are beyond one standard deviation from the median. A row of NaN has the mean NaN.
    """
    mean = np.full(len(lengths), np.nan)
    has_values = np.isfinite(lengths).any(axis=1)
    rows = lengths[has_values]
    distance = np.abs(rows - np.nanmedian(rows, axis=1, keepdims=True))
    is_inlier = distance <= (1 + 1e-9) * np.nanstd(rows, axis=1, keepdims=True)
    mean[has_values] = np.where(is_inlier, rows, 0) @ weights / (is_inlier @ weights)
    return mean
