"""A given start of a match: fields of so many segments, on the mesh itself or on a finer one."""

import numpy as np

from abfm.calculus.vector_fields import to_ambient, to_frame
from abfm.errors import ParameterError
from abfm.matching.objective.matching_energy import MatchingEnergy
from abfm.matching.solving.levels import Level, subdivided
from abfm.mesh.subdivision import times_subdivided
from abfm.types import FloatArray

_LOST = 0.3  # residual of a given start beyond which the target is looked for again
# times the source's values, beyond which squares round off what the target is: nothing leads to it
_UNSTABLE = 1e8
# times the residual of no flow at all beyond which no way begins at a given start
_ASTRAY = 3.0


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
    """Tell whether the target has to be looked for, as a start (N, F, 2) carries the source (C, V)
    elsewhere; ParameterError if its flow overflows.
    """
    if not np.isfinite(advected).all():
        raise ParameterError(
            "start: the flow of these fields overflows; start from slower ones or from none"
        )
    if energy.parameters.solver.reach:
        return energy.left_by(start, advected) > _LOST
    largest, grown = float(np.abs(energy.terms.carried).max()), float(np.abs(advected).max())
    if grown > _UNSTABLE * largest:
        raise ParameterError(
            "start: the discrete flow of these fields is unstable, as it makes values of up "
            f"to {grown:.3g} of those of up to {largest:.3g}; start from slower fields or from none"
        )
    return False


def on_finer(energy: MatchingEnergy, levels: list[Level]) -> tuple[list[Level], FloatArray] | None:
    """Return the levels up to the finer mesh that a start came from, and its coefficients there;
    None if there is none, if it may not be used, or if the start leads astray.
    """
    p, start = energy.parameters, energy.problem.fine_start
    times = 0 if start is None else times_subdivided(start.shape[1], energy.problem.mesh)
    if start is None or not times or times > (times if p.refine is None else p.refine):
        return None
    if p.solver.segments not in (0, len(start)):
        return None
    found = list(levels)
    for _ in range(times):
        found[-1:] = subdivided(found[-1])
    finest = found[-1].energy
    x = to_frame(finest.mesh, start / energy.length_scale)
    return (found, x) if finest.left_by(x, finest.advected(x)) <= _LOST else None


def where_it_begins(levels: list[Level], start: FloatArray | None, at_once: bool) -> FloatArray:
    """Return the fields at which the ways on the coarsest level begin, for a start on the finest:
    none if it leads astray, unless it is to be had as it is.
    """
    energy = levels[0].energy
    if start is None:
        return np.zeros(energy.shape)
    for coarser, finer in zip(levels[-2::-1], levels[:0:-1], strict=True):
        start = coarser.fields_from_finer(to_ambient(finer.energy.mesh, start))
    at_rest = energy.left_by(np.zeros(energy.shape), energy.terms.carried)
    residual = energy.left_by(start, energy.advected(start))
    return start if at_once or residual <= _ASTRAY * at_rest else np.zeros(energy.shape)
