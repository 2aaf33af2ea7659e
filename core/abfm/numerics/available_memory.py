"""Memory that a compiled library will need."""

import numpy as np


def require_memory(size: float) -> None:
    """Raise a MemoryError unless so many bytes can be had now, before a library needs them.

    Where memory runs out inside them, some free twice, some abort, and some go on with what they
    did not get.
    """
    try:
        np.empty(int(size), np.uint8)
    except MemoryError:
        raise MemoryError(f"out of memory: {size / 1e6:.0f} MB more are needed") from None
