"""Which iterates of a run get a picture, so that pictures take a tenth of its time."""

from __future__ import annotations

import time as clock

import abfm

_TIMES_A_PICTURE, _SHORTEST_WAIT, _LONGEST_WAIT = 9, 0.05, 0.2
"""How long no picture is made after one, times what it took, and at least and at most, in
seconds.
"""


class PicturePace:
    """Of one solve: its first iterate is pictured. One on a coarse mesh may take less time than
    its picture.
    """

    def __init__(self) -> None:
        self._next = 0.0

    def takes(self, iteration: abfm.Iteration) -> bool:
        """Tell whether this iterate is to be shown; its ``advected`` is computed then, and kept."""
        now = clock.perf_counter()
        if now < self._next:
            return False
        _ = iteration.advected  # computed here: not in the frame loop
        done = clock.perf_counter()
        self._next = done + min(max(_TIMES_A_PICTURE * (done - now), _SHORTEST_WAIT), _LONGEST_WAIT)
        return True
