"""Setting experiments up in a process of their own: eigenfunctions and geodesics would stop a window."""

from __future__ import annotations

import copy
from dataclasses import fields, replace

from abfm.errors import AbfmError
from abfm.experiments import experiment_of
from abfm.experiments.experiment import Setup
from abfm.matching.result import Match
from abfm.numerics.own_process import OwnProcess, ProcessEndedError, Requests


def set_up_apart(figure: int) -> tuple[Setup, Match | None]:
    """The set-up of a figure's experiment on its own mesh, and its given field, computed while other threads go on.

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
    setup, given = value
    return setup, given


def _serve() -> None:
    requests = Requests()
    for figure in requests:
        try:
            found = experiment_of(figure).set_up(None, False)
            given = found.given
            bare = copy.copy(found.mesh)
            bare.__dict__["cache"] = {}
            common = {entry.name: getattr(found, entry.name) for entry in fields(Setup)}
            setup = Setup(**{**common, "mesh": bare})
            requests.answer(("setup", (setup, given and replace(given, mesh=bare))))
        except AbfmError as error:
            requests.answer(("error", str(error)))


if __name__ == "__main__":
    _serve()
