"""One problem by one version of the solver: what came out, and what it cost."""

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass
from time import perf_counter
from typing import Any

from abfm.errors import AbfmError
from abfm.flow.exponential import counted_row_products
from abfm.matching.problem import Problem
from abfm.mesh import TriangleMesh
from abfm.parameters import Parameters
from laboratory.success.problems import Trial
from laboratory.watched import LEVEL, watched_match

BEFORE = Parameters(
    reach=0.0,
    order=1,
    levels=1,
    balance=0.0,
    sigma=1e-3,
    sigma_unit="absolute",
    alpha=0.02,
    iterations=150,
    cooling_stages=3,
    cooling_factor=10.0,
)
"""The paper's energy on the mesh alone, in three stages of sigma: the solver as it was before it
had a reach.
"""
VERSIONS = {"before": BEFORE, "now": Parameters()}
"""What is compared."""
CONFIRMED = 0.1
"""Largest mismatch by flow lines that confirms one."""
UNFOLDED = 0.01
"""Largest share of folded faces of a flow that folds none but for its discretisation."""


@dataclass(frozen=True)
class Record:
    """A match in numbers; NaN is what could not be had."""

    mismatch: float = math.nan
    # mismatch by flow lines of the continuous field, and shares of the faces, see `abfm.verify`
    verified: float = math.nan
    folded: float = math.nan
    overturned: float = math.nan
    # up to the last iterate, on all meshes together
    iterations: int = 0
    evaluations: int = 0
    # of ``D_v``, by advections and adjoints; factorisations and flow lines come on top
    row_products: int = 0
    # as `Watched` has them, on a mesh of which nothing was known, without the verification here
    seconds: float = math.nan
    seconds_to_level: float = math.nan
    stop_reason: str = ""  # as `abfm.Match.stop_reason`, or "time limit", or the error
    verdict: str = ""  # kind of `abfm.Match.verdict`; empty where there was an error

    def to_dict(self) -> dict[str, Any]:
        """Return all fields, None for what is not a finite number, and whether it is a success and
        confirmed.
        """
        numbers = {
            key: None if isinstance(value, float) and not math.isfinite(value) else value
            for key, value in asdict(self).items()
        }
        return {
            **numbers,
            "success": self.mismatch <= LEVEL,
            "confirmed": self.verified <= CONFIRMED,
        }


def run_trial(
    trial: Trial,
    parameters: Parameters,
    limit: float = 120.0,
    stopped: Callable[[], bool] = lambda: False,
) -> Record:
    """Match and verify.

    Parameters
    ----------
    trial : Trial
    parameters : Parameters
    limit : float
        Seconds after which the match ends with what it has.
    stopped : callable, optional
        Asked in every iteration whether the match is to end with what it has.
    """
    source, target = trial.functions()
    mesh = TriangleMesh(trial.mesh.vertices, trial.mesh.faces)  # nothing computed yet
    start = perf_counter()
    with counted_row_products() as products:
        try:
            stated = Problem(mesh, source, target, parameters)
            watched = watched_match(stated, limit, stopped=stopped)
        except AbfmError as error:
            return Record(
                stop_reason=str(error), seconds=perf_counter() - start, row_products=products.count
            )
    found, last = watched.found, watched.last
    verified, folded, overturned = math.nan, math.nan, math.nan
    with suppress(AbfmError):  # of fields along which flow lines do not end
        witness = found.verify(subdivided=False)
        verified, folded, overturned = witness.mismatch, witness.folded, witness.overturned
    return Record(
        mismatch=found.mismatch,
        verified=verified,
        folded=folded,
        overturned=overturned,
        iterations=last.iteration if last else 0,
        evaluations=last.evaluations if last else 0,
        row_products=products.count,
        seconds=watched.to_end,
        seconds_to_level=watched.to_level,
        stop_reason="time limit"
        if watched.to_end > limit and found.stop_reason == "cancelled"
        else found.stop_reason,
        verdict=found.verdict.kind,
    )
