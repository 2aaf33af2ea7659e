"""What a solver is given, and what it tells of a run."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import abfm
from abfm import Parameters, TriangleMesh
from abfm_viewer.document.document import Channel


@dataclass(frozen=True)
class Problem:
    """What is solved; problems that are equal have the same solution."""

    mesh: TriangleMesh
    channels: tuple[Channel, ...]
    parameters: Parameters
    mask: str


@dataclass(frozen=True, eq=False)
class Snapshot:
    """The newest iterate of a run, its problem, and the newest one to be `shown`, whose ``advected`` is there."""

    problem: Problem
    iteration: abfm.Iteration
    shown: abfm.Iteration


class State(Enum):
    """Where a run is in its life; it has ended when `Solver.collect` has seen that."""

    IDLE = "idle"
    RUNNING = "running"
    PAUSED = "paused"
    ENDING = "ending"  # cancelled, and the evaluation under way is still to end
    ENDED = "ended"
    FAILED = "failed"
