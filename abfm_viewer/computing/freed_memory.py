"""Memory that was freed goes back to the system.

The C library of Linux keeps it, in pools for nearly every thread that there was: a window in which many runs have
ended, and many pictures were drawn, holds on to several times as much as it uses.
"""

import ctypes
import sys
from typing import Any

_LARGE = 2 << 20  # bytes: pictures and textures; what a window computes with all the time is smaller
_MMAP_THRESHOLD = -3  # of malloc.h


def return_large_blocks() -> None:
    """From now on every large block goes back as soon as it is freed, and leaves no hole in a pool.

    The C library begins so, but from the first such block that is freed on it takes blocks of that size from its pools.
    """
    _c_library("mallopt", _MMAP_THRESHOLD, _LARGE)


def give_back() -> None:
    """Return what is free, of all threads; it takes some milliseconds."""
    _c_library("malloc_trim", 0)


def _c_library(name: str, *given: int) -> None:
    """Call a function of the C library; elsewhere than on Linux, and where it has no such function, nothing happens."""
    if sys.platform == "linux":
        function: Any = getattr(ctypes.CDLL(None), name, None)
        if function is not None:
            function(*given)
