"""Whether fields carry one function to another, by witnesses that know nothing of how they were
found.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from abfm.errors import AdvectionError, MeshError
from abfm.flow.continuous_flow import ContinuousFlow, field_on_children
from abfm.flow.flow import Flow
from abfm.flow.flow_lines import checked_fields
from abfm.maps.distortion import CUT_FACES_MAX, folded_shares
from abfm.matching.problem import Problem, mask_on_children
from abfm.matching.solvability import RESOLUTION_MIN, narrowest
from abfm.matching.solving.measures import flow_line_residual
from abfm.matching.terms.functions import FunctionTerm
from abfm.mesh.subdivision import interpolated
from abfm.mesh.subdivision import subdivided as subdivided_mesh
from abfm.parameters import Parameters
from abfm.types import FloatArray

SUBDIVIDED_LIMIT = 200_000
"""Vertices of a mesh above which the subdivided one, of four times as many, is not asked."""
# checks disagree if they differ by more than both, a difference and a ratio
_DIFFERENCE_MAX = 0.05
_RATIO_MAX = 2.0


@dataclass(frozen=True)
class Verification:
    """What independent witnesses say of fields that are to carry a source to a target.

    Attributes
    ----------
    flow_lines : float
        ``||f o phi^-1 - g|| / ||g - mean(g)||`` in L2, with phi the flow of the continuous fields
        to tau.
    subdivided : float
        The same by the exponential of the continuous fields on the midpoint subdivision; inf where
        it overflows or would take very long, NaN where it was not asked.
    folded, overturned : float
        Shares of the faces that the inverse flow folds, and whose carried vertices alone look
        turned over: tens of percent where the field is noise.
    resolution : float
        How many edges the narrow features of both functions span, mask or not.
    """

    flow_lines: float
    subdivided: float
    folded: float
    overturned: float
    resolution: float

    @property
    def residual(self) -> float:
        """The verified residual: by flow lines, which no scheme's dispersion touches."""
        return self.flow_lines

    @property
    def checks_disagree(self) -> bool:
        """Whether the witnesses differ by more than a factor of 2 and 0.05, as fields are rough."""
        least, most = sorted((self.flow_lines, self.subdivided))  # comparisons with NaN are False
        return bool(most - least > _DIFFERENCE_MAX and most > _RATIO_MAX * least)

    @property
    def resolved(self) -> bool:
        """Whether source and target are wide enough for advection on this mesh."""
        return self.resolution >= RESOLUTION_MIN

    def report(self) -> str:
        """Return the numbers in a line."""
        parts = [f"verified residual {self.residual:.4f} by flow lines"]
        if not np.isnan(self.subdivided):
            parts.append(f"{self.subdivided:.4f} on the subdivided mesh")
        parts.append(f"{100 * self.folded:.2g} % of the faces folded")
        parts.append(f"functions {self.resolution:.1f} edges wide")
        disagree = "; the witnesses disagree" * self.checks_disagree
        return ", ".join(parts) + disagree + "; too narrow for this mesh" * (not self.resolved)


def verify(problem: Problem, velocity: ArrayLike, subdivided: bool = True) -> Verification:
    """Ask independent witnesses whether fields carry a source to a target, not only their scheme.

    Flow lines have no dispersion, and their error falls with the square of the edge length; on the
    midpoint subdivision the scheme's dispersion is a quarter. Where both agree the mismatch is that
    of the field.

    Parameters
    ----------
    problem : Problem
        Its functions, mask and weights, tau and the method.
    velocity : (N, F, 3) or (F, 3) array
        Tangent fields, each for ``tau / N``, in the mesh's length unit, such as ``match.velocity``;
        also (N, 4^k F, 3), such as ``match.fine_velocity``: then all is asked on the mesh
        subdivided k times, with the functions there (`Problem.refined`).
    subdivided : bool
        Whether to ask on the subdivided mesh, up to `SUBDIVIDED_LIMIT` vertices: most of the time.

    Raises
    ------
    AbfmError
        If an array does not fit, or the fields lead over too many faces.
    """
    fields, k = checked_fields(problem.mesh, velocity)
    problem = problem.refined(k)
    mesh, p = problem.mesh, problem.parameters
    functions = problem.functions.on(mesh)
    flow, faces = ContinuousFlow(mesh, fields, p.tau), np.arange(len(mesh.faces))
    lines, places = flow_line_residual(functions, flow, faces)
    folded, overturned = folded_shares(mesh, flow.origins, faces, places, CUT_FACES_MAX)
    on_fine = np.nan
    if subdivided and len(mesh.vertices) <= SUBDIVIDED_LIMIT:
        on_fine = _on_subdivided(functions, fields, p)
    return Verification(lines, on_fine, folded, overturned, narrowest(functions))


def _on_subdivided(functions: FunctionTerm, fields: FloatArray, parameters: Parameters) -> float:
    mesh, mask = functions.mesh, functions.mask
    try:
        fine = subdivided_mesh(mesh)  # not kept: what is made on it takes gigabytes
    except MeshError:
        return np.nan
    source, target = (interpolated(mesh, h.T) for h in (functions.source, functions.target))
    carried, duration = source, parameters.tau / len(fields)
    try:
        for field in fields:  # one by one, as each takes its memory
            flow = Flow(fine, field_on_children(mesh, field), duration, parameters.paper.method)
            carried = flow.push(carried, duration)
    except AdvectionError:
        return np.inf
    there = FunctionTerm(fine, source, target, None, functions.weights)
    if mask is not None:
        there = there.with_mask(mask_on_children(mesh, mask))
    with np.errstate(over="ignore"):
        return there.residual(np.ascontiguousarray(carried.T))
