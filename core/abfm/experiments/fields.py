"""Given fields, smooth ones on any mesh: what their flows carry, where their flow lines lead."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from abfm import Flow, MeshError, TriangleMesh, calculus
from abfm.calculus import face_areas, l2_norm, to_frame
from abfm.calculus.operators import rotation
from abfm.experiments.vocabulary import Example, carried_example, gaussian, sized
from abfm.flow import flow_lines
from abfm.io.sheets import Streaks
from abfm.maps import project_onto_surface
from abfm.mesh.shapes import torus
from abfm.types import FloatArray


@dataclass(frozen=True, eq=False)
class Case:
    """A surface, one of several of the same name, with a field (F, 3)."""

    name: str
    mesh: TriangleMesh
    v: FloatArray


def refined(levels: Sequence[Case]) -> str:
    """Return a surface in words, coarse to fine."""
    return sized(levels[-1].name, *(level.mesh for level in levels))


def field_example(case: Case, name: str) -> Example:
    """Return a Gaussian where a field is fastest, which it carries for a unit of time."""
    fastest = int(np.argmax(speed(case.mesh, case.v)))
    source = gaussian(case.mesh, fastest, 0.1)
    return carried_example(Flow(case.mesh, case.v), name, source, "file:carried.npy")


def stream_field(mesh: TriangleMesh, modes: Mapping[int, float], speed: float) -> FloatArray:
    """Return a smooth field (F, 3) without divergence, tangent to a boundary, by its RMS speed."""
    basis = calculus.unit_eigenbasis(mesh, max(modes) + 1)[1]
    field = slopes(mesh, basis[:, list(modes)] @ np.array(list(modes.values())), turned=True)
    if not mesh.is_closed:
        whole = np.linalg.norm(field)
        field = calculus.helmholtz_hodge(mesh, field)[1]
        if np.linalg.norm(field) <= 1e-9 * whole:
            raise MeshError(
                "no smooth field without divergence flows inside this mesh: refine it, above all "
                "inside"
            )
    return field * (speed * mesh.length_scale / root_mean_square(mesh, field))


def stirring(mesh: TriangleMesh, index: int, speed: float) -> FloatArray:
    """Return an eigenfunction's turned gradient (F, 3), `with_speed`, less what leaves the mesh."""
    if len(mesh.vertices) <= index:
        raise MeshError(
            f"the mesh has {len(mesh.vertices)} vertices; expected more than {index}, for its own "
            "fields"
        )
    turned = slopes(mesh, calculus.eigenbasis(mesh, index + 1)[1][:, index], turned=True)
    across, along, harmonic = calculus.helmholtz_hodge(mesh, turned)
    if np.linalg.norm(along + harmonic) <= 1e-9 * np.linalg.norm(across):
        raise MeshError(
            "no field flows inside this mesh, all of whose vertices lie on its boundary: refine it"
        )
    return with_speed(mesh, along + harmonic, speed)


def slopes(mesh: TriangleMesh, f: FloatArray, turned: bool = False) -> FloatArray:
    """Return the gradient of a function (V,), (F, 3), turned by 90 degrees if wanted."""
    operator = rotation(mesh) @ calculus.gradient(mesh) if turned else calculus.gradient(mesh)
    return calculus.to_ambient(mesh, (operator @ f).reshape(-1, 2))


def with_speed(mesh: TriangleMesh, field: FloatArray, speed: float) -> FloatArray:
    """Scale a field (F, 3) to a root mean square in sqrt(area) per unit of time."""
    areas = face_areas(mesh)
    return float(areas.sum() * speed / np.sqrt(areas @ (field**2).sum(axis=1))) * field


def tangent(mesh: TriangleMesh, vectors: FloatArray) -> FloatArray:
    """Return vectors at the face centres (F, 3) without their normal part."""
    return calculus.to_ambient(mesh, to_frame(mesh, vectors))


def centres(mesh: TriangleMesh) -> FloatArray:
    """Return the face centres, (F, 3)."""
    return np.asarray(mesh.vertices[mesh.faces].mean(axis=1))


def angular_torus(n: int) -> tuple[TriangleMesh, FloatArray, FloatArray, FloatArray]:
    """Return a torus, distances from its axis and both angles' fields at the face centres."""
    mesh = torus(n, n // 2)
    x, y, z = centres(mesh).T
    ring = np.hypot(x, z)
    by_about = np.stack([z, np.zeros_like(z), -x], axis=1)
    return mesh, ring, by_about, np.stack([-y * x / ring, ring - 1, -y * z / ring], axis=1)


def speed(mesh: TriangleMesh, field: FloatArray) -> FloatArray:
    """Return the length of a field (F, 3) at the vertices, (V,)."""
    return np.asarray(calculus.averaging(mesh) @ np.linalg.norm(field, axis=1))


def coloured(mesh: TriangleMesh, field: FloatArray) -> Streaks:
    """Show a field with its speed."""
    return Streaks(field, speed(mesh, field), "speed")


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
    """Follow flow lines from the vertices back to times before, not negative (T,): (T, V, 3)."""
    starts = project_onto_surface(mesh, mesh.vertices)
    lines = flow_lines(mesh, velocity, starts, -float(times.max()))
    return np.array([[line.at(-t) for line in lines] for t in times])


def carried(mesh: TriangleMesh, places: FloatArray, f: FloatArray) -> FloatArray:
    """Return the values (T, V) of ``f`` (V,) at places (T, V, 3), brought to the vertices."""
    return np.array([project_onto_surface(mesh, points).pull_back(f) for points in places])
