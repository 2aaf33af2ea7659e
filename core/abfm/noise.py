"""Random numbers that belong to places in space: the same wherever and whenever they are asked for."""

from __future__ import annotations

import math

import numpy as np

from abfm.kernels import kernel


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


@kernel
def noise_at(x: float, y: float, z: float, seed: int) -> float:
    """Noise of the integer grid between its points, of equal variance everywhere."""
    i, j, k = math.floor(x), math.floor(y), math.floor(z)
    u, v, w = x - i, y - j, z - k
    total = 0.0
    for dk in range(2):
        for dj in range(2):
            share = (v if dj else 1.0 - v) * (w if dk else 1.0 - w)
            total += share * ((1.0 - u) * hashed(i, j + dj, k + dk, seed) + u * hashed(i + 1, j + dj, k + dk, seed))
    spread = (u * u + (1.0 - u) ** 2) * (v * v + (1.0 - v) ** 2) * (w * w + (1.0 - w) ** 2)
    return total / math.sqrt(spread)
