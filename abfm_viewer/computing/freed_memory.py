"""Return of freed memory to the system.

The C library of Linux keeps freed memory in pools. After many runs these are several times as large
as the memory that a window uses.
"""

import ctypes
import sys

_BLOCK_BYTES = 2 << 20  # pictures and textures are larger; smaller blocks are very frequent
_POOLS_MAX = 2
_MMAP_THRESHOLD = -3  # constant in malloc.h
_ARENA_MAX = -8


def limit_pools() -> None:
    """Make all threads share two memory pools, and return large blocks as soon as they are freed.

    By default, the C library increases the number of pools and the size of a large block while the
    program runs.
    """
    _c_library("mallopt", _MMAP_THRESHOLD, _BLOCK_BYTES)
    _c_library("mallopt", _ARENA_MAX, _POOLS_MAX)


def return_free_memory() -> None:
    """Return the free memory of all threads to the system, which takes some milliseconds."""
    _c_library("malloc_trim", 0)


def _c_library(name: str, *given: int) -> None:
    library = ctypes.CDLL(None) if sys.platform == "linux" else None
    if hasattr(library, name):
        getattr(library, name)(*given)
