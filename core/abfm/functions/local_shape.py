"""What the surface is like at a vertex: curvature, and the thickness of the body below."""

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
# roundings that a curvature may be made of: in the file's text, in a motion, in the sums here
_NOISE = 4.0

_RAYS = 30
_HALF_ANGLE = np.pi / 3
# igl overlooks triangles below a fixed size: cast rays on the mesh scaled to an area of SIDE^2
_SIDE = 1e4
# cosine: faces at a right angle to the vertex's normal count on either side of rounding
_COSINE_ROUNDING = 1e-6
_LENGTH_ROUNDING = 1e-6  # of a length: edges that differ less are equally long
_START = 1e-6 * _SIDE  # where rays start, so that they do not meet the faces at their vertex
_CHUNK = 512  # vertices per call of igl, which keeps the GIL: about 20 ms


@dataclass(frozen=True, kw_only=True)
class Curvature(Family):
    """Gaussian curvature (1/length^2), or mean curvature (1/length, positive where the surface
    bulges outward).

    The formulas [Meyer, Desbrun, Schröder, Barr: Discrete Differential-Geometry Operators for
    Triangulated 2-Manifolds, 2003] hold off the boundary only: a boundary vertex gets the mean of
    its neighbours. Where the surface is flat up to the rounding of its coordinates they are 0.
    """

    family = "curvature"
    positional = "kind"
    example = "curvature:mean"
    kind: str = parameter(choice("gaussian", "mean"), "which curvature")

    def evaluate(self, mesh: TriangleMesh) -> FloatArray:
        inner = ~mesh.is_boundary_vertex
        if not inner.any():
            raise FunctionError(
                "curvature: every vertex lies on the boundary of this mesh, where it is not defined"
            )
        curvature = gaussian_curvature if self.kind == "gaussian" else mean_curvature
        return extend(mesh, curvature(mesh), inner)


def gaussian_curvature(mesh: TriangleMesh) -> FloatArray:
    """Compute the angle defect over mixed area (equation 9), (V,), in 1/length^2.

    Meaningless on a boundary. Moving an end of an edge of length ``a`` by the rounding ``r`` of the
    coordinates turns the edge by ``r / a``: what this makes of the angles at a vertex counts as 0.
    """
    inverse = 1 / side_lengths(mesh.vertices, mesh.faces)
    around = np.roll(inverse, 1, axis=1) + np.roll(inverse, -1, axis=1)
    turned = _rounding(mesh) * around + _EPSILON
    defect = 2 * np.pi - _at_vertices(mesh, igl.internal_angles(mesh.vertices, mesh.faces))
    return _without_noise(defect, _at_vertices(mesh, turned)) / mixed_areas(mesh)


def mean_curvature(mesh: TriangleMesh) -> FloatArray:
    """Compute half the Laplacian of the coordinates (equation 8) along the vertex normal, (V,).

    In 1/length, positive on a sphere with outward normals; meaningless on a boundary. A face adds
    half the edge opposite to the vertex, turned by a right angle: the rounding ``r`` of the
    coordinates moves the edge by ``r`` and turns the face by ``r`` over its least height, and a sum
    that is no larger than this is 0.
    """
    sizes = side_lengths(mesh.vertices, mesh.faces)
    heights = 2 * face_areas(mesh) / sizes.max(axis=1)
    moved = _rounding(mesh) * (1 + sizes / heights[:, None])
    bend = np.einsum("vx,vx->v", cotangent_laplacian(mesh) @ mesh.vertices, vertex_normals(mesh))
    return _without_noise(bend, _at_vertices(mesh, moved)) / (2 * mixed_areas(mesh))


def _at_vertices(mesh: TriangleMesh, of_corners: FloatArray) -> FloatArray:
    """Sum what each corner (F, 3) has, (V,)."""
    sums = np.bincount(mesh.faces.ravel(), of_corners.ravel(), len(mesh.vertices))
    return np.asarray(sums, dtype=np.float64)


def _rounding(mesh: TriangleMesh) -> float:
    """Return how far rounding moves a vertex."""
    return _EPSILON * float(np.abs(mesh.vertices).max())


def _without_noise(values: FloatArray, noise: FloatArray) -> FloatArray:
    return np.where(np.abs(values) <= _NOISE * noise, 0.0, values)


