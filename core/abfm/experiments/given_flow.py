"""Given fields, smooth ones on any mesh, and their flows: what they carry, and where their flow lines lead."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import count
from typing import Any, Generic, Self, TypeVar

import numpy as np

from abfm.calculus.eigenbasis import eigenbasis
from abfm.calculus.helmholtz_hodge import helmholtz_hodge
from abfm.calculus.operators import averaging, face_areas, gradient, l2_norm, rotation
from abfm.calculus.vector_fields import to_ambient, to_frame
from abfm.errors import MeshError
from abfm.experiments.experiment import Report, Setup
from abfm.flow.flow import Flow
from abfm.flow.flow_lines import flow_lines
from abfm.functions import function
from abfm.maps.surface_points import project_onto_surface, pull_back
from abfm.mesh import TriangleMesh
from abfm.parameters import Parameters
from abfm.types import FloatArray


@dataclass(frozen=True, eq=False, kw_only=True)
class GivenFlow(Setup):
    """A flow that is given, and a function that it carries to another until tau."""

    flow: Flow

    @classmethod
    def of(cls, flow: Flow, name: str, source: str, target: str = "file:advected.npy", **others: Any) -> Self:
        """A function, and by the name of a file what a flow makes of it until tau."""
        return cls(
            mesh=flow.mesh,
            name=name,
            sources=(source,),
            targets=(target,),
            values={target: flow.advect(function(flow.mesh, source))},
            parameters=Parameters(tau=flow.tau),
            flow=flow,
            **others,
        )


@dataclass(frozen=True, eq=False)
class Case:
    """A surface with a field ``v`` (F, 3)."""

    name: str
    mesh: TriangleMesh
    v: FloatArray


C = TypeVar("C", bound=Case)


@dataclass(frozen=True, eq=False, kw_only=True)
class GivenFields(GivenFlow, Generic[C]):
    """Surfaces with fields of which more is known, every surface from coarse to fine; or another one alone."""

    cases: tuple[tuple[C, ...], ...]

    @classmethod
    def on(cls, cases: tuple[tuple[C, ...], ...], name: str) -> Self:
        """With a Gaussian where the first surface's field is fastest, which that carries for a unit of time."""
        mesh, v = cases[0][-1].mesh, cases[0][-1].v
        fastest = mesh.vertex_ids[np.argmax(speed(mesh, v))]
        return cls.of(Flow(mesh, v), name, f"gaussian:vertex={fastest},width=0.1", "file:carried.npy", cases=cases)

    def title(self, case: C) -> str:
        """What a case is called: that of another mesh begins with its name."""
        return case.name if len(self.cases[0]) > 1 else ", ".join(filter(None, (self.name, case.name)))

    def told(self, report: Report) -> Iterator[Iterator[C]]:
        """The cases of every surface; each is told as it comes."""
        total, done = sum(len(levels) for levels in self.cases), count()

        def telling(case: C) -> C:
            report(f"{self.title(case)}, {len(case.mesh.vertices):,} vertices", next(done) / total)
            return case

        return (map(telling, levels) for levels in self.cases)

    @property
    def sizes(self) -> str:
        """The surfaces in words."""
        return "; ".join(
            f"{self.title(levels[-1])}, {', '.join(f'{len(case.mesh.vertices):,}' for case in levels)} vertices"
            for levels in self.cases
        )


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
    field = turned_gradient(mesh, basis[:, list(modes)] @ np.array(list(modes.values())))
    if not mesh.is_closed:
        whole = np.linalg.norm(field)
        field = helmholtz_hodge(mesh, field)[1]
        if np.linalg.norm(field) <= 1e-9 * whole:
            raise MeshError("no smooth field without divergence flows inside this mesh: refine it, above all inside")
    return field * (speed * mesh.length_scale / root_mean_square(mesh, field))


def stirring(mesh: TriangleMesh, index: int) -> FloatArray:
    """The turned gradient of an eigenfunction of the Laplacian, less what crosses the boundary, (F, 3).

    Raises
    ------
    MeshError
        If the mesh is too coarse to have one.
    """
    if len(mesh.vertices) <= index:
        raise MeshError(f"the mesh has {len(mesh.vertices)} vertices; expected more than {index}, for its own fields")
    across, along, harmonic = helmholtz_hodge(mesh, turned_gradient(mesh, eigenbasis(mesh, index + 1)[1][:, index]))
    if np.linalg.norm(along + harmonic) <= 1e-9 * np.linalg.norm(across):
        raise MeshError("no field flows inside this mesh, all of whose vertices lie on its boundary: refine it")
    return along + harmonic


def turned_gradient(mesh: TriangleMesh, f: FloatArray) -> FloatArray:
    """The gradient of a function (V,), turned by 90 degrees in every face, (F, 3)."""
    return to_ambient(mesh, (rotation(mesh) @ gradient(mesh) @ f).reshape(-1, 2))


def with_speed(mesh: TriangleMesh, field: FloatArray, speed: float) -> FloatArray:
    """The field (F, 3), scaled so that its root mean square is a multiple of sqrt(area) per unit of time."""
    areas = face_areas(mesh)
    factor = float(areas.sum() * speed / np.sqrt(areas @ (field**2).sum(axis=1)))
    return factor * field


def tangent(mesh: TriangleMesh, vectors: FloatArray) -> FloatArray:
    """Vectors at the face centres (F, 3) without their normal part."""
    return to_ambient(mesh, to_frame(mesh, vectors))


def centres(mesh: TriangleMesh) -> FloatArray:
    """Face centres, (F, 3)."""
    return np.asarray(mesh.vertices[mesh.faces].mean(axis=1))


def speed(mesh: TriangleMesh, field: FloatArray) -> FloatArray:
    """Length of a field (F, 3) at the vertices, (V,)."""
    return np.asarray(averaging(mesh) @ np.linalg.norm(field, axis=1))


def root_mean_square(mesh: TriangleMesh, values: FloatArray) -> float:
    """Root mean square over the surface, of one or several values per face, (F,) or (F, n)."""
    squares = (values.reshape(len(values), -1) ** 2).sum(axis=1)
    return float(np.sqrt(np.average(squares, weights=face_areas(mesh))))


def relative_norm(mesh: TriangleMesh, field: FloatArray, other: FloatArray) -> float:
    """L2 norm of a field (F, 3) over that of another."""
    areas = face_areas(mesh)
    return float(np.sqrt(areas @ (field**2).sum(axis=1) / (areas @ (other**2).sum(axis=1))))


def relative_difference(mesh: TriangleMesh, f: FloatArray, g: FloatArray) -> float:
    """L2 norm of ``f - g`` over that of ``g``, of functions (V,)."""
    return l2_norm(mesh, f - g) / l2_norm(mesh, g)


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
