"""Fields that experiments are given, and functions for the app to carry along them."""

from __future__ import annotations

from typing import TypedDict

import numpy as np

from abfm.calculus.eigenbasis import eigenbasis
from abfm.calculus.helmholtz_hodge import helmholtz_hodge
from abfm.calculus.operators import averaging, face_areas, gradient, rotation
from abfm.calculus.vector_fields import to_ambient, to_frame
from abfm.errors import MeshError
from abfm.flow.flow import Flow
from abfm.functions import function
from abfm.mesh import TriangleMesh
from abfm.parameters import Parameters
from abfm.types import FloatArray


class Carried(TypedDict):
    """What a `Setup` needs to show a function on its way along a field."""

    sources: tuple[str, ...]
    targets: tuple[str, ...]
    values: dict[str, FloatArray]
    parameters: Parameters
    velocity: FloatArray


def carried_bump(mesh: TriangleMesh, field: FloatArray) -> Carried:
    """A Gaussian where a field (F, 3) is fastest, and what the field makes of it in a unit of time."""
    fastest = int(np.argmax(averaging(mesh) @ np.linalg.norm(field, axis=1)))
    source, parameters = f"gaussian:vertex={mesh.vertex_ids[fastest]},width=0.1", Parameters(tau=1.0)
    target = Flow(mesh, field).push(function(mesh, source), 1.0)
    return Carried(
        sources=(source,),
        targets=("file:carried.npy",),
        values={"file:carried.npy": target},
        parameters=parameters,
        velocity=field[None],
    )


def with_speed(mesh: TriangleMesh, field: FloatArray, speed: float) -> FloatArray:
    """The field (F, 3), scaled so that its root mean square is a multiple of sqrt(area) per unit of time."""
    areas = face_areas(mesh)
    factor: float = areas.sum() * speed / np.sqrt(areas @ (field**2).sum(axis=1))
    return factor * field


def stirring(mesh: TriangleMesh, index: int) -> FloatArray:
    """The turned gradient of an eigenfunction of the Laplacian, less what crosses the boundary, (F, 3).

    Raises
    ------
    MeshError
        If the mesh is too coarse to have one.
    """
    if len(mesh.vertices) <= index:
        raise MeshError(f"the mesh has {len(mesh.vertices)} vertices; expected more than {index}, for its own fields")
    eigenfunction = eigenbasis(mesh, index + 1)[1][:, index]
    field = to_ambient(mesh, (rotation(mesh) @ (gradient(mesh) @ eigenfunction)).reshape(-1, 2))
    across, along, harmonic = helmholtz_hodge(mesh, field)
    if np.linalg.norm(along + harmonic) <= 1e-9 * np.linalg.norm(across):
        raise MeshError("no field flows inside this mesh, all of whose vertices lie on its boundary: refine it")
    return along + harmonic


def tangent(mesh: TriangleMesh, vectors: FloatArray) -> FloatArray:
    """Vectors at the face centres (F, 3) without their normal part."""
    return to_ambient(mesh, to_frame(mesh, vectors))


def centres(mesh: TriangleMesh) -> FloatArray:
    """Face centres, (F, 3)."""
    middle: FloatArray = mesh.vertices[mesh.faces].mean(axis=1)
    return middle


def relative_error(mesh: TriangleMesh, found: FloatArray, exact: FloatArray) -> float:
    """L2 norm of the difference of two fields (F, 3) over that of the second."""
    return relative_norm(mesh, found - exact, exact)


def relative_norm(mesh: TriangleMesh, field: FloatArray, other: FloatArray) -> float:
    """L2 norm of a field (F, 3) over that of another."""
    areas = face_areas(mesh)
    return float(np.sqrt(areas @ (field**2).sum(axis=1) / (areas @ (other**2).sum(axis=1))))
