"""Given fields, smooth ones on any mesh: what their flows carry, where their flow lines lead."""

from collections.abc import Mapping

import numpy as np

from abfm import Flow, MeshError, TriangleMesh
from abfm.calculus import (
    averaging,
    eigenbasis,
    face_areas,
    gradient,
    helmholtz_hodge,
    l2_norm,
    to_ambient,
    to_frame,
)
from abfm.calculus.operators import rotation
from abfm.experiments.vocabulary import Example, carried_example
from abfm.flow import flow_lines
from abfm.maps import project_onto_surface
from abfm.types import FloatArray


def field_example(mesh: TriangleMesh, v: FloatArray, name: str) -> Example:
    """Return a Gaussian where a field (F, 3) is fastest, which it carries for a unit of time."""
    fastest = mesh.vertex_ids[np.argmax(speed(mesh, v))]
    source = f"gaussian:vertex={fastest},width=0.1"
    return carried_example(Flow(mesh, v), name, source, "file:carried.npy")


def stream_field(mesh: TriangleMesh, modes: Mapping[int, float], speed: float) -> FloatArray:
    """Return a smooth field without divergence, (F, 3): the rotated gradient of eigenfunctions.

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
    field = turned_gradient(mesh, basis[:, list(modes)] @ np.array(list(modes.values())))
    if not mesh.is_closed:
        whole = np.linalg.norm(field)
        field = helmholtz_hodge(mesh, field)[1]
        if np.linalg.norm(field) <= 1e-9 * whole:
            raise MeshError(
                "no smooth field without divergence flows inside this mesh: refine it, above all "
                "inside"
            )
    return field * (speed * mesh.length_scale / root_mean_square(mesh, field))


def stirring(mesh: TriangleMesh, index: int) -> FloatArray:
    """Return the turned gradient of an eigenfunction of the Laplacian, (F, 3), less what crosses
    the boundary.

    Raises
    ------
    MeshError
        If the mesh is too coarse to have one.
    """
    if len(mesh.vertices) <= index:
        raise MeshError(
            f"the mesh has {len(mesh.vertices)} vertices; expected more than {index}, for its own "
            "fields"
        )
    eigenfunction = eigenbasis(mesh, index + 1)[1][:, index]
    across, along, harmonic = helmholtz_hodge(mesh, turned_gradient(mesh, eigenfunction))
    if np.linalg.norm(along + harmonic) <= 1e-9 * np.linalg.norm(across):
        raise MeshError(
            "no field flows inside this mesh, all of whose vertices lie on its boundary: refine it"
        )
    return along + harmonic


def slopes(mesh: TriangleMesh, f: FloatArray) -> FloatArray:
    """Return the gradient of a function (V,), (F, 3)."""
    return to_ambient(mesh, (gradient(mesh) @ f).reshape(-1, 2))


def turned_gradient(mesh: TriangleMesh, f: FloatArray) -> FloatArray:
    """Return the gradient of a function (V,), turned by 90 degrees in every face, (F, 3)."""
    return to_ambient(mesh, (rotation(mesh) @ gradient(mesh) @ f).reshape(-1, 2))


def with_speed(mesh: TriangleMesh, field: FloatArray, speed: float) -> FloatArray:
    """Scale a field (F, 3) to a root mean square in sqrt(area) per unit of time."""
    areas = face_areas(mesh)
    factor = float(areas.sum() * speed / np.sqrt(areas @ (field**2).sum(axis=1)))
    return factor * field


def tangent(mesh: TriangleMesh, vectors: FloatArray) -> FloatArray:
    """Return vectors at the face centres (F, 3) without their normal part."""
    return to_ambient(mesh, to_frame(mesh, vectors))


def centres(mesh: TriangleMesh) -> FloatArray:
    """Return the face centres, (F, 3)."""
    return np.asarray(mesh.vertices[mesh.faces].mean(axis=1))


def speed(mesh: TriangleMesh, field: FloatArray) -> FloatArray:
    """Return the length of a field (F, 3) at the vertices, (V,)."""
    return np.asarray(averaging(mesh) @ np.linalg.norm(field, axis=1))


def root_mean_square(mesh: TriangleMesh, values: FloatArray) -> float:
    """Average one or several values per face, (F,) or (F, n), over the surface."""
    squares = (values.reshape(len(values), -1) ** 2).sum(axis=1)
    return float(np.sqrt(np.average(squares, weights=face_areas(mesh))))


def relative_norm(mesh: TriangleMesh, field: FloatArray, other: FloatArray) -> float:
    """Return the L2 norm of a field (F, 3) over that of another."""
    areas = face_areas(mesh)
    return float(np.sqrt(areas @ (field**2).sum(axis=1) / (areas @ (other**2).sum(axis=1))))


def relative_difference(mesh: TriangleMesh, f: FloatArray, g: FloatArray) -> float:
    """Return the L2 norm of ``f - g`` over that of ``g``, of functions (V,)."""
    return l2_norm(mesh, f - g) / l2_norm(mesh, g)


def feet(mesh: TriangleMesh, velocity: FloatArray, times: FloatArray) -> FloatArray:
    """Follow the flow lines of a field (F, 3) through the vertices back to times before, none of
    them negative (T,): the places there, (T, V, 3).
    """
    lines = flow_lines(
        mesh, velocity, project_onto_surface(mesh, mesh.vertices), -float(times.max())
    )
    return np.array([[line.at(-t) for line in lines] for t in times])


def carried(mesh: TriangleMesh, places: FloatArray, f: FloatArray) -> FloatArray:
    """Return the values of ``f`` (V,) at places (T, V, 3), as flow lines bring them to the
    vertices, (T, V).
    """
    return np.array([project_onto_surface(mesh, points).pull_back(f) for points in places])
