"""The start of a match: fields on the mesh itself, on a finer or on the coarsest one."""

import numpy as np

from abfm.calculus.vector_fields import to_ambient, to_frame
from abfm.errors import ParameterError
from abfm.matching.objective.matching_energy import MatchingEnergy
from abfm.matching.solving.levels import Levels
from abfm.matching.solving.settings import SETTINGS
from abfm.mesh.subdivision import times_subdivided
from abfm.types import FloatArray


def given(energy: MatchingEnergy) -> FloatArray | None:
    """Return a problem's start as frame coefficients (N, F, 2) on its mesh; None for none."""
    start, wanted = energy.problem.start, energy.parameters.solver.segments
    if start is None:
        return None
    count, wanted = len(start), wanted or len(start)
    begins, others = np.arange(wanted)[:, None] * count, np.arange(count) * wanted
    overlaps = np.minimum(begins + count, others + wanted) - np.maximum(begins, others)
    averages = np.maximum(overlaps, 0) / count
    return to_frame(energy.mesh, np.tensordot(averages, start / energy.length_scale, 1))


def is_lost(energy: MatchingEnergy, start: FloatArray, advected: FloatArray) -> bool:
    """Return whether the target has to be searched, as a start (N, F, 2) advects the source (C, V)
    elsewhere; ParameterError if its flow overflows.
    """
    if not np.isfinite(advected).all():
        raise ParameterError(
            "start: the flow of these fields overflows; start from slower ones or from none"
        )
    if energy.parameters.solver.reach:
        return energy.residual_of(start, advected) > SETTINGS.lost_residual
    largest, grown = float(np.abs(energy.terms.carried).max()), float(np.abs(advected).max())
    if grown > SETTINGS.unstable_factor * largest:
        raise ParameterError(
            "start: the discrete flow of these fields is unstable, as it makes values of up "
            f"to {grown:.3g} of those of up to {largest:.3g}; start from slower fields or from none"
        )
    return False


def on_finer(energy: MatchingEnergy, levels: Levels) -> tuple[Levels, FloatArray] | None:
    """Return the levels up to the finer mesh of a start, and its coefficients there; None if there
    is none, if it may not be used, or if the start leads astray.
    """
    p, start = energy.parameters, energy.problem.fine_start
    times = 0 if start is None else times_subdivided(start.shape[1], energy.problem.mesh)
    if start is None or not times or times > (times if p.refine is None else p.refine):
        return None
    if p.solver.segments not in (0, len(start)):
        return None
    for _ in range(times):
        levels = levels.subdivided()
    finest = levels[-1].energy
    x = to_frame(finest.mesh, start / energy.length_scale)
    is_near = finest.residual_of(x, finest.advected(x)) <= SETTINGS.lost_residual
    return (levels, x) if is_near else None


def on_coarsest(levels: Levels, start: FloatArray | None, is_kept: bool) -> FloatArray:
    """Return the fields (N, F, 2) at which the search on the coarsest level begins, for a start on
    the finest one: zero if there is none or it leads astray, unless it ``is_kept`` anyway.
    """
    energy = levels[0].energy
    rest = np.zeros(energy.shape)
    if start is None:
        return rest
    for coarser, finer in zip(levels.all[-2::-1], levels.all[:0:-1], strict=True):
        start = coarser.fields_from_finer(to_ambient(finer.energy.mesh, start))
    at_rest = energy.residual_of(rest, energy.terms.carried)
    residual = energy.residual_of(start, energy.advected(start))
    return start if is_kept or residual <= SETTINGS.astray_factor * at_rest else rest
