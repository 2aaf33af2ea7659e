"""Find the field whose flow carries one function to another."""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from abfm.calculus.vector_fields import to_ambient
from abfm.errors import ParameterError, brief
from abfm.matching.energy.energy import MatchingEnergy
from abfm.matching.judging.verdict import OUT_OF_MEMORY, Outcome, advice
from abfm.matching.judging.verification import look
from abfm.matching.result import Match
from abfm.matching.solving.control import CancelledError, Control
from abfm.matching.solving.record import Iteration
from abfm.matching.solving.solve import Solver
from abfm.mesh import TriangleMesh
from abfm.parameters import Parameters
from abfm.progress import step

__all__ = ["Control", "Iteration", "match"]


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
) -> Match:
    """Find the tangent field whose flow carries ``f`` to ``g``.

    Parameters
    ----------
    mesh : TriangleMesh
    f, g : (V,) or (V, C) arrays
        Source and target, one or several channels.
    parameters : Parameters, optional
    mask : (V,) array, optional
        Weight of the mismatch at each vertex, not negative.
    weights : (C,) array, optional
        Weight of each channel's mismatch, not negative.
    start : (M, F, 3) or (F, 3) array, optional
        Fields to start from, such as an earlier ``match.velocity``, also one found for other functions or parameters;
        those of M segments are averaged over, or repeated in, the N of these parameters. Sigma is then not cooled
        again, which would lead away from a good start, unless the parameters have a reach and the start is far from
        the target. Zero by default.
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
    """
    if not isinstance(parameters, Parameters | None):
        raise ParameterError(f"parameters is {brief(parameters)}; expected abfm.Parameters(...)")
    energy = MatchingEnergy(mesh, f, g, parameters or Parameters(), mask, weights)
    control = control or Control()
    solver = Solver(energy, on_iteration, control)
    fields, advected, reason = solver.run(start)
    mismatch = energy.relative_mismatch(advected)
    between = control.wait if reason != "cancelled" or control.brief else None
    try:
        if between is not None:
            between()
        count = len(energy.mesh.vertices)
        with step("checking by flow lines", count):
            verified, folded = look(energy, to_ambient(energy.mesh, fields), energy.parameters.tau, between)
    except (ParameterError, CancelledError, MemoryError):  # too fast for walks, or no time or memory for them
        verified, folded = np.nan, np.nan
    last = np.array(solver.stage_of) == solver.stage_of[-1]
    energies = np.array(solver.history)[last, 0]
    verdict = advice(
        energy,
        Outcome(advected, mismatch, reason, verified, folded, energies=energies, unmatched=solver.unmatched),
        energy.parameters,
    )
    if reason not in ("cancelled", OUT_OF_MEMORY) and verdict.kind in ("impossible", "not reached"):
        reason = verdict.kind
    return Match(
        mesh=mesh,
        source=energy.source.T.copy(),
        target=energy.target.T.copy(),
        parameters=energy.parameters,
        velocity=to_ambient(energy.mesh, fields) * energy.length_scale,
        advected=advected.T.copy(),
        energy_history=np.array(solver.history),
        stages=np.array(solver.stage_of),
        mismatch=mismatch,
        verified_mismatch=verified,
        folded=folded,
        stop_reason="converged" if reason == "line search failed" else reason,
        verdict=verdict,
        mask=energy.mask,
        weights=energy.weights,
        channels_given=np.ndim(f) == 2,
    )
