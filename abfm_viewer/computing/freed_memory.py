"""Memory that was freed goes back to the system.

The C library of Linux keeps it, in pools for nearly every thread that there was: a window in which
many runs have ended, and many pictures were drawn, holds on to several times as much as it uses.
"""

import ctypes
import sys

# bytes: pictures and textures; what a window computes with all the time is smaller
_LARGE = 2 << 20
_POOLS = 2
_MMAP_THRESHOLD, _ARENA_MAX = -3, -8  # of malloc.h


def keep_little() -> None:
    """Let all threads share two pools, and every large block go back as soon as it is freed.

    The C library begins so, but from the first large block that is freed on it takes blocks of that
    size from its pools, where they leave holes, and it makes up to eight pools for each core.
    """
    _c_library("mallopt", _MMAP_THRESHOLD, _LARGE)
    _c_library("mallopt", _ARENA_MAX, _POOLS)


def give_back() -> None:
    """Return what is free, of all threads; it takes some milliseconds."""
    _c_library("malloc_trim", 0)


def _c_library(name: str, *given: int) -> None:
    library = ctypes.CDLL(None) if sys.platform == "linux" else None
    if hasattr(library, name):
        getattr(library, name)(*given)
