"""Random numbers that belong to places in space: the same wherever and whenever they are asked for."""

import numpy as np

from abfm.numerics.kernels import kernel


@kernel
def hashed(i: int, j: int, k: int, seed: int) -> float:
    """A number from -1 to 1 for a point of the integer grid."""
    h = (np.uint64(seed) + np.uint64(1)) * np.uint64(0xD1B54A32D192ED03)
    h ^= h >> np.uint64(32)
    for value in (i, j, k):
        h = (h ^ np.uint64(value)) * np.uint64(0x9E3779B97F4A7C15)
        h ^= h >> np.uint64(29)
    h *= np.uint64(0xBF58476D1CE4E5B9)
    return float(np.int64(h)) * 2.0**-63
