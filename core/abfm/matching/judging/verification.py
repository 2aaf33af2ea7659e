"""Independent checks of whether a flow advects the source to the target."""

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
"""Largest number of vertices of a mesh for the check on its subdivision (four times as many)."""
# checks disagree if both their difference and their ratio are larger
_DIFFERENCE_MAX = 0.05
_RATIO_MAX = 2.0


@dataclass(frozen=True)
class Verification:
    """The results of independent checks of a flow from a source to a target.

    Attributes
    ----------
    flow_lines : float
        Residual along flow lines: ``||f o phi^-1 - g|| / ||g - mean(g)||`` in L2, where phi is the
        flow of the continuous fields to tau.
    subdivided : float
        Residual of the discrete flow of the continuous fields on the midpoint subdivision. It is
        inf if the flow overflows or would take very long, and NaN if it was not computed.
    folded, flipped : float
        Shares of the faces that the inverse flow folds, and of the faces that seem flipped by their
        advected vertices alone. If the field is noise, these shares are tens of percent.
    resolution : float
        Width of the narrowest features of source and target, in edges. Masked vertices of the
        source are included.
    """

    flow_lines: float
    subdivided: float
    folded: float
    flipped: float
    resolution: float

    @property
    def residual(self) -> float:
        """The residual along flow lines, which have no numerical dispersion."""
        return self.flow_lines

    @property
    def checks_disagree(self) -> bool:
        """Whether ``flow_lines`` and ``subdivided`` differ by more than 0.05 and a factor of 2.

        This is typical of rough fields.
        """
        least, most = sorted((self.flow_lines, self.subdivided))  # comparisons with NaN are False
        return bool(most - least > _DIFFERENCE_MAX and most > _RATIO_MAX * least)

    @property
    def resolved(self) -> bool:
        """Whether the features of source and target are wide enough for this mesh."""
        return self.resolution >= RESOLUTION_MIN

    def report(self) -> str:
        """Return the results as one line of text."""
        parts = [f"residual {self.residual:.4f} along flow lines"]
        if not np.isnan(self.subdivided):
            parts.append(f"{self.subdivided:.4f} on the subdivided mesh")
        parts.append(f"{100 * self.folded:.2g}% of the faces folded")
        parts.append(f"features {self.resolution:.1f} edges wide")
        disagree = "; the checks disagree" * self.checks_disagree
        narrow = "; features too narrow for this mesh" * (not self.resolved)
        return ", ".join(parts) + disagree + narrow


def verify(problem: Problem, velocity: ArrayLike, subdivided: bool = True) -> Verification:
    """Verify by independent checks that fields advect a source to a target.

    Flow lines have no numerical dispersion, and their error falls with the square of the edge
    length. On the midpoint subdivision, the discrete flow has a quarter of the dispersion. If both
    residuals agree, they are properties of the field and not of its discretisation.

    Parameters
    ----------
    problem : Problem
        Problem with the functions, mask, weights, tau and method.
    velocity : (N, F, 3) or (F, 3) array
        Tangent fields, each for ``tau / N``, in the length unit of the mesh, such as
        ``match.velocity``. Fields (N, 4^k F, 3), such as ``match.fine_velocity``, are verified on
        the mesh subdivided k times, with its functions (`abfm.Problem.refined`).
    subdivided : bool
        Whether to make the check on the subdivided mesh, up to `SUBDIVIDED_LIMIT` vertices. This
        check takes most of the time.

    Raises
    ------
    AbfmError
        If an array has a wrong shape or value, or if flow lines cross too many faces.
    """
    fields, k = checked_fields(problem.mesh, velocity)
    problem = problem.refined(k)
    mesh, p = problem.mesh, problem.parameters
    functions = problem.functions.on_mesh(mesh)
    flow, faces = ContinuousFlow(mesh, fields, p.tau), np.arange(len(mesh.faces))
    lines, places = flow_line_residual(functions, flow, faces)
    folded, flipped = folded_shares(mesh, flow.origins, faces, places, CUT_FACES_MAX)
    on_fine = np.nan
    if subdivided and len(mesh.vertices) <= SUBDIVIDED_LIMIT:
        on_fine = _on_subdivided(functions, fields, p)
    return Verification(lines, on_fine, folded, flipped, narrowest(functions))


def _on_subdivided(functions: FunctionTerm, fields: FloatArray, parameters: Parameters) -> float:
    mesh, mask = functions.mesh, functions.mask
    try:
        fine = subdivided_mesh(mesh)  # not cached, as its operators take gigabytes
    except MeshError:
        return np.nan
    source, target = (interpolated(mesh, h.T) for h in (functions.source, functions.target))
    advected, duration = source, parameters.tau / len(fields)
    try:
        for field in fields:  # one field at a time, to save memory
            flow = Flow(fine, field_on_children(mesh, field), duration, parameters.paper.method)
            advected = flow.push(advected, duration)
    except AdvectionError:
        return np.inf
    there = FunctionTerm(fine, source, target, None, functions.weights)
    if mask is not None:
        there = there.with_mask(mask_on_children(mesh, mask))
    with np.errstate(over="ignore"):
        return there.residual(np.ascontiguousarray(advected.T))
