"""The energies of a run, which one thread adds to and another one reads."""

from __future__ import annotations

import time as clock
from collections import deque

import numpy as np

import abfm
from abfm import Parameters
from abfm_viewer.computing.memo import Memo
from abfm_viewer.document.document import Run

# total, regularity, mismatch; stage, vertices, reach
_Row = tuple[float, float, float, int, int, float]

_RECENT = 20  # iterations that tell how long the next ones take


class Energies:
    """Of one run, iterate by iterate."""

    def __init__(self) -> None:
        self._rows: list[_Row] = []
        self._restarts: list[int] = []
        self._run = Memo[Run]()
        self._recent: deque[float] = deque(maxlen=_RECENT)  # when they came

    def add(self, now: abfm.Iteration) -> None:
        energies = (now.energy, now.regularity, now.mismatch_energy)
        self._recent.append(clock.monotonic())
        self._rows.append((*energies, now.stage, now.vertices, now.reach))

    @property
    def seconds_each(self) -> float | None:
        """How long an iteration takes at present; None before there are two."""
        times = list(self._recent)
        return (times[-1] - times[0]) / (len(times) - 1) if len(times) > 1 else None

    def restart(self) -> None:
        """Say that what comes belongs to another problem."""
        self._restarts.append(len(self._rows))

    def run(self, mismatch: float, parameters: Parameters) -> Run | None:
        """The run so far, the same object while nothing is added; None before the first iterate."""
        rows, restarts = self._rows[:], tuple(self._restarts)
        if not rows:
            return None
        made_of = (len(rows), mismatch, parameters, restarts)
        return self._run.get(made_of, lambda: _run(rows, restarts, mismatch, parameters))


def _run(
    rows: list[_Row], restarts: tuple[int, ...], mismatch: float, parameters: Parameters
) -> Run:
    table = np.array(rows)
    return Run(
        energies=table[:, :3],
        stages=table[:, 3].astype(np.int64),
        restarts=restarts,
        mismatch=mismatch,
        label=f"α {parameters.alpha:g}, β {parameters.beta:g}, σ {parameters.sigma:g}",
        vertices=table[:, 4].astype(np.int64),
        reaches=table[:, 5],
    )
