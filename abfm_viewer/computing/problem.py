"""What a solver is given, in the document's words, and what it tells of a run."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

import numpy as np

import abfm
from abfm import Parameters, TriangleMesh
from abfm.types import FloatArray
from abfm_viewer.computing.evaluation import Functions
from abfm_viewer.document.document import Channel, Run


@dataclass(frozen=True)
class ProblemSpec:
    """What is solved, its functions as text; those that are equal have the same solution."""

    mesh: TriangleMesh
    channels: tuple[Channel, ...]
    parameters: Parameters
    mask: str

    def problem(self, functions: Functions) -> abfm.Problem:
        """Evaluate the functions; FunctionError as they raise it."""
        source, target = (
            np.stack([functions.evaluate(channel.spec(side)) for channel in self.channels], axis=1)
            for side in ("source", "target")
        )
        return abfm.Problem(
            self.mesh,
            source,
            target,
            self.parameters,
            mask=functions.evaluate(self.mask) if self.mask else None,
            weights=[channel.weight for channel in self.channels],
        )


@dataclass(frozen=True, eq=False)
class Snapshot:
    """The newest iterate of a run, its problem, and the newest one to be `shown`, whose
    ``advected`` is there.
    """

    problem: ProblemSpec
    iteration: abfm.Iteration
    shown: abfm.Iteration

    def as_match(self, functions: Functions, run: Run | None) -> abfm.Match:
        """Return the iterate as a match that was cancelled, without a check by flow lines.

        On a coarser mesh its field is interpolated, which takes a moment on a fine one; AbfmError
        if it is not known any more.
        """
        now = self.iteration
        energies: FloatArray = np.array([[now.energy, now.regularity, now.mismatch_energy]])
        reason = abfm.StopReason.CANCELLED
        return abfm.Match(
            problem=self.problem.problem(functions),
            velocity=now.velocity,
            advected=now.advected,
            energy_history=energies if run is None else run.energies,
            stages=np.array([now.stage]) if run is None else run.stages,
            mismatch=now.mismatch,
            verified_mismatch=math.nan,
            folded=math.nan,
            stop_reason=reason,
            verdict=abfm.matching.Verdict(abfm.matching.kind_of(now.mismatch), reason, ""),
        )


class State(Enum):
    """Where a run is in its life; it has ended when `Solver.collect` has seen that."""

    IDLE = "idle"
    RUNNING = "running"
    PAUSED = "paused"
    ENDING = "ending"  # cancelled, and the evaluation under way is still to end
    ENDED = "ended"
    FAILED = "failed"
