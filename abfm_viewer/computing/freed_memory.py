"""Memory that was freed goes back to the system.

The C library of Linux keeps it, in pools for nearly every thread that there was: a window in which many runs
have ended holds on to half as much again as it uses.
"""

import ctypes
import sys


def give_back() -> None:
    """Return what is free, of all threads; it takes some milliseconds. Elsewhere than on Linux nothing happens."""
    if sys.platform == "linux":
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # not in every C library
        if trim is not None:
            trim(0)
