"""The function `match`, which solves a problem and verifies the result."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from abfm.errors import ParameterError
from abfm.maps.surface_points import SurfacePoints
from abfm.matching.judging.verdict import Verdict
from abfm.matching.objective.matching_energy import MatchingEnergy
from abfm.matching.path import PathStep
from abfm.matching.problem import Problem
from abfm.matching.result import Match
from abfm.matching.solving.continuation import solve
from abfm.matching.solving.measures import flow_line_measures
from abfm.matching.solving.record import Iteration, Record, StopReason
from abfm.matching.terms.data_term import DataTerm
from abfm.mesh import MeshLike
from abfm.outcome import Outcome
from abfm.parameters import Parameters
from abfm.workers.control import CancelledError, Control, checkpoint, controlled, current_control
from abfm.workers.progress import phase, step


def match(
    problem: Problem | MeshLike,
    f: ArrayLike | Sequence[str] | None = None,
    g: ArrayLike | Sequence[str] | None = None,
    parameters: Parameters | None = None,
    *,
    mask: ArrayLike | None = None,
    weights: ArrayLike | None = None,
    start: ArrayLike | None = None,
    terms: Sequence[DataTerm] = (),
    landmarks: ArrayLike | tuple[SurfacePoints, SurfacePoints] | None = None,
    landmark_weights: ArrayLike | None = None,
    approximate: bool = False,
    circular: bool | float | None = False,
    on_iteration: Callable[[Iteration], object] | None = None,
    control: Control | None = None,
) -> Match:
    """Find the tangent field whose flow advects the source of a problem to its target.

    The field ``v`` minimises ``1/2 int ||v||_alpha^2 dt + 1/(2 sigma^2) ||f_tau - g||^2`` (Eq. 3).
    Here ``f_tau`` is the source, advected along the flow of ``v`` to time tau. The residual of the
    result is at most the larger one of the residuals without motion and of the start.

    Parameters
    ----------
    problem : Problem, or a mesh as for `abfm.load_mesh`
        Problem to solve. With a mesh, functions or landmarks are needed as well, see `Problem`.
    f, g, parameters, mask, weights, start, terms, landmarks, landmark_weights
    approximate, circular
        Arguments of `Problem`, only if the first argument is a mesh.
    on_iteration : callable, optional
        Function that is called with an `Iteration` after every iteration, in this thread.
    control : Control, optional
        Object that pauses, resumes or cancels the match from another thread.

    Returns
    -------
    Match

    Raises
    ------
    AbfmError
        If an argument has a wrong shape or value.
    MemoryError
        If memory runs out before the first field. If it runs out later, the result is the best
        field so far.

    Examples
    --------
    >>> import abfm
    >>> from abfm.assets import asset_path
    >>> mesh = abfm.load_mesh(asset_path("eight.off"))
    >>> f, g = (abfm.function(mesh, f"gaussian:vertex={i},width=0.3") for i in (0, 100))
    >>> found = abfm.match(mesh, f, g)
    >>> str(found.facts.outcome), found.advect(1.0).shape == f.shape
    ('matched', True)
    """
    given = (f, g, parameters, mask, weights, start, landmarks, landmark_weights)
    if not isinstance(problem, Problem):
        if f is None and g is None and landmarks is None:
            raise ParameterError(
                "functions are missing; give match a Problem, or a mesh with a source and a target"
            )
        problem = Problem(
            problem,
            f,
            g,
            parameters,
            mask=mask,
            weights=weights,
            start=start,
            terms=terms,
            landmarks=landmarks,
            landmark_weights=landmark_weights,
            approximate=approximate,
            circular=circular,
        )
    elif any(each is not None for each in given) or terms or approximate or circular:
        raise ParameterError(
            "match takes no other arguments with a Problem; give parameters, mask, weights and "
            "start to abfm.Problem(...)"
        )
    energy, record = MatchingEnergy(problem), Record(on_iteration)
    control = control or current_control() or Control()
    # a cancelled match still makes its first evaluation
    with controlled(control, lambda: bool(record.history)):
        solution = solve(energy, record)
    path, number, reason = solution.path, solution.step, solution.reason
    may_end = reason is not StopReason.CANCELLED or control.skip_checks
    if math.isnan(path[number].verified_residual):
        # verified even if cancelled before
        with phase("check"), controlled(control, lambda: may_end):
            try:
                path = (*path[:number], _verified(problem, path[number]), *path[number + 1 :])
            except MemoryError:
                pass
            except CancelledError:
                reason = StopReason.CANCELLED
    history, stages = np.array(record.history), np.array(record.stage_of)
    end = path[number]
    found = Match(
        problem=problem.starting_from(None),
        fine_velocity=end.velocity,
        advected=solution.advected.T.copy(),
        energy_history=history,
        stages=stages,
        residual=end.residual,
        verified_residual=end.verified_residual,
        folded=end.folded,
        stop_reason=reason,
        verdict=Verdict(Outcome.NOT_REACHED, "", ""),
        path=path,
        step=number,
    )
    with phase("check"), controlled(Control()):  # checks the landmarks even if cancelled
        return found.judged(history[stages == stages[-1], 0])


def _verified(problem: Problem, end: PathStep) -> PathStep:
    """Measure a step along flow lines and return it with these measurements."""
    checkpoint()
    energy = MatchingEnergy(problem.refined(end.refined(problem.mesh)))
    with step("checking by flow lines", len(energy.mesh.vertices)):
        numbers: dict[str, Any] = flow_line_measures(
            energy, end.velocity / problem.mesh.length_scale
        )
    return replace(end, **numbers)
