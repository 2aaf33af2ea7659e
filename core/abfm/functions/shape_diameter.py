"""Shape diameter function."""

from dataclasses import dataclass
from typing import ClassVar

import igl
import numpy as np

from abfm.calculus.extension import extend
from abfm.calculus.operators import face_normals
from abfm.errors import FunctionError
from abfm.functions.curvature import vertex_normals
from abfm.functions.family import Family
from abfm.mesh import TriangleMesh, per_mesh
from abfm.types import FloatArray, IntArray

RAYS = 30
HALF_ANGLE = np.pi / 3
# igl overlooks triangles below a fixed size: cast rays on the mesh scaled to an area of SIDE^2
SIDE = 1e4
# cosine: faces at a right angle to the vertex's normal count on either side of rounding
UPRIGHT = 1e-6
ALIKE = 1e-6  # of a length: edges that differ less are equally long
START = 1e-6 * SIDE  # where rays start, so that they do not meet the faces at their vertex
CHUNK = 512  # vertices per call of igl, which keeps the GIL: about 20 ms


@dataclass(frozen=True, kw_only=True)
class ShapeDiameter(Family):
    """Thickness of the body under each vertex (shape diameter function), in the mesh's units of
    length.

    See :func:`shape_diameter`. Needs a surface with an inside, its faces oriented outward.
    """

    family: ClassVar[str] = "shape-diameter"

    def evaluate(self, mesh: TriangleMesh) -> FloatArray:
        return shape_diameter(mesh)


@per_mesh
def shape_diameter(mesh: TriangleMesh) -> FloatArray:
    """Compute the mean length of rays sent inward in a cone, (V,), in the mesh's units.

    As published: 30 rays in a cone of 120 degrees about the inward normal; hits on a face whose
    normal is within 90 degrees of the vertex's are dropped; of the rest, the lengths within one
    standard deviation of their median are averaged with weights inverse to the angle from the axis.
    Here the rays are a fixed spiral, even in solid angle and turned to the longest edge at the
    vertex, or to each of several that are equally long, so the result is reproducible and moves
    with the mesh. Vertices from which no ray counts take the mean of their neighbours. Not
    smoothed, no logarithm. On a sphere of radius R it is 1.72 R.

    Raises
    ------
    FunctionError
        If no ray from any vertex counts, as on a flat sheet.

    References
    ----------
    Shapira, Shamir, Cohen-Or: Consistent Mesh Partitioning and Skeletonisation Using the Shape
    Diameter Function, The Visual Computer 24, 2008, section 3.
    """
    normals, unit = vertex_normals(mesh), mesh.length_scale / SIDE
    origins, frames = _frames(mesh, normals)
    angles, cone = _cone()
    vertices = mesh.vertices / unit
    tree = igl.AABB()
    tree.init(vertices, mesh.faces)
    lengths = np.empty((len(origins), RAYS))
    for start in range(0, len(origins), CHUNK):
        part = slice(start, start + CHUNK)
        rays = np.einsum("rk,nkx->nrx", cone, frames[part])
        starts = vertices[origins[part], None] + START * rays
        hit, length, _ = tree.intersect_ray_first(
            vertices, mesh.faces, starts.reshape(-1, 3), rays.reshape(-1, 3)
        )
        hit, length = hit.reshape(-1, RAYS), length.reshape(-1, RAYS) + START
        sides = np.einsum("nrx,nx->nr", face_normals(mesh)[hit], normals[origins[part]])
        lengths[part] = np.where((hit < 0) | (sides > UPRIGHT), np.nan, length)
    diameter, turns = np.empty(len(normals)), np.bincount(origins)
    for count in np.unique(turns):
        rows = lengths[turns[origins] == count].reshape(-1, count * RAYS)
        diameter[turns == count] = _robust_mean(rows, np.tile(1 / angles, count))
    known = np.isfinite(diameter)
    if not known.any():
        raise FunctionError(
            "shape-diameter: no ray meets an opposite side: is the surface flat, or its faces "
            "inward?"
        )
    return extend(mesh, diameter * unit, known)


def _cone() -> tuple[FloatArray, FloatArray]:
    """Return the angles from the axis (RAYS,) and unit vectors (RAYS, 3) with the axis last."""
    # the half keeps rays off the plane of the longest edge, where edges may line up
    i = np.arange(RAYS) + 0.5
    cosine = 1 - (1 - np.cos(HALF_ANGLE)) * i / RAYS
    sine, turn = np.sqrt(1 - cosine**2), np.pi * (3 - np.sqrt(5)) * i
    return np.arccos(cosine), np.stack([sine * np.cos(turn), sine * np.sin(turn), cosine], axis=1)


def _frames(mesh: TriangleMesh, normals: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return the vertices (n,), in order, with orthonormal frames (n, 3, 3): first axis along an
    edge, last axis inward.

    Every vertex has one for its longest edge, or for each of those that are equally long.
    """
    one, other = mesh.edges.T
    owners, ends = np.r_[one, other], np.r_[other, one]
    along = mesh.vertices[ends] - mesh.vertices[owners]
    lengths, longest = np.linalg.norm(along, axis=1), np.zeros(len(normals))
    np.maximum.at(longest, owners, lengths)
    kept = np.flatnonzero(lengths >= (1 - ALIKE) * longest[owners])
    kept = kept[np.argsort(owners[kept], kind="stable")]
    owners, along = owners[kept], along[kept]
    inward = -normals[owners]
    second = np.cross(inward, along)
    second /= np.maximum(np.linalg.norm(second, axis=1, keepdims=True), np.finfo(float).tiny)
    return owners, np.stack([np.cross(second, inward), second, inward], axis=1)


def _robust_mean(lengths: FloatArray, weights: FloatArray) -> FloatArray:
    """Compute the weighted mean of each row of (n, r) without NaN and outliers, (n,); NaN where a
    row has nothing else.
    """
    mean = np.full(len(lengths), np.nan)
    seen = np.isfinite(lengths).any(axis=1)
    rows = lengths[seen]
    distance = np.abs(rows - np.nanmedian(rows, axis=1, keepdims=True))
    keep = distance <= (1 + 1e-9) * np.nanstd(rows, axis=1, keepdims=True)
    mean[seen] = np.where(keep, rows, 0) @ weights / (keep @ weights)
    return mean
