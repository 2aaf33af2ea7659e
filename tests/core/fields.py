"""Fields and functions that the solver's tests share."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from abfm.calculus.operators import face_normals
from abfm.mesh import TriangleMesh
from abfm.types import FloatArray


def rotation_field(mesh: TriangleMesh, axis: ArrayLike) -> FloatArray:
    """Velocity (F, 3) of the rotation with angular velocity ``axis``, at face centres."""
    return tangent(
        mesh, np.cross(np.asarray(axis, dtype=float), mesh.vertices[mesh.faces].mean(axis=1))
    )


def wavy_field(mesh: TriangleMesh, seed: int) -> FloatArray:
    """A smooth tangent field (F, 3) without symmetry, of maximum norm ``length_scale``."""
    rng = np.random.default_rng(seed)
    centres = mesh.vertices[mesh.faces].mean(axis=1) / mesh.length_scale
    field = tangent(mesh, np.sin(4 * centres @ rng.normal(size=(3, 3)) + rng.normal(size=3)))
    return field * (mesh.length_scale / np.linalg.norm(field, axis=1).max())


def tangent(mesh: TriangleMesh, field: FloatArray) -> FloatArray:
    """Tangential part of vectors at faces, (F, 3)."""
    normals = face_normals(mesh)
    return field - np.einsum("fx,fx->f", field, normals)[:, None] * normals


def bump(mesh: TriangleMesh, centre: ArrayLike, width: float = 0.1) -> FloatArray:
    """Gaussian of the distance in space, ``width`` in units of ``length_scale``, (V,)."""
    squared = ((mesh.vertices - np.asarray(centre, dtype=float)) ** 2).sum(axis=1)
    return np.exp(-squared / (2 * (width * mesh.length_scale) ** 2))
