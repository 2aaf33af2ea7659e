"""One trial of the attack, and the fault that it may find."""

from typing import NamedTuple


class Trial(NamedTuple):
    """A trial without a fault; ``is_refused`` for bad input that was refused in one line."""

    is_refused: bool = False
    seconds: float = 0.0
    megabytes: float = 0.0


class FaultError(AssertionError):
    """Raised for a broken promise, with the input and the result."""
