"""The figures of the paper as experiments: set-ups that run again, with measured numbers and a sheet to draw."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from abfm.experiments.experiment import Experiment, Findings, Measure, Report, Setup

__all__ = ["FIGURES", "Experiment", "Findings", "Measure", "Report", "Setup", "experiment"]

FIGURES = (7,)
"""Numbers of the paper's figures that there are experiments for."""


def experiment(figure: int) -> Experiment[Any]:
    """The experiment of a figure of the paper.

    Raises
    ------
    KeyError
        If there is none.
    """
    if figure not in FIGURES:
        raise KeyError(figure)
    found: Experiment[Any] = import_module(f"abfm.experiments.figure_{figure:02}").EXPERIMENT
    return found
