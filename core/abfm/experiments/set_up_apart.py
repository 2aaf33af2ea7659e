"""Setting experiments up in a process of their own: eigenfunctions and geodesics would stop a window."""

import math
from dataclasses import fields

import numpy as np

from abfm.calculus.vector_fields import to_frame
from abfm.errors import AbfmError
from abfm.experiments import experiment_of
from abfm.experiments.experiment import Setup
from abfm.matching.energy.energy import MatchingEnergy
from abfm.matching.judging.verdict import Verdict
from abfm.matching.result import Match
from abfm.matching.schedule import MATCHED
from abfm.numerics.own_process import OwnProcess, ProcessEndedError, Requests


def set_up_apart(figure: int) -> tuple[Setup, Match | None]:
    """The set-up of a figure's experiment on its own mesh, computed while other threads go on; and its given flow.

    Raises
    ------
    AbfmError
        If it cannot be set up.
    """
    process = OwnProcess(__name__)
    try:
        process.send(figure)
        answer, value = process.receive()
    except ProcessEndedError:
        raise AbfmError(f"figure {figure} was not set up: its process has ended; try again") from None
    finally:
        process.close()
    if answer == "error":
        raise AbfmError(value)
    setup, match = value
    return setup, match


def _serve() -> None:
    requests = Requests()
    for figure in requests:
        try:
            requests.answer(("setup", sent(experiment_of(figure).set_up(None, False))))
        except AbfmError as error:
            requests.answer(("error", str(error)))


def sent(setup: Setup) -> tuple[Setup, Match | None]:
    """What goes from one process to the other: what all set-ups have, and the given flow."""
    common = {entry.name: getattr(setup, entry.name) for entry in fields(Setup)}
    return Setup(**common | {"flow": None}), given(setup)


def given(setup: Setup) -> Match | None:
    """The given flow as a match with its field, so that a window shows and saves it as any result; None without."""
    if setup.flow is None:
        return None
    source, target, p = setup.source, setup.target, setup.parameters
    energy = MatchingEnergy(setup.mesh, source, target, p)
    evaluated = energy.evaluate(to_frame(setup.mesh, setup.flow.velocity / setup.mesh.length_scale), p.sigma)
    mismatch = energy.relative_mismatch(evaluated.advected)
    return Match(
        mesh=setup.mesh,
        source=source,
        target=target,
        parameters=p,
        velocity=setup.flow.velocity,
        advected=np.ascontiguousarray(evaluated.advected.T),
        energy_history=np.array([[evaluated.energy, evaluated.regularity, evaluated.mismatch]]),
        stages=np.zeros(1, dtype=np.int64),
        mismatch=mismatch,
        verified_mismatch=math.nan,
        folded=math.nan,
        stop_reason="given",
        verdict=Verdict("matched" if mismatch <= MATCHED else "not reached", "the field is given, not sought", ""),
        mask=None,
        weights=np.ones(source.shape[1]),
        channels_given=True,
    )


if __name__ == "__main__":
    _serve()
