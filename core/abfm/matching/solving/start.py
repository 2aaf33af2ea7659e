"""Initial fields of a match: on its mesh, on a subdivision of this, or on the coarsest mesh."""

import numpy as np

from abfm.calculus.vector_fields import to_ambient, to_frame
from abfm.errors import StartError
from abfm.matching.objective.matching_energy import MatchingEnergy
from abfm.matching.solving.levels import Levels
from abfm.matching.solving.settings import SETTINGS
from abfm.mesh.subdivision import times_subdivided
from abfm.types import FloatArray


def initial_fields(energy: MatchingEnergy) -> FloatArray | None:
    """Return the start of a problem as frame coefficients (N, F, 2); None if it has none."""
    start, segments = energy.problem.start, energy.parameters.solver.segments
    if start is None:
        return None
    count, segments = len(start), segments or len(start)
    begins, others = np.arange(segments)[:, None] * count, np.arange(count) * segments
    overlaps = np.minimum(begins + count, others + segments) - np.maximum(begins, others)
    averages = np.maximum(overlaps, 0) / count
    return to_frame(energy.mesh, np.tensordot(averages, start / energy.length_scale, 1))


def misses_target(energy: MatchingEnergy, start: FloatArray, advected: FloatArray) -> bool:
    """Return whether the flow of a start (N, F, 2) misses the target, so that a search is needed.

    ``advected`` (C, V) is the source, advected by the start. Raise StartError if this flow
    overflows or is unstable. False if the parameters have no reach, which excludes a search.
    """
    if not np.isfinite(advected).all():
        raise StartError("the flow of the start overflows; use a start with slower fields, or none")
    if energy.parameters.solver.reach:
        return energy.residual_of(start, advected) > SETTINGS.missed_residual
    largest, grown = float(np.abs(energy.terms.sources).max()), float(np.abs(advected).max())
    if grown > SETTINGS.unstable_factor * largest:
        raise StartError(
            f"the discrete flow of the start is unstable: values up to {largest:.3g} grow to "
            f"{grown:.3g}; use a start with slower fields, or none"
        )
    return False


def start_on_finer(energy: MatchingEnergy, levels: Levels) -> tuple[Levels, FloatArray] | None:
    """Return the levels up to the finer mesh on which a start is given, and its coefficients.

    None if there is no such start, the parameters exclude this mesh, or the start misses the
    target.
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
    is_close = finest.residual_of(x, finest.advected(x)) <= SETTINGS.missed_residual
    return (levels, x) if is_close else None


def start_on_coarsest(levels: Levels, start: FloatArray | None, is_required: bool) -> FloatArray:
    """Return the initial fields (N, F, 2) on the coarsest level, from a start on the finest one.

    They are zero without a start, or if it is much worse than no motion and not ``is_required``.
    """
    energy = levels[0].energy
    rest = np.zeros(energy.shape)
    if start is None:
        return rest
    for coarser, finer in zip(levels.all[-2::-1], levels.all[:0:-1], strict=True):
        start = coarser.fields_from_finer(to_ambient(finer.energy.mesh, start))
    at_rest = energy.residual_of(rest, energy.terms.sources)
    residual = energy.residual_of(start, energy.advected(start))
    return start if is_required or residual <= SETTINGS.diverged_factor * at_rest else rest
