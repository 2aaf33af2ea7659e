"""Which linear systems are factored in processes of their own."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

_UNKNOWNS_MIN = 15_000  # unknowns; cholespy factors fewer within a few frames of a window
_factored_apart: ContextVar[float] = ContextVar("unknowns from which on", default=math.inf)


@contextmanager
def factoring_in_subprocess(unknowns: float = _UNKNOWNS_MIN) -> Iterator[None]:
    """Factor systems of so many unknowns, or fewer with long rows, in processes of their own.

    cholespy stops all threads while it factors: for seven seconds at 160,000 vertices. So what
    works beside a window works inside this block, which holds for this thread alone.
    """
    before = _factored_apart.set(unknowns)
    try:
        yield
    finally:
        _factored_apart.reset(before)


def is_factored_in_subprocess(unknowns: float) -> bool:
    """Tell whether this thread has asked for it, for systems of this size."""
    return unknowns >= _factored_apart.get()
