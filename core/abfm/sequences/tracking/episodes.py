"""Stable and transient episodes: minima and maxima of the displacement energy.

Lefèvre & Baillet, Optical flow approaches to the identification of brain dynamics, HBM 30 (2009).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from abfm.types import FloatArray, IntArray

# smallest prominence of an extremum, relative to the range of the energy and to its mean
_RANGE_SHARE_MIN = 0.1
_MEAN_SHARE_MIN = 0.1


@dataclass(frozen=True)
class Episode:
    """A stable or transient period of time around an extremum of the displacement energy.

    The episode extends to the frames where the energy passes halfway to the adjacent extrema.
    """

    kind: Literal["stable", "transient"]
    start: float
    end: float
    extremum: float
    """Time of the extremum, the middle of its interval."""
    speed: float
    """Root mean square of the speed over the surface at that time."""


def episodes(times: FloatArray, speed: FloatArray) -> list[Episode]:
    """Return the stable and transient episodes of a sequence in the order of time.

    ``times`` (T,) are those of the frames, and ``speed`` (T - 1,) is that of the intervals, whose
    square is the energy. There are no episodes if the energy hardly changes.
    """
    energy = speed**2
    prominence = max(
        _RANGE_SHARE_MIN * float(np.ptp(energy)), _MEAN_SHARE_MIN * float(energy.mean())
    )
    if not float(np.ptp(energy)) > prominence:
        return []
    highs, lows = (_peaks(sign * energy, prominence) for sign in (1, -1))
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


def _peaks(values: FloatArray, prominence: float) -> IntArray:
    """Return the indices of the maxima with at least this prominence, also at both ends."""
    # SciPy takes as long to load as all other imports of a batch row; most rows need no episodes
    from scipy.signal import find_peaks

    low = values.min() - 2 * prominence
    padded = np.concatenate([[low], values, [low]])
    return np.asarray(find_peaks(padded, prominence=prominence)[0] - 1)


def _reach(energy: FloatArray, i: int, other: int | None, turn: int) -> int:
    """Return the first or last interval of the episode around interval ``i``.

    ``turn`` is -1 for the first and 1 for the last interval. Beyond it, the energy has passed
    halfway to the adjacent extremum ``other``. Without ``other``, it is the first or last interval
    of the sequence.
    """
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
