"""Smooth fields that exist on any mesh, their flow lines, and functions advected along them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from abfm import Flow, MeshError, TriangleMesh, calculus
from abfm.calculus import face_areas, l2_norm, to_frame
from abfm.calculus.operators import rotation
from abfm.experiments.scripts import Example, advection_example, gaussian, size_text
from abfm.flow import flow_lines
from abfm.io.sheets import Streaks
from abfm.maps import project_onto_surface
from abfm.mesh.shapes import torus
from abfm.types import FloatArray


@dataclass(frozen=True, eq=False)
class Case:
    """A surface with its name and a field ``v`` (F, 3); several cases may have the same name."""

    name: str
    mesh: TriangleMesh
    v: FloatArray


def sizes_text(levels: Sequence[Case]) -> str:
    return size_text(levels[-1].name, *(level.mesh for level in levels))


def field_example(case: Case, name: str) -> Example:
    """Return an example: a Gaussian where ``v`` is fastest, advected until t = 1."""
    fastest = int(np.argmax(speed(case.mesh, case.v)))
    source = gaussian(case.mesh, fastest, 0.1)
    return advection_example(Flow(case.mesh, case.v), name, source, "file:advected.npy")


def stream_field(mesh: TriangleMesh, modes: Mapping[int, float], speed: float) -> FloatArray:
    """Return a smooth divergence-free field (F, 3), tangent to the boundary.

    It is the rotated gradient of a sum of eigenfunctions, whose weights by number are ``modes``.
    Its root mean square is ``speed``, in sqrt(area) per unit of time.
    """
    basis = calculus.unit_eigenbasis(mesh, max(modes) + 1)[1]
    field = gradient_field(
        mesh, basis[:, list(modes)] @ np.array(list(modes.values())), turned=True
    )
    if not mesh.is_closed:
        original_norm = np.linalg.norm(field)
        field = calculus.helmholtz_hodge(mesh, field)[1]
        if np.linalg.norm(field) <= 1e-9 * original_norm:
            raise MeshError(
                "this mesh has no smooth divergence-free field that is tangent to its boundary; "
                "refine its interior"
            )
    return field * (speed * mesh.length_scale / root_mean_square(mesh, field))


def stirring_field(mesh: TriangleMesh, index: int, speed: float) -> FloatArray:
    """Return the rotated gradient (F, 3) of eigenfunction ``index``, tangent to the boundary.

    It has the root mean square ``speed``, see `with_speed`.
    """
    if len(mesh.vertices) <= index:
        raise MeshError(
            f"the mesh has {len(mesh.vertices)} vertices; the field of this figure needs more than "
            f"{index}"
        )
    turned = gradient_field(mesh, calculus.eigenbasis(mesh, index + 1)[1][:, index], turned=True)
    across, along, harmonic = calculus.helmholtz_hodge(mesh, turned)
    if np.linalg.norm(along + harmonic) <= 1e-9 * np.linalg.norm(across):
        raise MeshError(
            "this mesh has no field that is tangent to its boundary, because all of its vertices "
            "are on the boundary; refine it"
        )
    return with_speed(mesh, along + harmonic, speed)


def gradient_field(mesh: TriangleMesh, f: FloatArray, turned: bool = False) -> FloatArray:
    """Return the gradient (F, 3) of a function ``f`` (V,), rotated by 90 degrees if ``turned``."""
    operator = rotation(mesh) @ calculus.gradient(mesh) if turned else calculus.gradient(mesh)
    return calculus.to_ambient(mesh, (operator @ f).reshape(-1, 2))


def with_speed(mesh: TriangleMesh, field: FloatArray, speed: float) -> FloatArray:
    """Scale a field (F, 3) to the root mean square ``speed``, in sqrt(area) per unit of time."""
    areas = face_areas(mesh)
    return float(areas.sum() * speed / np.sqrt(areas @ (field**2).sum(axis=1))) * field


def tangential_part(mesh: TriangleMesh, vectors: FloatArray) -> FloatArray:
    """Return the tangential components (F, 3) of vectors (F, 3), one for each face."""
    return calculus.to_ambient(mesh, to_frame(mesh, vectors))


def face_centres(mesh: TriangleMesh) -> FloatArray:
    return np.asarray(mesh.vertices[mesh.faces].mean(axis=1))


def angular_torus(n: int) -> tuple[TriangleMesh, FloatArray, FloatArray, FloatArray]:
    """Return a torus, the distances (F,) of its faces from the axis, and two fields (F, 3).

    The fields rotate about the axis and around the tube. The torus has ``n`` vertices around its
    axis.
    """
    mesh = torus(n, n // 2)
    x, y, z = face_centres(mesh).T
    ring = np.hypot(x, z)
    by_about = np.stack([z, np.zeros_like(z), -x], axis=1)
    return mesh, ring, by_about, np.stack([-y * x / ring, ring - 1, -y * z / ring], axis=1)


def speed(mesh: TriangleMesh, field: FloatArray) -> FloatArray:
    """Return the magnitude of a field (F, 3), averaged to the vertices, (V,)."""
    return np.asarray(calculus.averaging(mesh) @ np.linalg.norm(field, axis=1))


def speed_streaks(mesh: TriangleMesh, field: FloatArray) -> Streaks:
    return Streaks(field, speed(mesh, field), "speed")


def root_mean_square(mesh: TriangleMesh, values: FloatArray) -> float:
    """Return the root mean square over the surface of numbers (F,) or vectors (F, n) at faces."""
    squares = (values.reshape(len(values), -1) ** 2).sum(axis=1)
    return float(np.sqrt(np.average(squares, weights=face_areas(mesh))))


def relative_norm(mesh: TriangleMesh, field: FloatArray, other: FloatArray) -> float:
    areas = face_areas(mesh)
    return float(np.sqrt(areas @ (field**2).sum(axis=1) / (areas @ (other**2).sum(axis=1))))


def relative_difference(mesh: TriangleMesh, f: FloatArray, g: FloatArray) -> float:
    return l2_norm(mesh, f - g) / l2_norm(mesh, g)


def departure_points(mesh: TriangleMesh, velocity: FloatArray, times: FloatArray) -> FloatArray:
    """Return the points (T, V, 3) of backward flow lines from the vertices at T ``times``."""
    starts = project_onto_surface(mesh, mesh.vertices)
    lines = flow_lines(mesh, velocity, starts, -float(times.max()))
    return np.array([[line.at(-t) for line in lines] for t in times])


def advected_values(mesh: TriangleMesh, places: FloatArray, f: FloatArray) -> FloatArray:
    """Return ``f`` (V,) advected, (T, V): its values at the departure points (T, V, 3)."""
    return np.array([project_onto_surface(mesh, points).pull_back(f) for points in places])
