"""Return freed memory to the system.

The C library of Linux keeps it in pools, several times what a window uses after many runs.
"""

import ctypes
import sys

_BLOCK_BYTES = 2 << 20  # of pictures and textures; smaller blocks are allocated all the time
_POOLS_MAX = 2
_MMAP_THRESHOLD = -3  # of malloc.h
_ARENA_MAX = -8


def keep_little() -> None:
    """Let all threads share two pools, and return every large block as soon as it is freed.

    Otherwise the C library raises both bounds as it runs.
    """
    _c_library("mallopt", _MMAP_THRESHOLD, _BLOCK_BYTES)
    _c_library("mallopt", _ARENA_MAX, _POOLS_MAX)


def give_back() -> None:
    """Return the free memory of all threads; it takes some milliseconds."""
    _c_library("malloc_trim", 0)


def _c_library(name: str, *given: int) -> None:
    library = ctypes.CDLL(None) if sys.platform == "linux" else None
    if hasattr(library, name):
        getattr(library, name)(*given)