def mixed_areas(mesh: TriangleMesh) -> FloatArray:
    """Compute the Voronoi area of each vertex (section 3.3), or half or a quarter of obtuse faces.

    With a third of the adjacent faces, curvature stays 15% wrong at odd vertices of an icosphere.
    """
    voronoi = igl.massmatrix(mesh.vertices, mesh.faces, igl.MASSMATRIX_TYPE_VORONOI)
    return np.asarray(voronoi.diagonal())


def vertex_normals(mesh: TriangleMesh) -> FloatArray:
    """Compute unit normals at the vertices, (V, 3): of the sum of the faces' area vectors, or 0."""
    weighted = face_areas(mesh)[:, None] * face_normals(mesh)
    sums = np.stack([_at_vertices(mesh, np.repeat(w, 3)) for w in weighted.T], axis=1)
    return _unit(sums)


def _unit(vectors: FloatArray) -> FloatArray:
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.asarray(vectors / np.maximum(lengths, np.finfo(float).tiny))


@dataclass(frozen=True, kw_only=True)
class ShapeDiameter(Family):
    """Thickness of the body under each vertex (shape diameter function), in the mesh's units of
    length.

    The mean length of rays sent inward, as published [Shapira, Shamir, Cohen-Or: Consistent Mesh
    Partitioning and Skeletonisation Using the Shape Diameter Function, 2008, section 3]: 30 rays in
    a cone of 120 degrees about the inward normal; hits on a face whose normal is within 90 degrees
    of the vertex's are dropped; of the rest, the lengths within one standard deviation of their
    median are averaged with weights inverse to the angle from the axis. Here the rays are a fixed
    spiral, even in solid angle and turned to the longest edge at the vertex, or to each of several
    that are equally long, so the result is reproducible and moves with the mesh. Vertices from
    which no ray counts take the mean of their neighbours. Not smoothed, no logarithm. On a sphere
    of radius R it is 1.72 R. Needs a surface with an inside, its faces oriented outward.
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
    known = np.isfinite(diameter)
    if not known.any():
        raise FunctionError(
            "shape-diameter: no ray meets an opposite side: is the surface flat, or its faces "
            "inward?"
        )
    return extend(mesh, diameter * unit, known)


def _cone() -> tuple[FloatArray, FloatArray]:
    """Return the angles from the axis (r,) and unit vectors (r, 3) with the axis last."""
    # the half keeps rays off the plane of the longest edge, where edges may line up
    i = np.arange(_RAYS) + 0.5
    cosine = 1 - (1 - np.cos(_HALF_ANGLE)) * i / _RAYS
    sine, turn = np.sqrt(1 - cosine**2), np.pi * (3 - np.sqrt(5)) * i
    return np.arccos(cosine), np.stack([sine * np.cos(turn), sine * np.sin(turn), cosine], axis=1)


def _frames(mesh: TriangleMesh, normals: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return the vertices (n,), in order, with frames (n, 3, 3) for each of their longest edges.

    They are orthonormal, with the first axis along the edge, and the last one inward.
    """
    one, other = mesh.edges.T
    owners, ends = np.r_[one, other], np.r_[other, one]
    along = mesh.vertices[ends] - mesh.vertices[owners]
    lengths, longest = np.linalg.norm(along, axis=1), np.zeros(len(normals))
    np.maximum.at(longest, owners, lengths)
    kept = np.flatnonzero(lengths >= (1 - _LENGTH_ROUNDING) * longest[owners])
    kept = kept[np.argsort(owners[kept], kind="stable")]
    owners, along = owners[kept], along[kept]
    inward = -normals[owners]
    second = _unit(np.cross(inward, along))
    return owners, np.stack([np.cross(second, inward), second, inward], axis=1)


def _robust_mean(lengths: FloatArray, weights: FloatArray) -> FloatArray:
    """Compute the weighted mean of each row of (n, r) without NaN and outliers, (n,), or NaN."""
    mean = np.full(len(lengths), np.nan)
    seen = np.isfinite(lengths).any(axis=1)
    rows = lengths[seen]
    distance = np.abs(rows - np.nanmedian(rows, axis=1, keepdims=True))
    keep = distance <= (1 + 1e-9) * np.nanstd(rows, axis=1, keepdims=True)
    mean[seen] = np.where(keep, rows, 0) @ weights / (keep @ weights)
    return mean
