"""Evenly spread directions."""

import numpy as np

from abfm.types import FloatArray


def spread_directions(count: int) -> FloatArray:
    """Return evenly spread points (count, 3) on a spiral around the unit sphere."""
    k = np.arange(count)
    z = 1 - (2 * k + 1) / count
    angle = np.pi * (3 - np.sqrt(5)) * k
    ring = np.sqrt(1 - z**2)
    return np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=1)
