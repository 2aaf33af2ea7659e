"""What a sequence achieved, in words: of an interval, of frames between two, of its fields."""

from __future__ import annotations

import math

import numpy as np

from abfm.matching.judging.facts import headline_of
from abfm.outcome import worse_residual
from abfm.sequences.sequence import Sequence
from abfm.wording import share


def of_interval(sequence: Sequence, interval: int) -> str:
    """Return the headline of an interval of a sequence, such as ``matched to 0.7%``."""
    residual = worse_residual(
        float(sequence.residual[interval]), float(sequence.verified_residual[interval])
    )
    return headline_of(sequence.verdicts[interval].kind, residual, sequence.parameters.goal)


def motion_between(sequence: Sequence) -> str:
    """Return how much of the motion is in frames between two: ``97% of the motion``, and why."""
    found = sequence.motion_share
    if math.isnan(found):
        why = (
            "two frames have none between them to leave out"
            if len(sequence) < 2
            else "left-out frames do not show whether it is right"
        )
        return f"the motion if it is confirmed, else the linear blend, as {why}"
    if found == 0:
        why = "noise hides the motion" if sequence.has_motion else "left-out frames show no motion"
        return f"the linear blend, as {why}"
    return f"{share(found)} of the motion, by left-out frames"


def uncertainty(sequence: Sequence) -> str:
    """Return the median standard error of the fields, and how much of them frames determine."""
    solved = sequence.solved
    error = float(np.median(sequence.speed_uncertainty[solved]))
    if not math.isfinite(error):
        return "infinite, as the frames determine no motion"
    found = float(np.median(sequence.speed_determined[solved]))
    return f"median {error:.3g}; the frames determine {share(found)} of the field"
