"""The paper's figures, small and on their own meshes; each runs once in a process, whatever tests look at it."""

from __future__ import annotations

from functools import cache
from typing import Any

from abfm.experiments import experiment_of
from abfm.experiments.experiment import Findings


def quiet(text: str, share: float) -> None:
    """A report that nobody reads, but for its promises."""
    assert text
    assert 0 <= share <= 1


@cache
def ran(figure: int) -> tuple[Any, Findings]:
    """The figure's set-up and what it finds."""
    experiment = experiment_of(figure)
    setup = experiment.set_up(None, True)
    return setup, experiment.run(setup, quiet)


def values(findings: Findings) -> dict[str, float]:
    """Measured numbers by their names."""
    return {measure.name: measure.value for measure in findings.measures}
