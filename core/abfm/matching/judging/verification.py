"""Whether fields carry one function to another, by witnesses that know nothing of how they were found.

A search among all fields of a mesh also finds those that its scheme carries better than their flow does. So the flow
itself is asked:

- flow lines of the continuous field (`continuous_flow`) lead from each vertex back to where its value comes from.
  They have no dispersion, and their error falls with the square of the edge length;
- the exponential of the continuous field on the midpoint subdivision shares the scheme's dispersion, a quarter of it,
  but not the mesh.

Where both agree the mismatch is that of the field, whatever the discrete one was.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from abfm.calculus.operators import face_frames
from abfm.errors import AdvectionError, MeshError
from abfm.flow.continuous_flow import flow_map
from abfm.flow.flow import Flow
from abfm.flow.flow_lines import fields_in_a_row
from abfm.flow.smooth_flow import smooth_flow
from abfm.maps.folds import MOST, folds
from abfm.maps.surface_points import SurfacePoints, pull_back, vertex_points
from abfm.matching.energy.problem import Problem, relative_mismatch
from abfm.matching.judging.resolution import RESOLVED, narrowest
from abfm.mesh import TriangleMesh
from abfm.mesh.subdivision import interpolated
from abfm.mesh.subdivision import subdivided as subdivided_mesh
from abfm.parameters import Method
from abfm.types import FloatArray, IntArray

SUBDIVIDED_LIMIT = 200_000
"""Vertices of a mesh above which the subdivided one, of four times as many, is not asked."""
FEW = 20_000
"""Vertices that `look` asks at most."""
_MOST_CUT = 256  # faces that `look` cuts into parts
_APART, _TIMES = 0.05, 2.0  # witnesses that differ by more than both do not agree


@dataclass(frozen=True)
class Verification:
    """What independent witnesses say of fields that are to carry a source to a target; see `verify`.

    ``folded`` is small even for rough fields, as the flow of a continuous field tears nothing; ``overturned`` is
    several percent where a smooth flow stretches much, tens of percent where the field is noise.
    """

    flow_lines: float  # ``||f o phi^-1 - g|| / ||g||`` in L2 with phi the flow of the continuous fields to tau
    subdivided: float
    """The same by the matrix exponential of the continuous fields on the midpoint subdivision, with f and g
    interpolated; inf where it overflows or would take very long, NaN where it was not asked."""
    folded: float  # shares of the faces that the inverse flow folds,
    overturned: float  # and whose carried vertices alone look turned over, see `folds.folds`
    resolution: float  # how many edges the narrow features of both functions span, mask or not

    @property
    def mismatch(self) -> float:
        """The verified mismatch: that by flow lines, which no scheme's dispersion or instability touches."""
        return self.flow_lines

    @property
    def doubtful(self) -> bool:
        """Whether the two witnesses differ by more than a factor of 2 and more than 0.05.

        Then the fields or the functions are too rough for this mesh: no number can be relied on.
        """
        least, most = sorted((self.flow_lines, self.subdivided))  # comparisons with NaN are False
        return bool(most - least > _APART and most > _TIMES * least)

    @property
    def resolved(self) -> bool:
        """Whether source and target are wide enough for advection on this mesh, see `resolution.RESOLVED`."""
        return self.resolution >= RESOLVED

    def report(self) -> str:
        """The numbers in a line."""
        parts = [f"verified mismatch {self.mismatch:.4f} by flow lines"]
        if not np.isnan(self.subdivided):
            parts.append(f"{self.subdivided:.4f} on the subdivided mesh")
        parts.append(f"{100 * self.folded:.2g} % of the faces folded")
        parts.append(f"functions {self.resolution:.1f} edges wide")
        notes = ["the witnesses disagree"] * self.doubtful + ["too narrow for this mesh"] * (not self.resolved)
        return ", ".join(parts) + "".join(f"; {note}" for note in notes)


