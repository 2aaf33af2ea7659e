"""Fields and functions for tests of the solver."""

import numpy as np

from abfm.calculus.operators import face_normals


def rotation_field(mesh, axis):
    """Return the velocity (F, 3) of a rotation with angular velocity ``axis``."""
    centres = mesh.vertices[mesh.faces].mean(axis=1)
    return tangent(mesh, np.cross(np.asarray(axis, dtype=float), centres))


def wavy_field(mesh, seed):
    """Return a smooth tangent field (F, 3) without symmetry, of norm at most ``length_scale``."""
    rng = np.random.default_rng(seed)
    centres = mesh.vertices[mesh.faces].mean(axis=1) / mesh.length_scale
    field = tangent(mesh, np.sin(4 * centres @ rng.normal(size=(3, 3)) + rng.normal(size=3)))
    return field * (mesh.length_scale / np.linalg.norm(field, axis=1).max())


def tangent(mesh, field):
    """Return the tangential part of vectors at faces, (F, 3)."""
    normals = face_normals(mesh)
    return field - np.einsum("fx,fx->f", field, normals)[:, None] * normals


def bump(mesh, centre, width=0.1):
    """Return a Gaussian of the Euclidean distance to a centre, (V,); its width is in sqrt(area)."""
    squared = ((mesh.vertices - np.asarray(centre, dtype=float)) ** 2).sum(axis=1)
    return np.exp(-squared / (2 * (width * mesh.length_scale) ** 2))
