"""Rows for tests: quick rows, and rows that kill the process that solves them."""

import os
import signal
import warnings
from unittest.mock import Mock

import numpy as np

from abfm.assets import asset_path
from abfm.batch import Cluster, Row
from abfm.errors import AbfmWarning

ONE = Cluster(jobs=1)
BRIEF = {"refine": 0, "iterations": 4, "levels": 1, "cooling-stages": 2}


def pair(name="pair", source=0, target=9, **more):
    """Return a match of two Gaussians on the figure eight, with few iterations."""
    functions = {
        "source": f"gaussian:vertex={source},width=0.3",
        "target": f"gaussian:vertex={target},width=0.3",
    }
    return Row(name, {"mesh": asset_path("eight.off")} | functions | BRIEF | more)


def results(folder):
    return {path.name: path.read_bytes() for path in folder.glob("*.npz")}


class Quick(Row):
    def task(self):
        found = Mock(save=lambda path: np.savez(path, one=1))
        return Mock(digest="0a", goal=None, expected=lambda: None, solve=lambda monitor: found)


class Warned(Quick):
    def task(self):
        warnings.warn("no value", AbfmWarning, stacklevel=2)
        return super().task()


class Deadly(Row):
    """A row that kills every process that solves it."""

    def task(self):
        os.kill(os.getpid(), signal.SIGKILL)


class Mortal(Row):
    """A row that kills the first process that solves it; a file in a folder marks this attempt."""

    def task(self):
        if not os.path.exists(self.folder):
            os.mkdir(self.folder)
            os.kill(os.getpid(), signal.SIGKILL)
        return super().task()
