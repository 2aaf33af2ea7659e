"""When a film is stable and when it changes fast: minima and maxima of the displacement energy
[Lefèvre & Baillet, Optical flow approaches to the identification of brain dynamics, HBM 30 (2009)].
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from abfm.types import FloatArray, IntArray

# what an extremum stands out by: of the range of the energy, and of its mean
_OF_RANGE_MIN = 0.1
_OF_MEAN_MIN = 0.1


@dataclass(frozen=True)
class Episode:
    """A time about an extremum of the energy, between the frames where it passes halfway to the
    next ones of the other kind.
    """

    kind: Literal["stable", "transient"]
    start: float
    end: float
    extremum: float
    """When the energy is least, or largest: the middle of its interval."""
    speed: float
    """Root mean square of the speed over the surface then."""


def episodes(times: FloatArray, speed: FloatArray) -> list[Episode]:
    """Return the stable and the transient episodes between frames at times (T,), by the speed of
    each interval (T - 1,), in the order of time; none where the energy hardly changes.
    """
    energy = speed**2
    least = max(_OF_RANGE_MIN * float(np.ptp(energy)), _OF_MEAN_MIN * float(energy.mean()))
    if not float(np.ptp(energy)) > least:
        return []
    highs, lows = (_peaks(sign * energy, least) for sign in (1, -1))
    extrema = sorted([(int(i), "transient") for i in highs] + [(int(i), "stable") for i in lows])
    found = []
    for number, (i, kind) in enumerate(extrema):
        before = extrema[number - 1][0] if number else None
        after = extrema[number + 1][0] if number + 1 < len(extrema) else None
        first, last = _reach(energy, i, before, -1), _reach(energy, i, after, 1)
        begin, end = float(times[first]), float(times[last + 1])
        middle = float(times[i] + times[i + 1]) / 2
        found.append(
            Episode(
                "stable" if kind == "stable" else "transient", begin, end, middle, float(speed[i])
            )
        )
    return found


def _peaks(values: FloatArray, least: float) -> IntArray:
    """Return maxima that stand out by so much, ends of the time among them."""
    # takes as long to load as all else that a row of a batch needs, and most look for no episodes
    from scipy.signal import find_peaks

    low = values.min() - 2 * least
    padded = np.concatenate([[low], values, [low]])
    return np.asarray(find_peaks(padded, prominence=least)[0] - 1)


def _reach(energy: FloatArray, i: int, other: int | None, turn: int) -> int:
    """Return the last interval from an extremum on, before the energy passes halfway."""
    stop = (len(energy) - 1 if turn > 0 else 0) if other is None else other
    half = energy[i] + (energy[stop] - energy[i]) / 2 if other is not None else np.inf
    j = i
    while j != stop:
        k = j + turn
        passed = (energy[k] - half) * (energy[i] - half) <= 0 if other is not None else False
        if passed:
            break
        j = k
    return j
