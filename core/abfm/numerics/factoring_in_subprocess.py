"""The choice of linear systems that are factored in a subprocess."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

_UNKNOWNS_MIN = 15_000  # cholespy factors smaller systems within a few frames of the window
_unknowns_min: ContextVar[float] = ContextVar("smallest system in a subprocess", default=math.inf)


@contextmanager
def factoring_in_subprocess(unknowns: float = _UNKNOWNS_MIN) -> Iterator[None]:
    """Let this thread factor systems of at least ``unknowns`` unknowns in subprocesses.

    Systems with long rows count as larger. cholespy blocks all threads while it factors, for seven
    seconds at 160,000 vertices. Code that runs while a window is open therefore uses this context.
    """
    before = _unknowns_min.set(unknowns)
    try:
        yield
    finally:
        _unknowns_min.reset(before)


def is_factored_in_subprocess(unknowns: float) -> bool:
    return unknowns >= _unknowns_min.get()