def verify(
    mesh: TriangleMesh,
    source: ArrayLike,
    target: ArrayLike,
    velocity: ArrayLike,
    tau: float,
    *,
    mask: ArrayLike | None = None,
    weights: ArrayLike | None = None,
    linearised: bool = False,
    subdivided: bool = True,
) -> Verification:
    """Ask independent witnesses whether fields carry a source to a target.

    Parameters
    ----------
    source, target, mask, weights
        As `abfm.match` takes them.
    velocity : (N, F, 3) or (F, 3) array
        Tangent fields in a row, each for ``tau / N``, in the mesh's length unit per unit of time, such as
        ``match.velocity``.
    linearised : bool
        On the subdivided mesh take the linearised steps ``id - tau / N D_v`` instead of the exponentials.
    subdivided : bool
        Whether to ask on the subdivided mesh, which takes most of the time. Above `SUBDIVIDED_LIMIT` vertices it is
        not asked.

    Raises
    ------
    AbfmError
        If an array or ``tau`` does not fit, or the fields lead over too many faces, see
        `abfm.flow.continuous_flow.flow_map`.
    """
    problem = Problem(mesh, source, target, mask, weights)
    fields = fields_in_a_row(mesh, velocity)
    lines, folded, overturned = _by_flow_lines(problem, fields, tau, np.arange(len(mesh.faces)), MOST)
    on_fine = np.nan
    if subdivided and len(mesh.vertices) <= SUBDIVIDED_LIMIT:
        on_fine = _on_subdivided(problem, fields, tau, "linearised" if linearised else "nonlinear")
    return Verification(lines, on_fine, folded, overturned, narrowest(problem))


def look(
    problem: Problem, velocity: FloatArray, tau: float, between: Callable[[], None] | None = None
) -> tuple[float, float]:
    """`Verification.flow_lines` and `Verification.folded`, for fields (N, F, 3) that are known to fit, in less time.

    On meshes of more than `FEW` vertices so many, those of evenly chosen faces, stand for all. ``between`` is called
    again and again in this thread; what it raises ends the work.
    """
    faces = np.arange(len(problem.mesh.faces))
    if len(problem.mesh.vertices) > FEW:
        faces = np.linspace(0, len(faces) - 1, FEW // 2).astype(np.int64)
    return _by_flow_lines(problem, velocity, tau, faces, _MOST_CUT, between)[:2]


def _by_flow_lines(
    problem: Problem,
    fields: FloatArray,
    tau: float,
    faces: IntArray,
    most: int,
    between: Callable[[], None] | None = None,
) -> tuple[float, float, float]:
    """The mismatch at the vertices of some faces (S,), and the shares of `folds.folds` among these faces."""
    mesh, source, mask = problem.mesh, problem.source, problem.mask

    def carried(start: SurfacePoints) -> SurfacePoints:
        return flow_map(mesh, fields, tau, backwards=True, start=start, between=between)

    asked, corners = np.unique(mesh.faces[faces], return_inverse=True)
    points = carried(vertex_points(mesh, asked))
    folded, overturned = folds(mesh, carried, faces, points.positions[corners.reshape(-1, 3)], most)
    weight = np.zeros(len(mesh.vertices))  # nothing where nobody asked
    weight[asked] = 1.0 if mask is None else mask[asked]
    found = np.zeros_like(source)
    found[:, asked] = pull_back(mesh, points, source.T).T
    return relative_mismatch(mesh, found, problem.target, source, weight, problem.weights), folded, overturned


def _on_subdivided(problem: Problem, fields: FloatArray, tau: float, method: Method) -> float:
    """The mismatch on the subdivided mesh, NaN where there is none because a face is too thin."""
    mesh, mask = problem.mesh, problem.mask
    try:
        fine = subdivided_mesh(mesh)
    except MeshError:
        return np.nan
    source, target = (np.ascontiguousarray(interpolated(mesh, h.T).T) for h in (problem.source, problem.target))
    carried, duration = source.T, tau / len(fields)
    try:
        for field in fields:  # one by one, as each takes its memory
            carried = Flow(fine, _on_children(mesh, fine, field), duration or 1.0, method).push(carried, duration)
    except AdvectionError:
        return np.inf
    if mask is not None:  # on an edge the least of its ends, so that what it hides nowhere matters
        mask = np.concatenate([mask, mask[mesh.edges].min(axis=1)])
    with np.errstate(over="ignore"):
        return relative_mismatch(fine, np.ascontiguousarray(carried.T), target, source, mask, problem.weights)


def _on_children(mesh: TriangleMesh, fine: TriangleMesh, field: FloatArray) -> FloatArray:
    """The continuous field at the centres of the subdivided mesh's faces, (4 F, 3)."""
    vectors = smooth_flow(mesh, field).vectors
    centres = fine.vertices[fine.faces].mean(axis=1).reshape(-1, 4, 3) - mesh.vertices[mesh.faces[:, :1]]
    places = np.einsum("fqx,fkx->fqk", centres, face_frames(mesh))
    at_centres = vectors[:, None, 0] + np.einsum("fqj,fjk->fqk", places, vectors[:, 1:])
    return np.asarray(np.einsum("fqk,fkx->fqx", at_centres, face_frames(mesh)).reshape(-1, 3))
