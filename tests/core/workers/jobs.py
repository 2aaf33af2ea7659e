"""Functions that tests call in a worker."""

import os
import time
import warnings

from abfm import FunctionError
from abfm.errors import AbfmWarning
from abfm.workers.control import checkpoint
from abfm.workers.progress import step
from abfm.workers.worker import report


class Lines:
    def __init__(self):
        self.lines = []

    def add(self, line):
        self.lines.append(line)
        return self.lines


def identity(_, given):
    return given


def fail(_, kind):
    raise {"input": FunctionError, "memory": MemoryError, "bug": KeyError, "end": SystemExit}[kind](
        "two\nlines"
    )


def warn(_, text):
    warnings.warn(text, AbfmWarning, stacklevel=2)
    return text


def count_in_subprocess(_, upto):
    """Report the numbers up to a limit; return the process id."""
    with step("counting"):
        for number in range(upto):
            report(number)
    return os.getpid()


def pass_checkpoints(state):
    """Pass checkpoints until the call is cancelled; count them in the state."""
    while True:
        checkpoint()
        state.lines.append(1)
        time.sleep(0.001)


def lines(state):
    return len(state.lines)


def wait_for_file(_, file):
    with step("waiting"):
        while not file.exists():
            time.sleep(0.001)


def same_mesh(state, mesh):
    """Return a mesh, and whether it is the same object as in the previous call."""
    before = state.lines[-1] if state.lines else None
    state.lines = [mesh]
    return mesh, before is mesh
