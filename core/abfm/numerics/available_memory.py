"""A check of the memory that a compiled library will need."""

import numpy as np


def require_memory(size: float) -> None:
    """Raise MemoryError unless ``size`` bytes are available.

    Call this function before a compiled library allocates them. If such libraries run out of
    memory, some free memory twice, some abort, and some continue without the memory.
    """
    try:
        np.empty(int(size), np.uint8)
    except MemoryError:
        raise MemoryError(f"out of memory: {size / 1e6:.0f} MB more are needed") from None
