"""What tests have a worker compute."""

import os
import time
import warnings

from abfm import FunctionError
from abfm.errors import AbfmWarning
from abfm.workers.control import checkpoint
from abfm.workers.progress import step
from abfm.workers.worker import report


class Notes:
    """A state: what was noted."""

    def __init__(self):
        self.lines = []

    def add(self, line):
        self.lines.append(line)
        return self.lines


def give_back(_, given):
    return given


def fail(_, kind):
    raise {"input": FunctionError, "memory": MemoryError, "bug": KeyError, "end": SystemExit}[kind](
        "two\nlines"
    )


def warn(_, text):
    warnings.warn(text, AbfmWarning, stacklevel=2)
    return text


def count_apart(_, upto):
    with step("counting"):
        for number in range(upto):
            report(number)
    return os.getpid()


def go_on(notes):
    """Note how often a checkpoint was passed, until a control ends it."""
    while True:
        checkpoint()
        notes.lines.append(1)
        time.sleep(0.001)


def lines(notes):
    return len(notes.lines)


def hold(_, file):
    """Wait until there is a file."""
    with step("holding"):
        while not file.exists():
            time.sleep(0.001)


def mesh_and_size(notes, mesh):
    """Return a mesh, and whether it is the object of the call before."""
    before = notes.lines[-1] if notes.lines else None
    notes.lines = [mesh]
    return mesh, before is mesh
