"""Flows of given fields: smooth fields on any mesh, and where their flow lines lead."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from abfm.calculus.eigenbasis import eigenbasis
from abfm.calculus.helmholtz_hodge import helmholtz_hodge
from abfm.calculus.operators import face_areas, gradient, rotation
from abfm.calculus.vector_fields import to_ambient
from abfm.errors import MeshError
from abfm.flow.flow_lines import flow_lines
from abfm.maps.surface_points import project_onto_surface, pull_back
from abfm.mesh import TriangleMesh
from abfm.types import FloatArray


def stream_field(mesh: TriangleMesh, modes: Mapping[int, float], speed: float) -> FloatArray:
    """A smooth field without divergence, (F, 3): the rotated gradient of some eigenfunctions.

    On a boundary it is tangent to it, so that the flow stays on the surface.

    Parameters
    ----------
    modes : mapping of int to float
        Weights of the eigenfunctions, each scaled to unit L2 norm on the mesh of unit area.
    speed : float
        Root mean square of the field's norm, in sqrt(area) per unit of time.

    Raises
    ------
    MeshError
        If the mesh is too coarse: nothing is left inside its boundary.
    """
    basis = eigenbasis(mesh.normalized(), max(modes) + 1)[1]
    stream = basis[:, list(modes)] @ np.array(list(modes.values()))
    field = to_ambient(mesh, (rotation(mesh) @ gradient(mesh) @ stream).reshape(-1, 2))
    if not mesh.is_closed:
        whole = np.linalg.norm(field)
        field = helmholtz_hodge(mesh, field)[1]
        if np.linalg.norm(field) <= 1e-9 * whole:
            raise MeshError("no smooth field without divergence flows inside this mesh: refine it, above all inside")
    return field * (speed * mesh.length_scale / root_mean_square(mesh, field))


def root_mean_square(mesh: TriangleMesh, values: FloatArray) -> float:
    """Root mean square over the surface, of one or several values per face, (F,) or (F, n)."""
    squares = (values.reshape(len(values), -1) ** 2).sum(axis=1)
    return float(np.sqrt(np.average(squares, weights=face_areas(mesh))))


def feet(mesh: TriangleMesh, velocity: FloatArray, times: FloatArray) -> FloatArray:
    """Where the flow lines through the vertices come from: places at times before, (T, V, 3).

    Parameters
    ----------
    velocity : (F, 3) array
    times : (T,) array
        How long before, not negative.
    """
    lines = flow_lines(mesh, velocity, project_onto_surface(mesh, mesh.vertices), -float(times.max()))
    return np.array([[line.at(-t) for line in lines] for t in times])


def carried(mesh: TriangleMesh, places: FloatArray, f: FloatArray) -> FloatArray:
    """Values of ``f`` (V,) at places on the surface (T, V, 3), as flow lines bring them to the vertices, (T, V)."""
    return np.array([pull_back(mesh, project_onto_surface(mesh, points), f) for points in places])
