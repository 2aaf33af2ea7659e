"""The result of a run that has not ended: what is kept if it never does."""

from __future__ import annotations

import numpy as np

import abfm
from abfm_viewer.computing.evaluation import Functions
from abfm_viewer.computing.problem import Problem
from abfm_viewer.document.document import Run


def unfinished_match(iterate: abfm.Iteration, problem: Problem, functions: Functions, run: Run | None) -> abfm.Match:
    """An iterate as a match that was cancelled, without a check by flow lines.

    On a coarser mesh its field is interpolated, which takes a moment on a fine one.
    """
    sources, targets = (
        np.stack([functions.evaluate(channel.spec(side)) for channel in problem.channels], axis=1)
        for side in ("source", "target")
    )
    parts = {
        "source": sources,
        "target": targets,
        "velocity": iterate.velocity,
        "advected": iterate.advected,
        "energy_history": np.array([[iterate.energy, iterate.regularity, iterate.mismatch_energy]]),
        "stages": np.array([iterate.stage]),
        "mismatch": np.array(iterate.mismatch),
        "stop_reason": np.array("cancelled"),
        "weights": np.array([channel.weight for channel in problem.channels]),
        "channels_given": np.array(True),
    }
    if run is not None:
        parts |= {"energy_history": run.energies, "stages": run.stages}
    if problem.mask:
        parts["mask"] = functions.evaluate(problem.mask)
    return abfm.matching.match_of(problem.mesh, parts, problem.parameters, None)
