"""The figures of the paper by number; quick to import, as menus list them before anything is computed."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from abfm.experiments.experiment import Experiment

TITLES = {
    1: "one Gaussian becomes two, a body away",
    2: "a flow and a function that it carries",
    3: "a wide Gaussian becomes two narrow ones",
    4: "linear and exponential advection",
    5: "the smoothest field that commutes with another",
    6: "a field carried along another",
    7: "eigenfunction 7 becomes eigenfunction 8",
    8: "optical flow: the field that made the target",
    9: "a symmetry as a flow",
    10: "a symmetry as a flow, on a shape with creases",
    11: "functions with jumps become smooth ones",
    12: "a map between two poses, improved",
    13: "how accurate the maps are",
}
"""A few words for each of the paper's figures that there are experiments for."""
FIGURES = tuple(TITLES)


def experiment_of(figure: int) -> Experiment[Any]:
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
