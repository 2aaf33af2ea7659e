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
from abfm.types import FloatArray

RAYS = 30
HALF_ANGLE = np.pi / 3
SIDE = 1e4  # igl overlooks triangles below a fixed size: cast rays on the mesh scaled to an area of SIDE^2
START = 1e-6 * SIDE  # where rays start, so that they do not meet the faces at their vertex
CHUNK = 512  # vertices per call of igl, which keeps the GIL: about 20 ms


@dataclass(frozen=True, kw_only=True)
class ShapeDiameter(Family):
    """Thickness of the body under each vertex (shape diameter function), in the mesh's units of length.

    See :func:`shape_diameter`. Needs a surface with an inside, its faces oriented outward.
    """

    family: ClassVar[str] = "shape-diameter"

    def evaluate(self, mesh: TriangleMesh) -> FloatArray:
        return shape_diameter(mesh)


@per_mesh
def shape_diameter(mesh: TriangleMesh) -> FloatArray:
    """Mean length of rays sent inward in a cone, (V,), in the mesh's units.

    As published: 30 rays in a cone of 120 degrees about the inward normal; hits on a face whose normal is within 90
    degrees of the vertex's are dropped; of the rest, the lengths within one standard deviation of their median are
    averaged with weights inverse to the angle from the axis. Here the rays are a fixed spiral, even in solid angle and
    turned to the longest edge at the vertex, so the result is reproducible and moves with the mesh. Vertices from which
    no ray counts take the mean of their neighbours. Not smoothed, no logarithm. On a sphere of radius R it is 1.72 R.

    Raises
    ------
    FunctionError
        If no ray from any vertex counts, as on a flat sheet.

    References
    ----------
    Shapira, Shamir, Cohen-Or: Consistent Mesh Partitioning and Skeletonisation Using the Shape Diameter Function, The
    Visual Computer 24, 2008, section 3.
    """
    angles, cone = _cone()
    normals = vertex_normals(mesh)
    frames = _frames(mesh, normals)
    vertices = mesh.vertices * (SIDE / mesh.length_scale)
    tree = igl.AABB()
    tree.init(vertices, mesh.faces)
    diameter = np.empty(len(normals))
    for start in range(0, len(normals), CHUNK):
        part = slice(start, start + CHUNK)
        rays = np.einsum("rk,vkx->vrx", cone, frames[part])
        origins = vertices[part, None] + START * rays
        hit, length, _ = tree.intersect_ray_first(vertices, mesh.faces, origins.reshape(-1, 3), rays.reshape(-1, 3))
        hit, length = hit.reshape(-1, RAYS), length.reshape(-1, RAYS) + START
        is_false = (hit < 0) | (np.einsum("vrx,vx->vr", face_normals(mesh)[hit], normals[part]) > 0)
        diameter[part] = _robust_mean(np.where(is_false, np.nan, length), 1 / angles)
    known = np.isfinite(diameter)
    if not known.any():
        raise FunctionError("shape-diameter: no ray meets an opposite side: is the surface flat, or its faces inward?")
    return extend(mesh, diameter * (mesh.length_scale / SIDE), known)


def _cone() -> tuple[FloatArray, FloatArray]:
    """Angles from the axis (RAYS,) and unit vectors (RAYS, 3) with the axis last."""
    i = np.arange(RAYS) + 0.5  # the half keeps rays off the plane of the longest edge, where edges may line up
    cosine = 1 - (1 - np.cos(HALF_ANGLE)) * i / RAYS
    sine, turn = np.sqrt(1 - cosine**2), np.pi * (3 - np.sqrt(5)) * i
    return np.arccos(cosine), np.stack([sine * np.cos(turn), sine * np.sin(turn), cosine], axis=1)


def _frames(mesh: TriangleMesh, normals: FloatArray) -> FloatArray:
    """Orthonormal frame at each vertex, (V, 3, 3): first axis along its longest edge, last axis inward."""
    vectors = mesh.vertices[mesh.edges[:, 1]] - mesh.vertices[mesh.edges[:, 0]]
    longest_last = np.argsort(np.linalg.norm(vectors, axis=1), kind="stable")
    outgoing = np.stack([vectors, -vectors], axis=1)[longest_last].reshape(-1, 3)
    along = np.empty_like(normals)
    along[mesh.edges[longest_last].ravel()] = outgoing  # of repeated indices the last one stays
    second = np.cross(along, normals)
    second /= np.maximum(np.linalg.norm(second, axis=1, keepdims=True), np.finfo(float).tiny)
    return np.stack([np.cross(normals, second), second, -normals], axis=1)


def _robust_mean(lengths: FloatArray, weights: FloatArray) -> FloatArray:
    """Weighted mean of each row of (n, r) without NaN and outliers, (n,); NaN where a row has nothing else."""
    mean = np.full(len(lengths), np.nan)
    seen = np.isfinite(lengths).any(axis=1)
    rows = lengths[seen]
    distance = np.abs(rows - np.nanmedian(rows, axis=1, keepdims=True))
    keep = distance <= (1 + 1e-9) * np.nanstd(rows, axis=1, keepdims=True)
    mean[seen] = np.where(keep, rows, 0) @ weights / (keep @ weights)
    return mean
