"""Find the field whose flow carries one function to another."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, overload

import numpy as np
from numpy.typing import ArrayLike

from abfm.calculus.vector_fields import to_ambient
from abfm.errors import ParameterError
from abfm.matching.judging.verdict import Outcome, advice
from abfm.matching.judging.verification import estimate
from abfm.matching.objective.matching_energy import MatchingEnergy
from abfm.matching.problem import Problem
from abfm.matching.result import Match
from abfm.matching.solving.record import Iteration
from abfm.matching.solving.solve import Solver
from abfm.matching.solving.stop_reason import StopReason
from abfm.mesh import TriangleMesh
from abfm.parameters import Parameters
from abfm.types import FloatArray
from abfm.workers.control import CancelledError, Control, checkpoint, controlled, present_control
from abfm.workers.progress import step

__all__ = ["Control", "Iteration", "match"]


@overload
def match(
    problem: Problem,
    *,
    on_iteration: Callable[[Iteration], None] | None = None,
    control: Control | None = None,
) -> Match: ...


@overload
def match(
    mesh: TriangleMesh,
    f: ArrayLike,
    g: ArrayLike,
    parameters: Parameters | None = None,
    *,
    mask: ArrayLike | None = None,
    weights: ArrayLike | None = None,
    start: ArrayLike | None = None,
    on_iteration: Callable[[Iteration], None] | None = None,
    control: Control | None = None,
) -> Match: ...


def match(
    *problem: Any,
    on_iteration: Callable[[Iteration], None] | None = None,
    control: Control | None = None,
    **given: Any,
) -> Match:
    """Find the tangent field whose flow carries the source of a problem to its target.

    It minimises ``1/2 int ||v||_alpha^2 dt + 1/(2 sigma^2) ||f_tau - g||^2`` over the fields ``v``,
    where ``f_tau`` is the source carried along the flow of ``v`` to time tau (Eq. 3).

    Parameters
    ----------
    problem : Problem
        Or, as a short form, what `Problem` takes: ``match(mesh, f, g, parameters, ...)``.
    on_iteration : callable, optional
        Called after every iteration, in this thread.
    control : Control, optional
        To pause, resume or cancel from elsewhere.

    Returns
    -------
    Match

    Raises
    ------
    AbfmError
        If the functions, parameters, mask, weights or start do not fit.
    MemoryError
        If memory runs out before there is a field; later, the best one so far is returned.

    Examples
    --------
    >>> import abfm
    >>> from abfm.assets import asset_path
    >>> mesh = abfm.load_mesh(asset_path("human_A.off"))
    >>> f, g = (abfm.function(mesh, f"gaussian:vertex={i},width=0.2") for i in (394, 14))
    >>> found = abfm.match(mesh, f, g)
    >>> found.verdict.kind
    'matched'
    >>> found.advect(1.0).shape == f.shape
    True
    """
    the_problem = _problem_of(*problem, **given)
    energy = MatchingEnergy(the_problem)
    control = control or present_control() or Control()
    solver = Solver(energy, on_iteration)
    # what has nothing to show yet goes on to its first evaluation
    with controlled(control, lambda: bool(solver.history)):
        fields, carried, reason = solver.run()
    advected = carried[: len(energy.functions.source)]
    mismatch = energy.relative_mismatch(carried)
    may_end = reason is not StopReason.CANCELLED or control.brief
    with controlled(control, lambda: may_end):  # else it is checked though it was cancelled
        try:
            verified, folded = _by_flow_lines(energy, fields)
        except CancelledError:
            verified, folded, reason = np.nan, np.nan, StopReason.CANCELLED
    last = np.array(solver.stage_of) == solver.stage_of[-1]
    energies = np.array(solver.history)[last, 0]
    outcome = Outcome(advected, mismatch, reason, verified, folded, energies, solver.unmatched)
    return Match(
        problem=the_problem.starting_from(None),
        velocity=to_ambient(energy.mesh, fields) * energy.length_scale,
        advected=advected.T.copy(),
        energy_history=np.array(solver.history),
        stages=np.array(solver.stage_of),
        mismatch=mismatch,
        verified_mismatch=verified,
        folded=folded,
        stop_reason=reason,
        verdict=advice(energy.functions, outcome, energy.parameters),
    )


def _problem_of(*problem: Any, **given: Any) -> Problem:
    """Return the problem that `match` was called with, whole or in parts."""
    first = problem[0] if problem else None
    if isinstance(first, Problem):
        if len(problem) > 1 or given:
            raise ParameterError(
                "match takes a Problem alone: parameters, mask, weights and start are its own; "
                "give them to abfm.Problem(...)"
            )
        return first
    if len(problem) == 1 and not given:
        raise ParameterError("match takes a Problem, or a mesh, a source and a target")
    return Problem(*problem, **given)


def _by_flow_lines(energy: MatchingEnergy, fields: FloatArray) -> tuple[float, float]:
    """Return what flow lines leave, and the share of faces that they fold; NaN if unknown."""
    try:
        checkpoint()
        with step("checking by flow lines", len(energy.mesh.vertices)):
            return estimate(energy, to_ambient(energy.mesh, fields))
    except (ParameterError, MemoryError):  # too fast for walks, or no memory for them
        return np.nan, np.nan
