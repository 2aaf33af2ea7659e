"""What it costs to solve a match."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from abfm.matching.solving.record import Iteration
from abfm.tasks.monitor import ignore


@dataclass
class Cost:
    """The cost of a match, measured while it is solved; None is unknown."""

    evaluations: int | None = None  # of energy and gradient, up to the last iterate
    seconds_to_goal: float | None = None  # until the residual on the mesh itself was the goal

    def watch(self, goal: float | None) -> Callable[[Iteration], object]:
        """Return a function to call after every iteration of a match with a goal; None for tasks
        that have none.
        """
        if goal is None:
            return ignore
        began = time.monotonic()

        def measure(now: Iteration) -> None:
            self.evaluations = now.evaluations
            is_reached = now.level == now.levels - 1 and now.residual <= goal
            if is_reached and self.seconds_to_goal is None:
                self.seconds_to_goal = time.monotonic() - began

        return measure
